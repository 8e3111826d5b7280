"""The medial part of a body: where it lies, and that its pieces move as the skin does."""

from __future__ import annotations

from pathlib import Path

import arm
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.geometry.flesh.goals import flesh_goals
from gf_usd.geometry.flesh.linear_blend import bone_transforms
from gf_usd.geometry.flesh.medial import medial_points, medial_skeleton
from gf_usd.geometry.solid import Solid, build_solid
from gf_usd.readers import read_asset

A = 0.05  # [m] of the lattice
HALF = 0.5 * arm.WIDTH


def body(folder: Path) -> tuple[Solid, NDArray[np.float64], SurfaceSamples]:
    """The arm, a lattice in it, and samples of its skin."""
    path = folder / "arm.usda"
    path.write_text(arm.arm(), encoding="utf-8")
    solid = build_solid(read_asset(path, bind_pose=True))
    axes = [np.arange(low + 0.5 * A, high, A) for low, high in zip(solid.low, solid.high)]
    X = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], 1)
    s = np.arange(0.05, 2.0, 0.1)
    ring = np.array([(y, z) for y in (-HALF, HALF) for z in (-0.1, 0.1)])
    ring = np.concatenate([ring, ring[:, ::-1]])
    x = np.array([(along, *yz) for along in s for yz in ring])
    return solid, X, SurfaceSamples(X=x, area=np.full(len(x), 0.01))


def test_medial_points_lie_along_the_axis(tmp_path: Path) -> None:
    """Of a square prism d = HALF - max(|y|, |z|): steep off its diagonals, shallow far from it."""
    solid, X, _ = body(tmp_path)
    points, depth = medial_points(solid, X)
    assert (np.diff(depth) <= 0.0).all()
    along = np.abs(points[:, 0] - 1.0) < 0.7
    y, z = np.abs(points[along, 1:]).T
    assert np.isclose(depth.max(), HALF - 0.5 * A, atol=1e-6)
    assert (np.abs(y - z) <= A).all()
    assert np.maximum(y, z).max() <= 0.2 * HALF + A
    assert len(points) < 0.1 * len(X)


def motion(x: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
    """A turn and a shift of everything."""
    turn = Rotation.from_rotvec([0.1 * frame, 0.2 * frame, -0.3 * frame])
    return turn.apply(x) + [0.1 * frame, 0.0, 0.5 * frame]


def made(solid: Solid, X: NDArray[np.float64], samples: SurfaceSamples, move, share: float = 0.5):
    (surface,) = solid.surfaces
    points = ({surface.path: move(surface.points, k)} for k in range(3))
    return medial_skeleton(
        solid, X, samples, points, share=share, cell=2.0 * A, spacing=0.1, where="arm.usda"
    )


def test_a_body_that_turns_turns_its_pieces_without_offsets(tmp_path: Path) -> None:
    # points of the mesh are float32
    solid, X, samples = body(tmp_path)
    skeleton, cores = made(solid, X, samples, motion, share=0.2)
    linear, offset = bone_transforms(skeleton)
    for k in range(3):
        moved = np.einsum("bij,nj->bni", linear[k], X) + offset[k][:, None]
        np.testing.assert_allclose(moved, np.broadcast_to(motion(X, k), moved.shape), atol=1e-7)
    assert skeleton.samples is not None
    assert max(np.abs(one).max() for one in skeleton.samples.offsets) < 1e-7
    owner = cores.owner(X)
    assert set(owner.tolist()) == {-1, *range(len(skeleton.bones))}
    # a core has its share of the way to the skin, and what a cell needs, around points of
    # a lattice which lie half an edge off the axis
    held = X[(owner >= 0) & (np.abs(X[:, 0] - 1.0) < 0.7)]
    assert np.abs(held[:, 1:]).max() < 0.2 * HALF + 0.71 * 2.0 * A + 0.5 * A


def bent(x: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
    """The prism on an arc."""
    if not frame:
        return x
    radius = 4.0 / frame
    angle = x[:, 0] / radius
    out = np.stack(
        [(radius - x[:, 1]) * np.sin(angle), radius - (radius - x[:, 1]) * np.cos(angle)]
    )
    return np.column_stack([*out, x[:, 2]])


def test_the_goal_is_the_cache_at_the_skin_and_near_it_inside(tmp_path: Path) -> None:
    solid, X, samples = body(tmp_path)
    skeleton, _ = made(solid, X, samples, bent)
    goals = flesh_goals(solid, samples, skeleton, {}, frequency=4.0, damping=0.5, spacing=0.1)
    assert goals.moving
    at = goals.pose(samples.X)(2.0)
    flat = np.isclose(np.abs(samples.X[:, 2]), HALF)  # samples lie on flat faces of the mesh
    # of a bend of radius R = 2 m: edges of 0.25 m cut l^2 / 8 R off, and samples that are 0.1 m
    # apart are averaged with their neighbors
    assert np.abs(at - bent(samples.X, 2))[flat].max() < 0.25**2 / 16.0 + 0.1**2 / 2.0
    inside = goals.pose(X)(2.0)
    assert np.abs(inside - bent(X, 2)).max() < 0.02


def test_another_number_of_points_is_refused(tmp_path: Path) -> None:
    solid, X, samples = body(tmp_path)
    with pytest.raises(InputError, match="35 points at a frame of its animation, and 36 at rest"):
        made(solid, X, samples, lambda x, k: x[1:])
