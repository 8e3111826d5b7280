"""The page of a batch as text: what it holds, and that names cannot become code."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

from batch_jobs import job, outcome
from PIL import Image

from gf_usd.batch.job import Outcome
from gf_usd.batch.page import COLUMNS, build_page, data_uri, picture_of
from gf_usd.batch.plan import BatchPlan
from gf_usd.batch.verdict import attempt_outcome
from gf_usd.system.processes import ProcessResult

NASTY = "<script>document.title='owned'</script>"
HEALTH = {"rollbacks": 2, "deepest_penetration_spacings": 0.5, "energy_gain_max_share": 1e-5}


class Table(HTMLParser):
    """The rows of the page's table: attributes of the row, and texts of its cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open = True
        self.rows: list[tuple[dict[str, str | None], list[str]]] = []
        self.images: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr":
            self.rows.append((dict(attrs), []))
        elif tag in ("td", "th"):
            self.rows[-1][1].append("")
        elif tag == "img":
            self.images.append(dict(attrs)["src"] or "")

    def handle_endtag(self, tag: str) -> None:
        self.open = self.open and tag != "table"

    def handle_data(self, data: str) -> None:
        if self.open and self.rows and self.rows[-1][1]:
            self.rows[-1][1][-1] += data


def page(folder: Path) -> str:
    plan = BatchPlan(
        jobs=tuple(job(folder, name) for name in ("good", "bad", "never")),
        out=folder / "out", title=NASTY, timeout=None, retries=1,
    )  # fmt: skip
    plan.out.mkdir()
    root = plan.jobs[0].root
    Image.new("RGB", (192, 144), (200, 30, 10)).save(picture_of(root))
    warning = {"look": "rubber", "message": NASTY}
    ends = [
        outcome("good", "done", root=str(root), health=HEALTH, warnings=(warning,), attempts=1,
                seconds=3.25, cpu_seconds=3.0, peak_memory=300_000_000, particles=120, frames=4),
        outcome("bad", "crashed", message=NASTY, hint="fewer at once", log="SIGSEGV", attempts=2),
    ]  # fmt: skip
    entry = {"repeat": "gf-usd batch x --select bad", "seconds": 5.0, "finished": "now"}
    return build_page(plan, ends, entry, {root: "too dark"})


def test_failures_are_on_top_with_why_and_what_to_do(tmp_path: Path) -> None:
    text = page(tmp_path)
    head, bad, good = Table(text).rows
    assert len(head[1]) == len(bad[1]) == len(good[1]) == len(COLUMNS)
    assert bad[0]["data-kind"] == "bad"
    assert good[0]["data-kind"] == "warned"
    for message in (NASTY, "fewer at once", "SIGSEGV"):
        assert message in bad[1][1]
    assert "too dark" in good[1][1]
    numbers = good[1][3:]
    assert numbers == ["1", "2", "", "0.50", "1.0e-05", "120", "4", "", "3.2", "3.0", "300", "1"]
    assert "One job needs attention" in text
    assert "gf-usd batch x --select bad" in text
    assert "1 job has not been run yet: never" in text


def test_an_energy_gain_of_zero_has_no_exponent(tmp_path: Path) -> None:
    plan = BatchPlan(jobs=(job(tmp_path, "a"),), out=tmp_path, title="t", timeout=None, retries=1)
    health = {"energy_gain_max_share": 0.0}
    text = build_page(plan, [outcome("a", "done", health=health)], {"repeat": "gf-usd batch x"}, {})
    gain = next(k for k, column in enumerate(COLUMNS) if "energy gain" in column)
    assert Table(text).rows[1][1][gain] == "0"
    assert "0.0e+00" not in text


def test_a_slice_is_no_fault(tmp_path: Path) -> None:
    jobs = tuple(job(tmp_path, name) for name in ("long", "bad"))
    plan = BatchPlan(jobs=jobs, out=tmp_path, title="t", timeout=None, retries=1)
    sliced = outcome("long", "sliced", message="rubber: 5 of 9 frames are done")
    entry = {"repeat": "gf-usd batch x"}
    text = build_page(plan, [sliced], entry, {})
    assert Table(text).rows[1][0]["data-kind"] == "begun"
    assert "One job has remaining frames. To repeat only these:" in text
    assert "with remaining frames 1" in text
    assert "1 job, 0 good" in text
    assert "need attention 0" in text
    both = build_page(plan, [sliced, outcome("bad", "failed")], entry, {})
    assert "One job needs attention; One job has remaining frames." in both


def test_notes_and_warnings_of_a_bake_are_on_the_page(tmp_path: Path) -> None:
    """Also those that the record of an earlier run holds."""
    warning = {"variant": "rubber", "message": "still in the air", "hint": "use more --frames"}
    result = {
        "bakes": [{"frames": 9, "health": {}}], "warnings": [warning], "check": [], "outputs": [],
        "notes": ["floor at 0", "gravity is 1.62 m/s^2", "30 fps", "</A/Hat> is not baked", NASTY],
    }  # fmt: skip
    one = job(tmp_path, "a")
    ended = ProcessResult(
        status=0, out="", err="", seconds=1.0, cpu_seconds=1.0, peak_memory=1, timed_out=False,
        stopped=False,
    )  # fmt: skip
    made = attempt_outcome(one, ended, {"finished": result}).outcome
    plan = BatchPlan(jobs=(one,), out=tmp_path, title="t", timeout=None, retries=1)
    text = build_page(plan, [Outcome.of(made.as_json())], {}, {})
    attributes, cells = Table(text).rows[1]
    for message in ("warning: rubber: still in the air", "use more --frames", "note: floor at 0"):
        assert message in cells[1]
    assert "2 more notes" in cells[1]
    assert "note: </A/Hat> is not baked" in cells[1], "can be opened"
    assert "gravity is 1.62" in str(attributes["data-text"]), "can be searched"
    assert NASTY not in text


def test_it_is_self_contained_and_safe(tmp_path: Path) -> None:
    text = page(tmp_path)
    assert NASTY not in text
    # one script, ours, and the policy names its hash
    assert len(re.findall(r"<script", text)) == 1
    assert "default-src &#x27;none&#x27;" in text
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    (image,) = Table(text).images
    assert image.startswith("data:image/jpeg;base64,")
    # a few kilobytes a job: thousands of jobs still make a page that opens
    assert len(image) < 10_000


def test_a_damaged_picture_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    assert data_uri(path) == ""
    path.write_bytes(b"\x89PNG\r\n\x1a\n cut short")
    assert data_uri(path) == ""
