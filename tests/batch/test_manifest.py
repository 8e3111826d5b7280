"""Manifests: what they request, and every invalid request."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gf_usd.batch.manifest import read_manifest
from gf_usd.batch.plan import make_plan
from gf_usd.cli.batch.arguments import Arguments, parse_settings, plan_of
from gf_usd.core.errors import InputError, UsageError

TOML = """
out = "results"
name = "{asset}-{material}"
timeout = 90
retries = 0

[settings]
particles = 200

[matrix]
material = ["rubber", "jelly"]

[[assets]]
files = ["models/*.usda", "single.obj"]

[[assets]]
files = "models/b.usda"
name = "{asset}.{seed}"
settings = { drop = "1r", material = "metal" }
matrix = { seed = [0, 1] }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Assets of which only the names matter here."""
    (tmp_path / "models").mkdir()
    for name in ("b.usda", "a.usda", "notes.txt"):
        (tmp_path / "models" / name).touch()
    return tmp_path


def written(folder: Path, text: str, name: str = "toys.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_it_reads_groups_axes_and_limits(folder: Path) -> None:
    found = read_manifest(written(folder, TOML))
    assert (found.title, found.out, found.timeout, found.retries) == (
        "toys", folder / "results", 90.0, 0,
    )  # fmt: skip
    first, second = found.groups
    # patterns are sorted; a path that is not there is kept for its job to say so
    assert [p.relative_to(folder).as_posix() for p in first.files] == [
        "models/a.usda", "models/b.usda", "single.obj",
    ]  # fmt: skip
    assert first.settings == {"particles": 200}
    assert first.matrix == {"material": ["rubber", "jelly"]}
    assert first.name == "{asset}-{material}"
    # what a group sets is no axis for it
    assert second.settings == {"particles": 200, "drop": "1r", "material": "metal"}
    assert second.matrix == {"seed": [0, 1]}
    assert second.name == "{asset}.{seed}"


def test_json_says_the_same(folder: Path) -> None:
    import tomllib

    path = written(folder, json.dumps(tomllib.loads(TOML)), "toys.json")
    assert read_manifest(path).groups == tuple(
        # only what an error would call the group differs
        type(g)(**{**vars(g), "where": g.where.replace("toys.toml", "toys.json")})
        for g in read_manifest(written(folder, TOML)).groups
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lists no assets"),
        ('file = "x"', "unknown key 'file'"),
        ("[[assets]]", "lists no files"),
        ('[[assets]]\nfiles = ["none/*.usd"]', "no file matches none/*.usd"),
        ('[[assets]]\nfiles = ["a.usd"]\nseed = 1', "unknown key 'seed'"),
        ('[settings]\nparticle = 3\n[[assets]]\nfiles = ["a.usd"]', "unknown option 'particle'"),
        ('[settings]\nparticles = "many"\n[[assets]]\nfiles = ["a.usd"]', "particles is 'many'"),
        ('[settings]\nparticles = true\n[[assets]]\nfiles = ["a.usd"]', "particles is True"),
        ('[settings]\nparticles = -1\n[[assets]]\nfiles = ["a.usd"]', "--particles is -1"),
        ('[settings]\nmaterial = "ruber"\n[[assets]]\nfiles = ["a.usd"]', "no material 'ruber'"),
        ('[matrix]\nseed = 3\n[[assets]]\nfiles = ["a.usd"]', "the matrix has seed = 3"),
        ('[matrix]\nseed = []\n[[assets]]\nfiles = ["a.usd"]', "the matrix has seed = []"),
        ('[matrix]\nlaw = ["hooke"]\n[[assets]]\nfiles = ["a.usd"]', "no law 'hooke'"),
        ('timeout = "1h"\n[[assets]]\nfiles = ["a.usd"]', "timeout is '1h'"),
        ('timeout = nan\n[[assets]]\nfiles = ["a.usd"]', "timeout is nan"),
        ('timeout = 0\n[[assets]]\nfiles = ["a.usd"]', "timeout is 0"),
        ('retries = inf\n[[assets]]\nfiles = ["a.usd"]', "retries is inf"),
        ('retries = 1.5\n[[assets]]\nfiles = ["a.usd"]', "retries is 1.5"),
        ("[[assets]]\nfiles = [1]", "assets 1: 1 is not a file"),
        ('[[assets]]\nfiles = ["a.usd", ""]', "assets 1: '' is not a file"),
        ('settings = 3\n[[assets]]\nfiles = ["a.usd"]', "settings is 3"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_with_its_place(
    folder: Path, text: str, message: str
) -> None:
    path = written(folder, text)
    with pytest.raises(UsageError) as refused:
        read_manifest(path)
    assert message in refused.value.message
    assert str(path) in refused.value.message
    assert refused.value.hint


@pytest.mark.parametrize("text", ["[[assets", "\x00"])
def test_a_damaged_manifest_is_refused(folder: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"toys\.toml cannot be read"):
        read_manifest(written(folder, text))
    with pytest.raises(InputError, match="No such file"):
        read_manifest(folder / "none.toml")


def test_numbers_may_stand_for_texts_and_underscores_for_dashes(folder: Path) -> None:
    text = '[settings]\ndrop = 3\nfilter-rate = inf\n[[assets]]\nfiles = ["models/a.usda"]'
    (group,) = read_manifest(written(folder, text)).groups
    assert group.settings == {"drop": "3", "filter_rate": float("inf")}


def test_a_material_file_is_found_from_the_manifest(folder: Path) -> None:
    text = '[settings]\nmaterial = "looks/wax.usda"\n[[assets]]\nfiles = ["models/a.usda"]'
    (group,) = read_manifest(written(folder, text)).groups
    assert group.settings["material"] == str(folder / "looks" / "wax.usda")


UNSET = """
[settings]
floor = "none"
damping_time = 0.5
repair = true
pins = ["/A"]

[matrix]
friction = ["default", 0.1]
seed = [0, 1]

[[assets]]
files = "models/a.usda"
settings = { floor = "default", damping-time = "default", repair = "default", pins = "default", seed = "default" }

[[assets]]
files = "models/b.usda"
"""  # noqa: E501


def test_a_group_takes_back_what_all_have(folder: Path) -> None:
    first, second = read_manifest(written(folder, UNSET)).groups
    assert first.settings == {}
    assert first.matrix == {"friction": ["default", 0.1]}, "what a group takes back is no axis"
    assert second.settings == {"floor": "none", "damping_time": 0.5, "repair": True, "pins": ["/A"]}


def test_null_in_json_is_the_default(folder: Path) -> None:
    rows = [{"files": "models/a.usda", "settings": {"floor": None}}]
    text = json.dumps({"settings": {"floor": "none", "seed": 3}, "assets": rows})
    (group,) = read_manifest(written(folder, text, "toys.json")).groups
    assert group.settings == {"seed": 3}


def test_the_default_is_a_value_of_an_axis(folder: Path) -> None:
    jobs = make_plan(read_manifest(written(folder, UNSET))).jobs
    assert [(job.name, job.options) for job in jobs[:2]] == [
        ("a.rubber.frictiondefault", {}), ("a.rubber.friction0.1", {"friction": 0.1}),
    ]  # fmt: skip


def test_the_default_of_no_option_is_refused(folder: Path) -> None:
    text = UNSET.replace('floor = "default"', 'flor = "default"')
    with pytest.raises(UsageError, match=r"assets 1: unknown option 'flor'"):
        read_manifest(written(folder, text))


def test_the_command_line_takes_back_what_a_manifest_sets(folder: Path) -> None:
    path = written(folder, UNSET)
    given = parse_settings(["floor=default", "damping-time=default", "friction=default"], {})
    jobs = plan_of([str(path)], Arguments(settings=given)).jobs
    assert jobs[-1].options == {"repair": True, "pins": ["/A"], "seed": 1}
    assert all({"friction", "floor"}.isdisjoint(job.options) for job in jobs)
