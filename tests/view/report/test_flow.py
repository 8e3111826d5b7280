"""Surfaces whose faces change, on the page: every frame with triangles of its own."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import FRAMES, TRIANGLES, FallingBox, MeltingBox, report_of, unpack

from gf_usd.view.report.moments import bounds
from gf_usd.view.report.motion import Motion, collect
from gf_usd.view.report.pack import pack
from gf_usd.view.report.report import Limits, build_report


def collected(most: int = 100, gaussians: int = 30) -> Motion:
    source = MeltingBox(gaussians=gaussians)
    recording = source.recording()
    return collect(recording, source.frames(recording.time_codes), most, 30)


def test_every_frame_has_its_own_vertices_and_triangles() -> None:
    motion = collected()
    assert motion.flow is not None
    assert motion.points.shape == (FRAMES, 0, 3), "nothing keeps its faces"
    starts = motion.flow.starts
    assert np.diff(starts[:, 0]).tolist() == [8] * FRAMES
    assert np.diff(starts[:, 1]).tolist() == [11, 12, 11, 12, 11, 12, 11]
    table, blob = pack(motion)
    assert np.array_equal(unpack(table, blob, "flowStarts"), starts)
    code = unpack(table, blob, "flowPoints")
    step = np.array(table["flowPoints"]["step"])
    places = table["flowPoints"]["low"] + code * step
    box = FallingBox()
    for frame in range(FRAMES):
        (v, t), (v_end, t_end) = starts[frame], starts[frame + 1]
        assert np.abs(places[v:v_end] - box.points(frame)).max() <= 0.5 * step.max() + 1e-7
        corners = unpack(table, blob, "flowCorners")[t:t_end]
        assert np.array_equal(corners, TRIANGLES[: t_end - t])
    # linear 0.8 is 0.906 of sRGB
    assert unpack(table, blob, "flowColors")[0].tolist() == [231, 124, 89]


def test_meshes_that_keep_their_faces_need_none_of_it() -> None:
    source = FallingBox()
    recording = source.recording()
    motion = collect(recording, source.frames(recording.time_codes), 100, 30)
    assert motion.flow is None
    assert "flowStarts" not in pack(motion)[0]


@pytest.mark.parametrize("gaussians", [0, 40])
def test_the_view_holds_the_whole_motion(gaussians: int) -> None:
    low, high = bounds(collected(gaussians=gaussians))
    assert low[1] == pytest.approx(0.0, abs=1e-6)
    assert high[1] == pytest.approx(0.7)


@pytest.mark.slow
@pytest.mark.acceptance
def test_the_page_says_what_it_left_out() -> None:
    page = build_report([MeltingBox()], report_of(), "", Limits())
    assert "all 56 vertices of flowing surfaces" in page
