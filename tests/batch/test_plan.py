"""Jobs of a manifest: combinations, names, and files that two must not share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gf_usd.batch.manifest import Group, Manifest
from gf_usd.batch.plan import BatchPlan, jobs_matching, make_plan, with_output_folder
from gf_usd.core.errors import UsageError

PLY, SPZ = {"export_ply": "frames"}, {"export_spz": "frames"}


def plan(folder: Path, *groups: dict[str, Any]) -> BatchPlan:
    """A plan of groups given as files, settings, matrix and name."""
    made = tuple(
        Group(
            files=tuple(folder / name for name in group["files"]),
            settings=group.get("settings", {}),
            matrix=group.get("matrix", {}),
            name=group.get("name"),
        )
        for group in groups
    )
    return make_plan(Manifest(groups=made, folder=folder, title="t", out=folder / "out"))


def names(found: BatchPlan) -> list[str]:
    return [job.name for job in found.jobs]


def test_every_combination_is_a_job_named_by_what_differs(tmp_path: Path) -> None:
    matrix = {"seed": [0, 1], "material": ["rubber", "jelly"], "frames": [4]}
    found = plan(tmp_path, {"files": ["a.usda", "b.usda"], "matrix": matrix})
    assert names(found) == [
        f"{asset}.{look}.seed{seed}"
        for asset in "ab" for look in ("rubber", "jelly") for seed in (0, 1)
    ]  # fmt: skip
    job = found.jobs[3]
    assert job.root == tmp_path / "out" / "a.jelly.seed1.usda"
    assert job.options == {"material": "jelly", "seed": 1, "frames": 4}
    assert job.record.name == "a.jelly.seed1.job.json"
    assert job.arguments() == [
        "bake", str(tmp_path / "a.usda"), "--output", str(job.root),
        "--material", "jelly", "--seed", "1", "--frames", "4",
    ]  # fmt: skip


def test_a_template_makes_folders_and_mends_odd_values(tmp_path: Path) -> None:
    group = {
        "files": ["props/red duck.usda"],
        "settings": {"gravity": "0,0,-9.81", "material": str(tmp_path / "wax.usda")},
        "name": "{folder}/{asset}_{material}_{gravity}",
    }
    (job,) = plan(tmp_path, group).jobs
    assert job.name == "props/red-duck_wax_0-0-9.81"
    assert job.root == tmp_path / "out" / "props" / "red-duck_wax_0-0-9.81.usda"


def test_letters_of_any_script_stay_in_a_name(tmp_path: Path) -> None:
    decomposed = "Gro\u0308\u00dfe 1.usda"  # as macOS has it
    found = plan(tmp_path, {"files": ["鴨/鴨.usda", "鴨/犬.usda", decomposed, "d\udcfcck.usda"]})
    assert names(found) == ["鴨.rubber", "犬.rubber", "Größe-1.rubber", "d-ck.rubber"]


def test_assets_whose_names_differ_in_signs_alone_are_to_be_renamed(tmp_path: Path) -> None:
    """The hint was a --name with the same fields."""
    with pytest.raises(UsageError, match="would both write") as refused:
        plan(tmp_path, {"files": ["a b.usda", "a-b.usda"]})
    assert refused.value.hint.startswith("rename one of the assets: ")
    assert refused.value.hint.endswith("both are 'a-b'")
    assert names(plan(tmp_path, {"files": ["a b.usda", "a_b.usda"]})) == [
        "a-b.rubber",
        "a_b.rubber",
    ]


def test_flags_and_lists_become_words(tmp_path: Path) -> None:
    settings = {"repair": True, "stress": False, "wls": False, "pins": ["/A", "/B"], "drop": "1r"}
    (job,) = plan(tmp_path, {"files": ["a.usda"], "settings": settings}).jobs
    assert job.arguments()[4:] == [
        "--repair", "--no-wls", "--pin", "/A", "--pin", "/B", "--drop", "1r",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        # two assets of one name
        ([{"files": ["x/a.usda", "y/a.usda"]}], "would both write"),
        # a template that leaves an axis out
        ([{"files": ["a.usda"], "matrix": {"seed": [0, 1]}, "name": "{asset}"}], "both write"),
        # two mesh files of one name would share a layer under it
        ([{"files": ["x/a.obj", "y/a.obj"], "name": "{folder}.{asset}"}], "a.source.usdc"),
        # and one that is read in two ways as well
        ([{"files": ["a.obj"], "matrix": {"up_axis": ["Y", "Z"]}}], "a.source.usdc"),
        # roots of their own, but one sequence of splat files
        ([{"files": ["a.ply"], "settings": PLY, "matrix": {"seed": [0, 1]}}], "frames/a.rubber."),
        ([{"files": ["x/a.ply", "y/a.ply"], "settings": SPZ, "name": "{folder}.{asset}"}],
         "frames/a.rubber."),
        ([{"files": ["x/a.ply"], "settings": PLY, "name": "one"},
          {"files": ["y/a.ply"], "settings": PLY, "name": "two"}], "frames/a.rubber."),
        ([{"files": ["a.usda"], "name": "{asset}.{speed}"}], "{speed}"),
        ([{"files": ["a.usda"], "name": "../{asset}"}], "'../a'"),
        ([{"files": ["a.usda"], "name": "{asset"}], "is damaged"),
        ([{"files": ["a.usda"], "name": "{asset:d}"}], "formats the field 'asset'"),
        ([{"files": ["a.usda"], "name": "{asset!r}"}], "formats the field 'asset'"),
        # files next to the root have longer names, and a file system has an end of them
        ([{"files": ["a.usda"], "name": "b/" + 201 * "x"}], "of 201 bytes"),
        ([{"files": ["a.usda"], "name": 101 * "ü"}], "of 202 bytes"),
    ],
)  # fmt: skip
def test_names_that_cannot_be_are_refused(
    tmp_path: Path, groups: list[dict[str, Any]], message: str
) -> None:
    with pytest.raises(UsageError) as refused:
        plan(tmp_path, *groups)
    assert message in refused.value.message


def test_results_cannot_be_in_a_file(tmp_path: Path) -> None:
    """It is refused before anything runs, and not by every job."""
    made = plan(tmp_path, {"files": ["a.usda"]})
    file = tmp_path / "notes.txt"
    file.write_text("")
    for out in (file, file / "below"):
        with pytest.raises(UsageError) as refused:
            with_output_folder(made, out)
        assert refused.value.message == f"{file} is not a folder"


def test_jobs_of_one_mesh_file_may_share_its_layer(tmp_path: Path) -> None:
    found = plan(tmp_path, {"files": ["a.obj"], "matrix": {"seed": [0, 1, 2]}})
    assert len(found.jobs) == 3


def test_sequences_of_splats_in_folders_or_forms_of_their_own_do_not_meet(tmp_path: Path) -> None:
    apart = {"export_ply": ["one", "two"], "seed": [0]}
    assert len(plan(tmp_path, {"files": ["a.ply"], "matrix": apart}).jobs) == 2
    ply = {"files": ["a.ply"], "settings": PLY, "name": "ply"}
    spz = {"files": ["a.ply"], "settings": SPZ, "name": "spz"}
    assert len(plan(tmp_path, ply, spz).jobs) == 2
    variant_names = {
        "files": ["a.ply"],
        "settings": PLY,
        "matrix": {"material": ["rubber", "jelly"]},
    }
    assert len(plan(tmp_path, variant_names).jobs) == 2


def test_jobs_are_chosen_by_name_or_pattern(tmp_path: Path) -> None:
    found = plan(tmp_path, {"files": ["a.usda", "b.usda"], "matrix": {"seed": [0, 1]}})
    chosen = jobs_matching(found, ["b.*", "a.rubber.seed1"])
    assert [job.name for job in chosen] == ["a.rubber.seed1", "b.rubber.seed0", "b.rubber.seed1"]
    with pytest.raises(UsageError, match="no job matches c"):
        jobs_matching(found, ["c*"])
