"""Area and volume of meshes."""

import pytest
from unit_cube import CUBE, cube_triangles

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges


def test_cube_has_volume_one_and_is_closed():
    triangles = cube_triangles()
    assert len(triangles) == 12
    assert signed_volume(CUBE, triangles) == pytest.approx(1.0, abs=1e-15)
    assert signed_volume(CUBE, triangles[:, ::-1]) == pytest.approx(-1.0, abs=1e-15)
    assert len(boundary_edges(triangles)) == 0


def test_volume_far_from_the_origin_keeps_its_digits():
    # Float64 holds 1e6 + 1 to 1e-10; a sum about the origin would lose twelve digits more.
    assert signed_volume(CUBE + 1e6, cube_triangles()) == pytest.approx(1.0, rel=1e-9)
