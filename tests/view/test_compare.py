"""Two motions compared: distances, volumes and centers in closed form, pairing, times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import BOX, FRAMES, SIDE, FallingBox, MeltingBox

from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.scene import MotionFrame, Recording
from gf_usd.view.compare import Y_UP_TO_Z_UP, compare_motions, parse_tolerance, with_tolerance

EPS = np.finfo(np.float64).eps


class Changed(FallingBox):
    """The falling box with its points moved by a function of the frame, and another recording."""

    def __init__(
        self,
        move: Callable[[np.ndarray, int], np.ndarray] = lambda x, frame: x,
        **recording: object,
    ) -> None:
        super().__init__(gaussians=0)
        self._move = move
        if (names := recording.pop("names", None)) is not None:
            shapes = [replace(self._recording.meshes[0], name=name) for name in names]  # type: ignore[union-attr]
            recording |= {"meshes": tuple(shapes), "baked": (True,) * len(shapes)}
        self._recording: Recording = replace(self._recording, **recording)  # type: ignore[arg-type]

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]:
        for code in time_codes:
            index = int(np.argmin(np.abs(np.asarray(self._recording.time_codes) - code)))
            x = self._move(self.points(min(index, FRAMES - 1)), index)
            yield MotionFrame(time_code=code, meshes=(x,) * len(self._recording.meshes))


def test_a_motion_is_the_same_as_itself() -> None:
    found = compare_motions(FallingBox(), FallingBox())
    assert found.error == 0.0
    assert found.same
    assert found.first_over is None
    assert np.array_equal(found.volumes[:, 0], found.volumes[:, 1])
    assert len(found.time_codes) == FRAMES


def test_a_shift_is_the_distance_of_points_and_centers() -> None:
    d = np.array([0.03, -0.04, 0.12])  # 0.13 long
    found = compare_motions(Changed(), Changed(lambda x, frame: x + d * frame))
    expected = 0.13 * np.arange(FRAMES)
    for values in (found.largest, found.rms, found.center):
        np.testing.assert_allclose(values, expected, atol=32 * EPS)
    assert found.worst_frame == FRAMES - 1
    assert with_tolerance(found, 0.2).first_over == 3.0  # 0.26 at the third time code
    assert not with_tolerance(found, 0.2).same
    assert with_tolerance(found, 1.0).same


def test_a_stretch_about_the_center_changes_the_volume_and_not_the_center() -> None:
    def stretched(x: np.ndarray, frame: int) -> np.ndarray:
        middle = x.mean(0)
        return middle + (x - middle) * (1.0, 1.0, 1.0 + 0.1 * frame)

    found = compare_motions(Changed(), Changed(stretched))
    frames = np.arange(FRAMES)
    np.testing.assert_allclose(
        found.volumes[:, 1] / found.volumes[:, 0], 1.0 + 0.1 * frames, rtol=32 * EPS
    )
    np.testing.assert_allclose(found.center, 0.0, atol=32 * EPS)
    # every corner is half a side from the middle along z
    np.testing.assert_allclose(found.largest, 0.05 * frames * SIDE, atol=32 * EPS)
    np.testing.assert_allclose(found.rms, found.largest, atol=32 * EPS)


def test_one_point_is_found() -> None:
    def dented(x: np.ndarray, frame: int) -> np.ndarray:
        out = x.copy()
        out[5, 1] += 0.01 if frame == 4 else 0.0
        return out

    found = compare_motions(Changed(), Changed(dented))
    assert found.worst == ("/Box", 5)
    assert found.time_codes[found.worst_frame] == 5.0
    assert found.error == pytest.approx(0.01, rel=1e-12)
    assert found.rms[4] == pytest.approx(0.01 / np.sqrt(8), rel=1e-12)


def test_the_volume_of_a_box_far_from_the_origin() -> None:
    far = lambda x, frame: x + 1e4  # noqa: E731
    found = compare_motions(Changed(far), Changed(far))
    # coordinates of 1e4 are exact to 1e4 eps, over half a side of 0.1
    assert found.volumes[0, 0] == pytest.approx(SIDE**3, rel=100 * 1e5 * EPS)


def test_an_open_surface_has_the_mean_of_its_points() -> None:
    flat = lambda x, frame: x * (1.0, 0.0, 1.0)  # noqa: E731
    moved = lambda x, frame: flat(x, frame) + (0.5, 0.0, 0.0)  # noqa: E731
    found = compare_motions(Changed(flat), Changed(moved))
    np.testing.assert_allclose(found.center, 0.5, rtol=32 * EPS)
    assert np.all(found.volumes == 0.0)


def test_meshes_are_paired_by_path_then_by_name() -> None:
    a = Changed(names=("/A/left", "/A/right"))
    b = Changed(names=("/root/right", "/A/left", "/root/more"))
    found = compare_motions(a, b)
    assert found.meshes == (("/A/left", "/A/left"), ("/A/right", "/root/right"))
    assert "</A/right> is compared with </root/right>" in found.notes
    assert any("not in" in note and "/root/more" in note for note in found.notes)


def test_a_single_mesh_may_have_another_name() -> None:
    found = compare_motions(Changed(), Changed(names=("/exported/duck_mesh",)))
    assert found.meshes == (("/Box", "/exported/duck_mesh"),)


def test_other_meshes_are_refused_in_words() -> None:
    with pytest.raises(
        InputError, match=r"no mesh in common: the first has </A/x>, </A/y>"
    ) as error:
        compare_motions(Changed(names=("/A/x", "/A/y")), Changed(names=("/B/p", "/B/q")))
    assert "names" in error.value.hint


def test_another_number_of_points_is_refused() -> None:
    fewer = Changed()
    shape = fewer.recording().meshes[0]
    fewer._recording = replace(
        fewer.recording(), meshes=(replace(shape, points=BOX[:7], triangles=shape.triangles[:1]),)
    )
    with pytest.raises(InputError, match=r"has 8 points, but </Box> of box\.rubber\.usda has 7"):
        compare_motions(Changed(), fewer)


def test_times_in_common_are_compared() -> None:
    later = Changed(time_codes=tuple(float(t) for t in range(4, 4 + FRAMES)))
    found = compare_motions(Changed(), later)
    assert found.time_codes.tolist() == [4.0, 5.0, 6.0, 7.0]
    assert any("4 of 7 frames are compared" in note for note in found.notes)
    started = compare_motions(Changed(), later, align="start")
    assert started.error == 0.0
    assert started.other_time_codes.tolist() == [float(t) for t in range(4, 4 + FRAMES)]


def test_rates_differ_and_times_are_the_same() -> None:
    # 48 time codes a second: time code 2 t is the moment of t at 24
    double = Changed(
        time_codes=tuple(2.0 * t for t in range(1, FRAMES + 1)), time_codes_per_second=48.0
    )
    found = compare_motions(Changed(), double)
    assert found.error == 0.0
    assert found.other_time_codes.tolist() == [2.0 * t for t in range(1, FRAMES + 1)]
    assert found.notes == ()


def test_no_time_in_common_is_refused() -> None:
    with pytest.raises(InputError, match="these ranges do not overlap") as error:
        compare_motions(Changed(), Changed(time_codes=(101.0, 102.0)))
    assert "--align start" in error.value.hint


def test_another_up_axis_is_turned() -> None:
    upright = Changed(lambda x, frame: x @ Y_UP_TO_Z_UP.T, up=(0.0, 0.0, 1.0))
    found = compare_motions(Changed(), upright)
    assert found.error <= 8 * EPS
    assert any("another up axis" in note for note in found.notes)
    back = compare_motions(upright, Changed())
    assert back.error <= 8 * EPS


@pytest.mark.parametrize(
    ("text", "meters"),
    [("2mm", 2e-3), ("0.5 cm", 5e-3), ("0.01m", 0.01), ("0.5%", 0.01), ("0m", 0.0)],
)
def test_tolerances_are_lengths_or_shares(text: str, meters: float) -> None:
    assert parse_tolerance(text, 2.0) == pytest.approx(meters, rel=1e-15)


@pytest.mark.parametrize("text", ["3", "", "mm", "-1mm", "nan%", "two m", "infm"])
def test_other_tolerances_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--tolerance") as error:
        parse_tolerance(text, 1.0)
    assert "2mm" in error.value.hint


def test_files_are_named_as_given() -> None:
    a = Changed(path=Path("a.usda"))
    b = Changed(path=Path("b.usda"), names=("/Box", "/More"))
    assert "not in a.usda: </More>" in compare_motions(a, b).notes


def test_an_obstacle_of_the_first_is_not_missing_from_it() -> None:
    """A delivered file does not tell obstacles from bodies."""
    box, ground = Changed(names=("/Box", "/Ground")).recording().meshes
    a, b = Changed(meshes=(box, ground), baked=(True, False)), Changed(names=("/Box", "/Ground"))
    assert not any("not in" in note for note in compare_motions(a, b).notes)
    baked = Changed(names=("/Box", "/Ground"), about={"variants": {}})
    assert any("not in" in note and "</Ground>" in note for note in compare_motions(a, baked).notes)


def test_surfaces_whose_faces_change_are_refused_in_words() -> None:
    with pytest.raises(
        InputError, match=r"</Box/Surface> has different points in every frame"
    ) as caught:
        compare_motions(MeltingBox(), MeltingBox())
    assert "gf_usd.read" in caught.value.hint
