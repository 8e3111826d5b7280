"""Other simulators' words on the materials we write."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd, UsdShade
from small_sources import MOVING
from small_stages import RUBBER, bake


def test_a_material_speaks_the_proposals_and_newtons_words(tmp_path: Path) -> None:
    root, _, _ = bake(MOVING.asset(tmp_path), tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    prim = stage.GetPrimAtPath("/root/GaussianFlesh/Materials/rubber")
    assert prim.IsA(UsdShade.Material)
    # names that this build of USD has no definition of: the list itself must hold them
    applied = prim.GetMetadata("apiSchemas").GetAppliedItems()
    assert "PhysicsVolumeDeformableMaterialAPI" in applied
    assert "NewtonMPMMaterialAPI" in applied
    # single precision
    near = {name: pytest.approx(value, rel=2**-23) for name, value in {
        "physics:youngsModulus": RUBBER.youngs_modulus * 1e-2,  # centimeters: kg/(cm s^2)
        "newton:mpm:youngsModulus": RUBBER.youngs_modulus * 1e-2,
        "physics:poissonsRatio": RUBBER.poissons_ratio,
        "newton:mpm:poissonsRatio": RUBBER.poissons_ratio,
        "newton:mpm:elasticDamping": RUBBER.youngs_modulus * 1e-2 * RUBBER.damping_time,
        "newton:mpm:tensileYieldRatio": 1.0,
    }.items()}  # fmt: skip
    assert {name: prim.GetAttribute(name).Get() for name in near} == near
