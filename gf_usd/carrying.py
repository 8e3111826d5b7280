"""The part of the street that captured Gaussians take: from a solver's frame to their poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Pose, SplatPose

if TYPE_CHECKING:
    from collections.abc import Mapping

    from gf_usd.plan import Plan


class Carrier:
    """The captured Gaussians of a plan, one bake long."""

    def __init__(self, plan: Plan) -> None:
        self._unit = plan.asset.facts.units.length
        self._tracks = {}
        self._spaces = {}
        carried = [s for s in plan.asset.surfaces if s.splats is not None]
        if not carried:
            return
        from gf_usd.physics.carried import CarriedSplats
        from gf_usd.usd.space import Space
        from gf_usd.usd.stage import clock, open_source

        self._source = open_source(plan.source)  # the spaces read its transforms frame by frame
        time = clock(self._source, plan.settings)
        for surface in carried:
            assert surface.splats is not None
            prim = self._source.GetPrimAtPath(surface.path)
            self._tracks[surface.path] = CarriedSplats(surface.splats, surface.riding)
            self._spaces[surface.path] = Space(prim, time, self._unit)

    def poses(self, riders: Mapping[str, Pose], time_code: float) -> dict[str, SplatPose]:
        """The Gaussians at one frame, by prim path; riders are the poses of all that rides."""
        out = {}
        for path, track in self._tracks.items():
            to_local = self._spaces[path].from_world(time_code)[:3, :3].T / self._unit
            out[path] = track.advance(riders[path], np.asarray(to_local))
        return out

    @property
    def notes(self) -> tuple[str, ...]:
        """What was clamped, in words."""
        from gf_usd.physics.carried import STRETCH

        return tuple(
            f"{path}: {track.clamped} times a Gaussian would have been stretched or flattened more"
            f" than {STRETCH:g} times beyond its own axes, and was kept there"
            for path, track in self._tracks.items()
            if track.clamped
        )
