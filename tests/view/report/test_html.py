"""The page as a whole: its parts, its size, its words."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import pytest
from recordings import FRAMES, FallingBox, report_of

from gf_usd.core.scene import Bounds, MotionFrame, Recording
from gf_usd.view.report.curves import ENERGIES, plots, unit_for
from gf_usd.view.report.html import Html, data_script, join, policy, tag
from gf_usd.view.report.moments import bounds, choose_key_frames
from gf_usd.view.report.motion import collect
from gf_usd.view.report.record import make_record
from gf_usd.view.report.report import Limits, build_report


def data_of(page: str, name: str = "page") -> str:
    found = re.search(f'<script type="text/plain" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found
    return found[1]


@pytest.fixture(scope="module")
def page() -> str:
    return build_report([FallingBox()], report_of(), "", Limits())


def test_everything_is_inside_and_nothing_is_fetched(page):
    assert len(page.encode()) < 6_000_000  # plotly.js is 4.8 MB of it
    assert page.count("<script>") == 2
    outside = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!data:)', outside)
    assert "default-src &#x27;none&#x27;" in page
    assert "<h1>Box</h1>" in page
    assert "gf-usd bake box.usda <span>--material</span> rubber" in page
    assert "a note of the bake" in page
    assert page.count("data:image/jpeg;base64,") == 6
    assert f"all {FRAMES} frames" in page
    assert "Nothing was left out." in page


def test_the_numbers_of_the_page_are_those_of_the_motion(page):
    (variant,) = json.loads(data_of(page))["variants"]
    assert variant["codes"] == [1, 2, 3, 4, 5, 6, 7]
    assert variant["seconds"][1] == pytest.approx(1 / 24, rel=1e-5)
    assert (variant["up"], variant["ground"], variant["cell"], variant["grow"]) == (
        "Y",
        0.0,
        0.1,
        1.0,
    )
    assert [plot["title"] for plot in variant["plots"]] == [
        "Height", "Stretch", "Volume ratio J", "Energy", "Depth in the floor",
    ]  # fmt: skip
    depth = variant["plots"][4]
    assert (depth["unit"], depth["curves"][0]["y"]) == ("mm", [0, 0, 1, 1, 1, 0, 1])
    energy = {curve["name"]: curve["y"] for curve in variant["plots"][3]["curves"]}
    assert energy["total"] == pytest.approx([1.5, 2.1, 2.5, 3.5, 4.5, 5.7, 6.5])


def test_texts_cannot_become_html():
    nasty = "<script>alert(1)</script>"
    report = report_of(command=nasty, notes=[nasty, '"><img src=x>'])
    report["bakes"][0]["health"][nasty] = nasty
    page = build_report([FallingBox(name=nasty, notes=(nasty,))], report, "", Limits())
    assert nasty not in page
    assert "<img src=x>" not in page
    assert "<h1>&lt;script&gt;alert(1)&lt;/script&gt;</h1>" in page
    assert "<" not in data_of(page)
    assert tag("p", nasty, Html("<b>"), title='"') == (
        '<p title="&quot;">&lt;script&gt;alert(1)&lt;/script&gt;<b></p>'
    )
    assert join([tag("input", type="range"), "&"]) == '<input type="range">&amp;'
    assert data_script("x", '{"a":"</script><!--"}').count("</script>") == 1


def test_the_policy_names_the_scripts_by_their_hash():
    # printf 'alert(1)' | openssl dgst -sha256 -binary | base64
    assert "'sha256-bhHHL3z2vDgxUt0W3dWQOrprscmda2Y5pLsLg4GF+pI='" in policy(["alert(1)"])


@pytest.mark.slow
def test_a_page_is_thinned_to_its_size_and_says_so():
    source = FallingBox(gaussians=20_000)
    whole = len(build_report([source], report_of(), "", Limits()).encode())
    size = whole - 20_000
    page = build_report([source], report_of(), "", Limits(size=size))
    assert len(page.encode()) <= size
    kept, of = re.search(r"<li>(\d+) of (\d+) Gaussians</li>", page).groups()
    assert int(of) == 20_000
    # a fifth is for 20 kB of 900 kB, and for the room that is kept for larger pictures
    assert 10_000 < int(kept) < 20_000
    assert "left out to keep the page small" in page
    assert "all 8 mesh vertices" in page
    assert "times as large to fill the gaps" in page


def test_frames_are_left_out_when_asked_for():
    page = build_report([FallingBox()], report_of(), "", Limits(frames=3))
    (variant,) = json.loads(data_of(page))["variants"]
    assert variant["codes"] == [1, 4, 7]
    assert f"3 of {FRAMES} frames" in page
    # health is of every frame all the same
    assert len(variant["plots"][3]["curves"][0]["x"]) == FRAMES


def test_without_a_report_curves_are_of_the_geometry():
    page = build_report([FallingBox()], {}, "box.report.json is gone", Limits())
    (variant,) = json.loads(data_of(page))["variants"]
    assert [plot["title"] for plot in variant["plots"]] == ["Height", "Stretch", "Volume ratio J"]
    assert [c["name"] for c in variant["plots"][0]["curves"]] == ["highest", "center", "lowest"]
    assert "Missing:" in page


@pytest.mark.slow
def test_several_variants_have_a_switch():
    report = report_of()
    report["bakes"] += report_of(look="jelly")["bakes"]
    page = build_report([FallingBox(), FallingBox(variant="jelly")], report, "", Limits())
    assert len(json.loads(data_of(page))["variants"]) == 2
    assert data_of(page, "motion-1")
    assert page.count('role="tab"') == 2


def test_drift_is_drawn_where_the_bake_measured_it():
    source = FallingBox()
    recording = source.recording()
    motion = collect(recording, source.frames(recording.time_codes), 100, 100)
    report = report_of()
    for i, frame in enumerate(report["bakes"][0]["per_frame"]):
        frame["drift_mean"] = 1e-5 * i
    drift = plots(motion, make_record(recording, report, ""))[-1]
    assert (drift["title"], drift["unit"]) == ("Drift", "µm")
    assert drift["curves"][0]["y"][-1] == pytest.approx(60.0)


def test_units_suit_the_largest_value():
    lengths = ((1.0, "m"), (1e-2, "cm"), (1e-3, "mm"))
    assert unit_for([0.5, None], lengths) == 1e-2
    assert unit_for([-3.0], lengths) == 1.0
    assert unit_for([], lengths) == 1e-3


def test_pictures_are_taken_where_something_happens():
    source = FallingBox()
    recording = source.recording()
    motion = collect(recording, source.frames(recording.time_codes), 100, 100)
    assert [text for _, text in choose_key_frames(motion, 5)] == [
        "start", "contact", "squashed", "rebound", "end",
    ]  # fmt: skip
    assert [frame for frame, _ in choose_key_frames(motion, 5)] == [0, 2, 3, 5, 6]
    # more pictures than frames are not to be had
    assert [frame for frame, _ in choose_key_frames(motion, 50)] == list(range(FRAMES))


def test_pictures_contain_what_the_recording_says_and_end_where_all_has_left_it():
    source = FallingBox()
    box = Bounds(low=(0.0, 0.5, 0.0), high=(1.0, 2.0, 1.0))
    codes = source.recording().time_codes
    recording = replace(source.recording(), framed=box, shown_until=codes[3])
    motion = collect(recording, source.frames(codes), 100, 100)
    assert bounds(motion) == (box.low, box.high)
    found = choose_key_frames(motion, 3)
    assert (found[0], found[-1]) == ((0, "start"), (3, "squashed"))
    assert choose_key_frames(motion, 9) == [
        (0, "start"), (1, ""), (2, "contact"), (3, "squashed"),
    ]  # fmt: skip
    # the last of these is not the end of the motion
    away = replace(motion, recording=replace(recording, shown_until=codes[4], ground=None))
    assert choose_key_frames(away, 2) == [(0, "start"), (4, "")]


def test_energies_of_large_bodies_have_a_prefix():
    # a car of 467 m that falls by 418 m
    assert [unit_for([energy], ENERGIES) for energy in (5.977e13, 2e9, 999.0)] == [1e12, 1e9, 1.0]


class LateBox(FallingBox):
    """The falling box from time code 1,000,001 on, as in a long sequence."""

    def recording(self) -> Recording:
        first = super().recording()
        return replace(first, time_codes=tuple(1e6 + code for code in first.time_codes))

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]:
        for frame in super().frames([code - 1e6 for code in time_codes]):
            yield replace(frame, time_code=frame.time_code + 1e6)


def test_time_codes_of_seven_digits_are_whole():
    page = build_report([LateBox()], report_of(), "", Limits())
    (variant,) = json.loads(data_of(page))["variants"]
    assert variant["codes"] == [1e6 + k for k in range(1, FRAMES + 1)]
    shown = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    # captions of six pictures, which were 1e+06
    assert len(set(re.findall(r"\b100000\d\b", shown))) == 6
    assert "1e+06" not in shown
