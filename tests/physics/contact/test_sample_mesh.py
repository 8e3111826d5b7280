"""Triangles of contact samples, and which samples are neighbors at rest."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import bricks
from solids import sphere
from two_legs import SPACING, legs, sampled

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.subdivision import with_short_edges
from gf_usd.core.mesh.topology import boundary_edges
from gf_usd.physics.contact.self_contact.sample_mesh import Neighbors, incident, triangulate


@pytest.mark.parametrize("body", [sphere(subdivisions=4), sphere(subdivisions=1), legs(0.1)])
def test_the_triangles_of_samples_close_whatever_the_mesh(body):
    skin, samples = sampled(body)
    mesh = triangulate(skin, samples.X, SPACING)
    assert len(boundary_edges(mesh.triangles)) == 0
    # Euler's formula for a surface like a sphere, on which every sample has a place of its own.
    assert len(np.unique(mesh.triangles)) == len(samples.X)
    assert len(samples.X) - len(mesh.edges) + len(mesh.triangles) == 2
    volume = signed_volume(skin.points, skin.triangles)
    # Chords cut edges and curves off by some s^2 / 8 R: 3 % for boxes four spacings thick.
    assert signed_volume(samples.X, mesh.triangles) == pytest.approx(volume, rel=0.03)


def test_long_edges_are_halved_without_gaps():
    skin, _ = sampled(legs(0.1))
    points, triangles = with_short_edges(skin.points, skin.triangles, 0.03)
    edge = np.linalg.norm(points[triangles] - points[np.roll(triangles, 1, axis=1)], axis=2)
    assert edge.max() <= 0.03
    assert len(boundary_edges(triangles)) == 0
    assert signed_volume(points, triangles) == pytest.approx(
        signed_volume(skin.points, skin.triangles), rel=1e-12
    )


def test_samples_without_surface_between_them_are_not_joined():
    # As where a pin holds the middle of a bar: its samples are left out.
    filled = np.ones((14, 3, 3), bool)
    skin, samples = sampled(bricks(filled, 0.1))
    X = samples.X[(samples.X[:, 0] < 0.4) | (samples.X[:, 0] > 1.0)]
    mesh = triangulate(skin, X, SPACING)
    side = X[mesh.triangles][:, :, 0] < 0.7
    assert (side.all(1) | ~side.any(1)).all()
    assert len(boundary_edges(mesh.triangles)) > 0


def test_incident_triangles():
    t = np.array([[0, 1, 2], [2, 1, 3]])
    np.testing.assert_array_equal(incident(t, 5), [[0, -1], [0, 1], [0, 1], [1, -1], [-1, -1]])


@pytest.mark.parametrize("gap", [0.02, 0.1])
def test_legs_are_far_across_a_gap_however_narrow(gap):
    skin, samples = sampled(legs(gap))
    X, normal = samples.X, samples.normal
    mesh = triangulate(skin, X, SPACING)
    near = Neighbors(mesh, X, normal, 4, 4.0 * SPACING)
    deep = (X[:, 1] > 0.9) & (np.abs(normal[:, 0]) > 0.9)
    inner_left = np.flatnonzero(deep & (np.abs(X[:, 0] - 0.4) < 1e-6))
    inner_right = np.flatnonzero(deep & (np.abs(X[:, 0] - 0.4 - gap) < 1e-6))
    outer_left = np.flatnonzero(deep & (X[:, 0] < 1e-6))
    a, b = np.meshgrid(inner_left, inner_right)
    assert not near.near(a, b).any(), "across the gap"
    a, b = np.meshgrid(inner_left, outer_left)
    close = np.linalg.norm(X[a] - X[b], axis=2) < 4.0 * SPACING - 1e-6
    assert near.near(a, b)[close].all(), "through the leg"
    edges = mesh.edges
    assert near.near(edges[:, 0], edges[:, 1]).all()
    assert near.near(np.arange(len(X)), np.arange(len(X))).all()
