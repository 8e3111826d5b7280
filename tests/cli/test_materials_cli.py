"""gf-usd materials, schema-path, --version and --help: what is printed without an asset."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

import gf_usd as package
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.core.materials.presets import presets


def numbers(row: str) -> list[float]:
    """What stands after the name."""
    return [float(word) for word in row.split()[1:]]


def test_every_preset_is_listed_with_its_numbers_and_source(gf_usd) -> None:
    done = gf_usd("materials")
    assert (done.status, done.err) == (0, "")
    rows = {line.split()[0]: line for line in done.out.splitlines() if line.strip()}
    for m in DIMENSIONLESS.values():
        values = [m.mu, m.lam, m.density, m.damping, m.friction, m.restitution]
        assert numbers(rows[m.name]) == pytest.approx(values, rel=1e-3)
        assert f"{m.name}: {m.note}" in done.out
        for name, value in m.parameters.items():
            assert f"{name} {value:g}" in " ".join(done.out.split())
    for m in PHYSICAL.values():
        values = [m.youngs_modulus, m.poissons_ratio, m.density, m.damping_time]
        values += [m.friction, m.restitution]
        assert numbers(rows[m.name]) == pytest.approx(values, rel=1e-3)
        assert f"{m.name}: {m.source}" in done.out.replace("\n", " ").replace("  ", " ")
    assert " ".join(done.out.split()).endswith(f"laws: {', '.join(LAWS)} (--law)")


def test_the_restitution_is_said_not_to_be_the_rebound_of_a_body(gf_usd) -> None:
    """A ball of metal, with 0.85 in this table, rebounds with 0.97 of its speed."""
    output = " ".join(gf_usd("materials").out.split())
    assert "restitution: of one contact sample on its spring." in output
    assert "rebounds according to its damping time" in output


def test_every_number_has_its_unit(gf_usd) -> None:
    # rich reads brackets as markup unless it is switched off.
    done = gf_usd("materials")
    assert done.out.count("[rho g0 r]") == 2
    assert done.out.count("[kg/m^3]") == 2
    for unit in ("[T]", "[Pa]", "[s]"):
        assert unit in done.out


@pytest.mark.parametrize("columns", [80, 200])
def test_nothing_is_cut_off(gf_usd, monkeypatch: pytest.MonkeyPatch, columns: int) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    done = gf_usd("materials")
    assert "…" not in done.out
    assert max(len(line) for line in done.out.splitlines()) <= columns
    assert all(name in done.out for name in presets())


def test_json(gf_usd) -> None:
    done = gf_usd("materials", "--json")
    assert (done.status, done.err) == (0, "")
    assert json.loads(done.out) == {
        "looks": [asdict(look) for look in DIMENSIONLESS.values()],
        "physical": [asdict(p) for p in PHYSICAL.values()],
        "laws": list(LAWS),
    }


def test_the_schema_s_folder(gf_usd) -> None:
    done = gf_usd("schema-path")
    assert (done.status, done.err) == (0, "")
    folder = Path(done.out.rstrip("\n"))
    assert (folder / "plugInfo.json").is_file()
    assert (folder / "generatedSchema.usda").is_file()


def test_the_version(gf_usd) -> None:
    done = gf_usd("--version")
    assert (done.status, done.out, done.err) == (0, f"gf-usd {package.__version__}\n", "")


@pytest.mark.parametrize("command", ["bake", "inspect", "preview", "check", "materials"])
@pytest.mark.parametrize("option", ["-h", "--help"])
def test_every_command_has_help(gf_usd, command: str, option: str) -> None:
    done = gf_usd(command, option)
    assert (done.status, done.err) == (0, "")
    assert f"gf-usd {command}" in done.out


def test_an_unknown_command(gf_usd) -> None:
    done = gf_usd("cook")
    assert (done.status, done.out) == (2, "")
    assert "cook" in done.err
