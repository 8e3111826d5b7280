"""The acceptance tool: what it writes, without the long runs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
CURVE = {
    "title": "a curve, falling", "x_label": "h", "y_label": "error <", "x": [0.5, 0.25, 0.125],
    "y": [0.1, 0.025, 0.006], "logarithmic": True, "target": None,
}  # fmt: skip


def rows(passed: bool) -> list[dict]:
    return [
        {
            "name": "bar.order", "value": 1.98, "target": 2.0, "error": 0.02, "bound": 0.1,
            "pass": True, "kind": "at least", "unit": "", "why": "second order", "case": "bar",
            "what": "A bar.", "source": "closed form", "seconds": 1.0, "curve": CURVE,
        },
        {
            "name": "bar.frequency", "value": None, "target": 49.7, "error": None, "bound": 0.01,
            "pass": passed, "kind": "relative", "unit": "rad/s", "why": "lumped mass",
            "case": "bar", "what": "A bar.", "source": "closed form", "seconds": 1.0,
        },
    ]  # fmt: skip


def made(passed: bool, folder: Path, date: str | None = None) -> Path:
    """A record as the section `verify` saves it."""
    from dataclasses import replace

    from tools.acceptance.record import record, save
    from tools.acceptance.sections import SECTIONS

    section = SECTIONS["verify"]
    done = subprocess.CompletedProcess(
        section.command, 0 if passed else 1, json.dumps({"cases": rows(passed)})
    )
    entry = record("verify", section.title, section.command, 12.34, section.read(done))
    return save(replace(entry, date=date) if date else entry, folder)


def test_a_record_says_what_it_was_measured_on(tmp_path: Path) -> None:
    path = made(True, tmp_path)
    saved = json.loads(path.read_text("utf-8"))
    assert path.name == f"{saved['date'][:10]}-verify.json"
    assert {"commit", "changed", "machine", "versions", "command", "seconds"} <= set(saved)
    assert saved["command"] == "gf-usd verify --full --json"
    assert saved["versions"]["taichi"]
    assert saved["outcome"]["data"]["cases"] == rows(True)
    assert [p.name for p in tmp_path.iterdir()] == [path.name], "nothing half-written is left"


def test_the_page_shows_the_newest_of_a_section(tmp_path: Path) -> None:
    from tools.acceptance.record import newest, page

    made(False, tmp_path, "2001-02-03T04:05:06Z")
    made(True, tmp_path, "2002-02-03T04:05:06Z")
    (record,) = newest(tmp_path)
    text = page([record])
    assert "2002-02-03" in text
    assert "2001" not in text
    assert "Passed: 2 of 2 figures in 1 cases" in text
    failed = json.loads((tmp_path / "2001-02-03-verify.json").read_text("utf-8"))
    assert "**Failed**: 1 of 2 figures in 1 cases; failed: bar.frequency" in page([failed])


def test_claims_about_a_batch_are_read_one_by_one() -> None:
    from tools.acceptance.sections import read_batch

    good = {"engine": "Dask", "claim": "all is done", "found": "18", "holds": True}
    bad = {"engine": "Dask", "claim": "none is lost", "found": "1", "holds": False}
    for claims, passed in (([good], True), ([good, bad], False)):
        tree = {"claims": claims, "seconds": {"dask": 61.2}, "jobs": 18}
        outcome = read_batch(subprocess.CompletedProcess((), 0, json.dumps(tree)))
        assert outcome.passed is passed
        assert len(outcome.table) == len(claims) + 1
    assert outcome.summary == "1 of 2 claims held (dask 61 s); not: none is lost"
    assert outcome.table[2][-1] == "**FAIL**"


def test_a_run_that_printed_nothing_is_no_result() -> None:
    from tools.acceptance.sections import read_batch, read_verify

    with pytest.raises(SystemExit, match="status 1"):
        read_batch(subprocess.CompletedProcess(("x",), 1, ""))
    with pytest.raises(SystemExit, match="exit status 3"):
        read_verify(subprocess.CompletedProcess(("x",), 3, ""))


def test_the_page_of_the_cases_and_its_plots(tmp_path: Path) -> None:
    from xml.etree import ElementTree

    from tools.acceptance.record import newest
    from tools.acceptance.verify_page import pages

    made(False, tmp_path)
    files = {path.name: text for path, text in pages(newest(tmp_path)[0]).items()}
    assert set(files) == {"verification.md", "verify-a-curve-falling.svg"}
    text = files["verification.md"]
    assert "## bar\n\nA bar.\n\nSource: closed form." in text
    assert "| order | 1.98  | at least 2 | 0.02 | 0.1 | pass |" in text
    assert "| frequency | none rad/s | 49.7 | none | 1 % | **FAIL** |" in text
    assert "- order: second order." in text
    drawing = ElementTree.fromstring(files["verify-a-curve-falling.svg"])
    dots = drawing.findall("{http://www.w3.org/2000/svg}circle")
    # Halving h quarters the error: equal steps on both logarithmic axes, within the figures given.
    x = [float(dot.attrib["cx"]) for dot in dots]
    y = [float(dot.attrib["cy"]) for dot in dots]
    assert x[0] - x[1] == pytest.approx(x[1] - x[2], abs=0.2)
    assert y[1] - y[0] == pytest.approx(y[2] - y[1], rel=0.05)


def test_a_curve_of_one_point_is_no_plot(tmp_path: Path) -> None:
    from tools.acceptance.record import newest
    from tools.acceptance.verify_page import pages

    made(False, tmp_path)
    record = newest(tmp_path)[0]
    for row in record["outcome"]["data"]["cases"]:
        if "curve" in row:
            row["curve"]["x"], row["curve"]["y"] = row["curve"]["x"][:1], row["curve"]["y"][:1]
    files = {path.name: text for path, text in pages(record).items()}
    assert set(files) == {"verification.md"}
    assert ".svg" not in files["verification.md"]


def test_only_known_sections_run() -> None:
    done = subprocess.run(
        [sys.executable, str(TOOLS / "acceptance.py"), "--only", "nothing"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "verify" in done.stderr


def test_the_section_of_plastic_flow_has_cases_that_there_are() -> None:
    from gf_usd.verify.registry import select
    from tools.acceptance.sections import FLOWS, PLASTIC, SECTIONS

    assert {case.name for case in select(FLOWS)} == set(FLOWS)
    assert [word for word in SECTIONS[PLASTIC].command if word in FLOWS] == list(FLOWS)


def test_the_longest_tests_are_read_one_by_one() -> None:
    from tools.acceptance.sections import read_tests

    output = (
        "..F\nPASSED tests/a.py::one\nPASSED tests/a.py::two[x - y]\n"
        "FAILED tests/b.py::three - assert 1 == 2\nPASSED of nothing\n"
    )
    outcome = read_tests(subprocess.CompletedProcess([], 1, output))
    assert not outcome.passed
    assert outcome.summary == "2 of 3 tests passed; not `tests/b.py::three`"
    assert outcome.table[-1] == ("`tests/b.py::three`", "**FAIL**")
    assert read_tests(subprocess.CompletedProcess([], 0, "PASSED tests/a.py::one\n")).passed
    assert not read_tests(subprocess.CompletedProcess([], 5, "")).passed, "no test ran"


def test_bakes_with_limbs_are_read_one_by_one() -> None:
    from tools.acceptance.sections import read_limbs

    good = {
        "asset": "hand", "look": "rubber", "seconds": 1.0, "particles": 8000, "inside": 0.0004,
        "figures": {
            "min_J": 0.3, "inverted_max": 0, "rollbacks": 0, "deepest_overlap_spacings": 0.2,
        },
        "fault": "", "date": "2001-02-03T04:05:06Z", "commit": "0123456789abcdef",
    }  # fmt: skip
    bad = {**good, "look": "jelly", "inside": None, "figures": None, "fault": "status 1: no"}
    for runs, passed in (([good], True), ([good, bad], False)):
        done = subprocess.CompletedProcess([], 0 if passed else 1, json.dumps({"runs": runs}))
        outcome = read_limbs(done)
        assert outcome.passed is passed
    assert outcome.summary.startswith("1 of 2 bakes")
    assert outcome.summary.endswith("not: hand jelly")
    assert outcome.table[1][3] == "0.04 %"
    assert outcome.table[1][-2] == "2001-02-03 `0123456789ab`"
    assert all(len(row) == len(outcome.table[0]) for row in outcome.table)
    assert outcome.table[2][-1] == "**FAIL** status 1: no"


def test_assets_at_defaults_are_read_one_by_one() -> None:
    from tools.acceptance.sections import read_assets

    one = {"ending": "baked", "words": "1 mesh", "seconds": 2.0, "date": "2001-02-03", "commit": ""}
    two = {**one, "asset": "b.usda", "ending": "failed", "words": "3 frames redone"}
    for last, passed in (({**two, "ending": "refused"}, True), (two, False)):
        tree = {"outcomes": [{**one, "asset": "a.usda"}, last], "changed": []}
        done = subprocess.CompletedProcess([], 0 if passed else 1, json.dumps(tree))
        outcome = read_assets(done)
        assert outcome.passed is passed
    assert outcome.summary.endswith("0 refused in words, 1 failed: b.usda")
    assert outcome.table[2] == ("`b.usda`", "2", "3 frames redone", "2001-02-03 ``", "**FAIL**")


def test_a_record_of_assets_has_no_paths() -> None:
    from argparse import Namespace

    from tools.acceptance.sections import arguments_of

    options = Namespace(
        assets="/a/b", keep="/c", recorded="/d/e.json", rows="/f/g.jsonl", kept=True
    )  # fmt: skip
    more, shown = arguments_of("limbs", options)
    assert more == ["/a/b", "--keep", "/c", "--recorded", "/d/e.json", "--kept"]
    assert shown == ["ASSETS", "--keep", "FOLDER", "--recorded", "e.json", "--kept"]
    more, shown = arguments_of("assets", options)
    assert more == ["/a/b", "--rows", "/f/g.jsonl", "--kept"]
    assert shown == ["ASSETS", "--rows", "g.jsonl", "--kept"]
    more, shown = arguments_of("jitter", options)
    assert more == ["--rows", "/f/g.jsonl", "--kept"]
    assert shown == ["--rows", "g.jsonl", "--kept"]
    assert arguments_of("verify", options) == ([], [])


def test_jittered_runs_continue_from_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only rows of the given seed are taken."""
    from dataclasses import asdict

    from tools.acceptance.jitter import Ran, main

    one = Ran(scene="duck.usda", number=0, command="", place=(0, 0, 0), turned=0.0, seconds=1.0)
    rows = tmp_path / "rows.jsonl"
    lines = [asdict(one), {**asdict(one), "number": 1, "seed": 1}]
    rows.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert main(["--rows", str(rows), "--kept", "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [(run["scene"], run["number"]) for run in runs] == [("duck.usda", 0)]
