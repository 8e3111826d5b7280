"""gf-usd fit: what is refused before anything is simulated, and whole fits of a small ball."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import gf_usd
from gf_usd.core.errors import UsageError
from gf_usd.core.materials.presets import find_preset

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
# few particles and one impact: 0.2 s each
SMALL = {"particles": 200, "drop": 0.3, "fps": 30.0}
TRUTH = {"youngs_modulus": 4e5, "damping_time": 6.4e-3}


def cache_of_truth(folder: Path, frames: int) -> Path:
    rubber = replace(find_preset("rubber").material(1.0), name="truth", **TRUTH)
    return gf_usd.bake(
        SPHERE, material=rubber, output=folder / "truth.usda", frames=frames, only="mesh", **SMALL
    ).root


@pytest.mark.parametrize(
    ("targets", "options", "message"),
    [
        ([], {}, "no target was given"),
        (["rebond=0.6"], {}, "did you mean rebound"),
        (["rebound=0.6"], {"half": True}, "no option 'half'"),
        (["rebound=0.6"], {"output": "x.txt"}, "does not end in .usd"),
        (["rebound=0.6"], {"picture": "x.jpg"}, "does not end in .png"),
        (["rebound=0.6"], {"output": SPHERE}, "exists"),
        (["rebound=0.6"], {"output": "nowhere/x.usda"}, "does not exist"),
        (["rebound=0.6"], {"unknowns": ["friction"], "friction": 0.5}, "leave out one of the two"),
        (["rebound=0.6"], {"bounds": {"E": (1.0, float("inf"))}}, "is not a number"),
    ],
)
def test_what_makes_no_sense_is_refused(
    targets: list[str], options: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError) as refused:
        gf_usd.fit(SPHERE, targets, **options)  # type: ignore[arg-type]
    assert message in str(refused.value)


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_cache_gives_back_its_material(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from gf_usd.cli.main import execute

    monkeypatch.chdir(tmp_path)
    truth = cache_of_truth(tmp_path, 16)
    command = [
        "fit", str(SPHERE), "--target", str(truth), "--unknowns", "E,damping_time", "-q", "--json",
        "--particles", "200", "--drop", "0.3", "--fps", "30",
    ]  # fmt: skip
    assert execute(command) == 0
    found = json.loads(capsys.readouterr().out)
    for one in found["estimates"]:
        # the same solver made it: what is left is where the search stops
        assert one["value"] == pytest.approx(TRUTH[one["name"]], rel=0.01)
        assert one["identifiable"]
    assert found["frames"] == 16
    assert found["not_identifiable"] == []
    assert {path.name for path in tmp_path.glob("sphere.fit*")} == {
        "sphere.fit.usda", "sphere.fit.png", "sphere.fit.runs",
    }  # fmt: skip
    # what was simulated is read, and what was found can be baked
    assert execute([*command, "--overwrite"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["simulations"] == 0
    assert again["estimates"] == found["estimates"]
    made = gf_usd.bake(SPHERE, material="sphere.fit.usda", frames=2, output="baked.usda", **SMALL)
    assert made.bakes[0].material.name == "rubber_fit"
    young = made.bakes[0].material.youngs_modulus
    assert young == pytest.approx(found["material"]["youngs_modulus"], rel=1e-6)  # float32


@pytest.mark.slow
@pytest.mark.acceptance
def test_density_and_stiffness_are_reported_as_one(tmp_path: Path) -> None:
    truth = cache_of_truth(tmp_path, 16)
    found = gf_usd.fit(SPHERE, truth, unknowns=["E", "rho"], damping_time=6.4e-3, **SMALL)
    # gravity and inertia grow alike: only E / rho moves the ball
    assert [one.identifiable for one in found.estimates] == [False, False]
    assert "youngs_modulus and density are not separately identifiable" in found.not_identifiable[0]
    ratio = found.material.youngs_modulus / found.material.density
    assert ratio == pytest.approx(TRUTH["youngs_modulus"] / 1100.0, rel=0.02)
