"""Meshes inside others: which particles have their material, and what is said where none has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_stages import bound, head, mesh, prim
from planned import planner, table

from gf_usd.pipeline.inspect import inspect
from gf_usd.prepare.plan import Plan

BINDING = ("MaterialBindingAPI",)
LOW = 0.41  # [m] lowest corner of the bead


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def bead(edge: float, material: str = "/Hard") -> str:
    """A cube of a meter of a soft material, with a small one of another material in it."""
    small = (
        f"double3 xformOp:translate = ({LOW}, {LOW}, {LOW})",
        f"double3 xformOp:scale = ({edge}, {edge}, {edge})",
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]',
    )
    materials = "".join(
        prim("Material", name, *(f"float physics:{key} = {value}" for key, value in values.items()),
             apis=["PhysicsMaterialAPI"])
        for name, values in {
            "Soft": {"youngsModulus": 2e5, "poissonsRatio": 0.3, "density": 1000.0},
            "Hard": {"youngsModulus": 2e8, "poissonsRatio": 0.3, "density": 7800.0},
        }.items()
    )  # fmt: skip
    return (
        mesh("Cube", bound("/Soft"), apis=BINDING)
        + mesh("Bead", bound(material), *small, apis=BINDING)
        + materials
    )


def unused(notes: tuple[str, ...]) -> list[str]:
    return [note for note in notes if "has no particle" in note]


def test_only_particles_in_a_mesh_have_its_material(plan: Any) -> None:
    """All that were nearest to it had: a bead of metal made much of the body metal."""
    made = plan(bead(0.2), particles=1000)
    hard = [m.density for m in table(made)].index(7800.0)
    inside = np.all(np.abs(made.particles.X - (LOW + 0.1)) < 0.1, axis=1)
    assert inside.any()
    np.testing.assert_array_equal(made.particles.material == hard, inside)
    assert unused(made.notes) == []


def test_a_painted_value_stays_in_its_mesh(plan: Any) -> None:
    density = """
        float[] primvars:gaussianFlesh:density = [5000] ( interpolation = "constant" )
    """
    painted = bead(0.2, "/Soft")
    head_, tail = painted.split('def Mesh "Bead"')
    made = plan(head_ + 'def Mesh "Bead"' + tail.replace("{", "{" + density, 1), particles=1000)
    own = made.particles.own["density"]
    inside = np.all(np.abs(made.particles.X - (LOW + 0.1)) < 0.1, axis=1)
    np.testing.assert_allclose(own[inside], 5000.0, rtol=1e-6)
    np.testing.assert_allclose(own[~inside], 1000.0, rtol=1e-6)


def test_a_mesh_without_particles_is_named_with_the_spacing_that_fills_it(
    plan: Any, tmp_path: Path
) -> None:
    """Its material had no effect, without a word."""
    (note,) = unused(plan(bead(0.06), particles=200).notes)
    assert note.startswith(
        "</Bead> has no particle, so that the material of the mesh around is used there: too small"
        " for the spacing of 17.1 cm; --spacing 0.02 ("
    )
    assert inspect(tmp_path / "asset.usda", particles=200).notes.count(note) == 1
    made = plan(bead(0.06), particles=None, spacing=0.06)
    assert unused(made.notes) == [], "a part of the number is enough for a particle"


def test_a_mesh_that_only_millions_of_particles_would_fill_is_to_be_larger(plan: Any) -> None:
    (note,) = unused(plan(bead(0.001), particles=200).notes)
    assert "; make it larger, since only --spacing 0.0003" in note


def test_of_the_same_material_nothing_is_lost(plan: Any) -> None:
    assert unused(plan(bead(0.03, "/Soft"), particles=200).notes) == []


def test_the_spacing_is_in_units_of_the_stage(plan: Any) -> None:
    small = bead(0.03).replace("= 1000.0", "= 0.001").replace("= 7800.0", "= 0.0078")
    (note,) = unused(plan(small, layer=head(meters=0.01), particles=200).notes)
    assert "for the spacing of 1.71 mm; --spacing 0.01 (" in note
