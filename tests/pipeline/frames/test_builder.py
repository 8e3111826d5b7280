"""Measures of bodies in the health of a frame."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from solids import cube, fill, solid

from gf_usd.core.frames.frame import Frame, Health
from gf_usd.pipeline.frames.builder import STRETCH, FrameBuilder, mean_of_bodies


@pytest.fixture
def builder() -> FrameBuilder:
    """Of three bodies, the second of which has no particles."""
    particles = fill(solid(cube()), 100)[0]
    half = np.arange(len(particles)) % 2
    made = cast(Any, FrameBuilder.__new__(FrameBuilder))
    made.solver = SimpleNamespace(particles=SimpleNamespace(V0=particles.V0, body_of=2 * half))
    made._bodies = (("/A",), ("/B",), ("/C",))
    return made


def test_a_body_without_particles_is_no_measure(builder: FrameBuilder) -> None:
    """0 / 0 was a warning of NumPy, and its nan the largest: the body without particles."""
    body = cast(Any, builder.solver.particles).body_of
    F = np.where(body == 2, 2.0 * STRETCH, 1.0)[:, None, None] * np.eye(3)
    frame = SimpleNamespace(
        health=Health(max_J=(2.0 * STRETCH) ** 3, max_stretch=2.0 * STRETCH),
        particles=SimpleNamespace(F=F),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        expanded = builder._with_expanded(cast(Frame, frame))
        stretched = builder._with_stretched(expanded, cast(Frame, frame))
    assert (stretched.expanded_body, stretched.stretched_body) == ("/C", "/C")
    assert stretched.expanded == pytest.approx((2.0 * STRETCH) ** 3)
    assert stretched.stretched == 1.0


def test_means_of_bodies_are_over_their_volume() -> None:
    particles = cast(
        Any, SimpleNamespace(V0=np.array([1.0, 3.0, 2.0]), body_of=np.array([0, 0, 2]))
    )
    found = mean_of_bodies(np.array([1.0, 5.0, 7.0]), particles)
    assert found.tolist() == [4.0, 0.0, 7.0]
