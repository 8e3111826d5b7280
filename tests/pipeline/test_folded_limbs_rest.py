"""Limbs that fold onto each other stop there, come to rest, and get no energy from contact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from contact_scenes import bricks

import gf_usd


def stool(path: Path) -> Path:
    """A seat on three thin legs [m]."""
    upright = trimesh.transformations.rotation_matrix(0.5 * np.pi, [1.0, 0.0, 0.0])
    seat = trimesh.creation.cylinder(radius=0.4, height=0.15, sections=24, transform=upright)
    seat.apply_translation([0.0, 0.9, 0.0])
    parts = {"seat": seat}
    for k, angle in enumerate(2.094 * np.arange(3)):
        leg = trimesh.creation.cylinder(radius=0.06, height=0.86, sections=12, transform=upright)
        leg.apply_translation([0.28 * np.cos(angle), 0.43, 0.28 * np.sin(angle)])
        parts[f"leg{k}"] = leg
    trimesh.Scene(parts).export(path)
    return path


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_jelly_stool_whose_legs_fold_comes_to_rest(tmp_path: Path) -> None:
    """Its planes changed sides at every detection: 0.23 % of its energy were given to it."""
    result = gf_usd.bake(
        stool(tmp_path / "stool.glb"), material="jelly", particles=1000, output=tmp_path / "s.usda"
    )
    bake = result.bakes[0]
    assert bake.at_rest is not None
    assert bake.health["planes_gain_share"] < 5e-4


def jaws(path: Path) -> Path:
    """Two jaws 4 cm thick, 8 cm from each other, on a back of the same thickness."""
    shape = np.ones((12, 4, 4), bool)
    shape[1:, 1:3] = False
    made = bricks(shape, 0.04)
    trimesh.Trimesh(made.points, made.triangles, process=False).export(path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("material", "speed"), [("rubber", 5.0), ("jelly", 8.0)])
def test_jaws_that_are_struck_within_a_frame_do_not_pass_through_each_other(
    tmp_path: Path, material: str, speed: float
) -> None:
    """A body that falls as a whole is clear of itself at the first detection of the frame."""
    result = gf_usd.bake(
        jaws(tmp_path / "jaws.obj"), material=material, particles=1500, frames=6, drop=0.02 * speed,
        velocity=(0.0, -speed, 0.0), output=tmp_path / "s.usda",
    )  # fmt: skip
    health = result.bakes[0].health
    assert health["inside_max_share"] < 1e-3
    assert health["deepest_overlap_spacings"] < 0.25
