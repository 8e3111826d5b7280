"""Where a failed simulation is reported to have failed."""

from __future__ import annotations

from dataclasses import replace

from physics_stages import mesh
from planned import at, plan_fixture  # noqa: F401

from gf_usd.core.errors import SolverError
from gf_usd.pipeline.failure import locate_failure


def test_the_prim_is_that_of_the_particle_after_an_embedded_surface(plan) -> None:
    # Particles count the surfaces that are filled: the embedded one stands before both.
    seen = plan(mesh("One"), mesh("Two", at(3.0)), particles=200)
    embedded = replace(seen.asset.surfaces[0], path="/Cloth")
    asset = replace(seen.asset, surfaces=(embedded, *seen.asset.surfaces))
    seen = replace(seen, asset=asset, embedded=(("/Cloth", "is open"),))
    for particle in (0, len(seen.particles) - 1):
        surface = int(seen.particles.surface[particle])
        prim = ("/One", "/Two")[surface]
        error = SolverError("frame 3: it is torn", "", frame=3, particle=particle)
        found = locate_failure(
            error, "rubber", asset=seen.asset, embedded=seen.embedded, particles=seen.particles,
            settings=seen.settings,
        )  # fmt: skip
        assert found["prim"] == prim
