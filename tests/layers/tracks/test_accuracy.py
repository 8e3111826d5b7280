"""What is left out is judged by what USD says in its place."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, Vt

from gf_usd.layers.tracks.accuracy import (
    Allowed,
    interpolation_errors,
    rows_of,
    shape_errors,
    slerp,
)

EYE = np.eye(3)
LOOSE = Allowed(
    length=np.asarray(1e9), shape=np.asarray(1e9), angle=np.pi, share=1e9, shutter=1.0 / 48.0
)
A, B = 3.0, 8.0
TYPES = {
    "point3f[]": (Vt.Vec3fArray, 3),
    "quatf[]": (Vt.QuatfArray, 4),
    "quath[]": (Vt.QuathArray, 4),
    "half3[]": (Vt.Vec3hArray, 3),
    "int[]": (Vt.IntArray, 1),
}
HALVES = ("quath[]", "half3[]")


def drawn(kind: str, seed: int) -> object:
    array, width = TYPES[kind]
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(50, width) if width > 1 else 50)
    if kind.startswith("quat"):
        values /= np.linalg.norm(values, axis=1, keepdims=True)
    if kind == "int[]":
        return array.FromNumpy((100 * values).astype(np.int32))
    return array.FromNumpy(values.astype(np.float16 if kind in HALVES else np.float32))


@pytest.mark.parametrize("time", [4.0, 5.5, 7.9])
@pytest.mark.parametrize("kind", TYPES)
def test_usd_interpolates_as_the_errors_assume(kind: str, time: float) -> None:
    stage = Usd.Stage.CreateInMemory()
    attribute = stage.DefinePrim("/x").CreateAttribute("a", Sdf.GetValueTypeNameForValue(
        drawn(kind, 1)))  # fmt: skip
    a, b = drawn(kind, 1), drawn(kind, 2)
    attribute.Set(a, A)
    attribute.Set(b, B)
    interpolated = np.asarray(attribute.Get(time), np.float64)
    s = (time - A) / (B - A)
    x, y = np.asarray(a), np.asarray(b)
    mine = x if kind == "int[]" else (1.0 - s) * x.astype(float) + s * y.astype(float)
    if kind.startswith("quat"):
        mine = slerp(x, y, s)
    # numbers up to 4: halves are rounded by 2^-11 of that three times, floats by 2^-24
    assert np.abs(interpolated - mine).max() <= (12 * 2.0**-11 if kind in HALVES else 1e-6)


def test_a_rotation_is_halved_whatever_the_signs() -> None:
    turn = Gf.Rotation(Gf.Vec3d(1, 2, 3), 40.0).GetQuat()
    q = np.array([[*turn.GetImaginary(), turn.GetReal()]])
    one = np.array([[0.0, 0.0, 0.0, 1.0]])
    half = Gf.Rotation(Gf.Vec3d(1, 2, 3), 20.0).GetQuat()
    for sign in (1.0, -1.0):
        found = slerp(one, sign * q, 0.5)[0]
        assert found == pytest.approx([*half.GetImaginary(), half.GetReal()], abs=1e-12)


def of(**values: object) -> dict[str, np.ndarray]:
    return rows_of({Sdf.Path(f"/p.{name}"): value for name, value in values.items()})


def points(*rows: tuple[float, float, float]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray(list(rows))


def test_positions_and_streaks_are_lengths_in_the_world() -> None:
    a, b = of(points=points((0, 0, 0)), velocities=points((0, 0, 0))), of(
        points=points((4, 0, 0)), velocities=points((8, 0, 0))
    )  # fmt: skip
    c = of(points=points((1, 0, 3)), velocities=points((2, 48, 0)))
    found = interpolation_errors(a, b, c, 0.25, LOOSE, 2.0 * EYE)
    assert found["positions"] == pytest.approx(6.0, rel=1e-6)  # 3 along z, twice as large
    assert found["velocities"] == pytest.approx(2.0)  # 48 a second for a 48th of one, twice


def test_normals_are_off_by_an_angle_though_they_are_interpolated_shorter() -> None:
    a, b = of(normals=points((1, 0, 0))), of(normals=points((0, 1, 0)))
    c = of(normals=points((np.cos(1.0), np.sin(1.0), 0)))
    assert interpolation_errors(a, b, c, 0.5, LOOSE, EYE)["normals"] == pytest.approx(
        1.0 - np.pi / 4, abs=1e-6
    )


def test_a_box_is_off_where_the_true_one_sticks_out_only() -> None:
    a = b = of(extent=points((0, 0, 0), (1, 1, 1)))
    inside, outside = points((0.2, 0, 0), (1, 1, 1)), points((0, 0, -0.5), (1, 1.2, 1))
    assert interpolation_errors(a, b, of(extent=inside), 0.5, LOOSE, EYE)["box"] == 0.0
    assert interpolation_errors(a, b, of(extent=outside), 0.5, LOOSE, EYE)["box"] == pytest.approx(
        0.5
    )


def test_all_else_is_off_by_a_share_and_whole_numbers_are_right_or_wrong() -> None:
    a, b = of(stress=Vt.FloatArray([0.0, 100.0])), of(stress=Vt.FloatArray([0.0, 200.0]))
    c = of(stress=Vt.FloatArray([10.0, 150.0]))
    assert interpolation_errors(a, b, c, 0.5, LOOSE, EYE) == {"stress": pytest.approx(0.05)}
    same, other = of(ids=Vt.IntArray([1, 2])), of(ids=Vt.IntArray([1, 3]))
    assert interpolation_errors(same, other, same, 0.5, LOOSE, EYE) == {"ids": 0.0}
    assert interpolation_errors(same, other, other, 0.5, LOOSE, EYE) == {"ids": np.inf}


def test_the_shape_bounds_how_far_the_ellipsoid_is_off_in_any_direction() -> None:
    rng = np.random.default_rng(3)
    both = []
    for _ in range(2):
        q = rng.normal(size=(30, 4))
        both.append((q / np.linalg.norm(q, axis=1, keepdims=True), rng.uniform(0.1, 2, (30, 3))))
    error = shape_errors(*both)
    n = rng.normal(size=(500, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    reach = []
    for q, scales in both:
        turn = np.array([np.array(Gf.Matrix3d(Gf.Quatd(w, x, y, z))).T for x, y, z, w in q])
        reach.append(
            np.sqrt((np.einsum("kij,ni->knj", turn, n) ** 2 * scales[:, None] ** 2).sum(2))
        )
    assert (np.abs(reach[0] - reach[1]).max(axis=1) <= error * (1 + 1e-9)).all()


def test_axes_that_change_their_names_are_no_error() -> None:
    """A disk that is turned about its own axis is the same disk."""
    turned = np.array([[np.sin(0.6), 0.0, 0.0, np.cos(0.6)]])
    still = np.array([[0.0, 0.0, 0.0, 1.0]])
    disk = np.array([[0.1, 0.7, 0.7]])
    assert shape_errors((turned, disk), (still, disk)) == pytest.approx([0.0], abs=1e-12)
