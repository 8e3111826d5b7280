"""Gaussians of a stage over time: captured Gaussians and the particles of a bake."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pxr import Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.core.scene import RenderSplats
from gf_usd.core.units import code_text
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.extent import frame_times, is_visible
from gf_usd.readers.pictures.prims import placed_prims, read_splats
from gf_usd.readers.pictures.recording import PURPOSES, select_variant, variants_of
from gf_usd.readers.usd.stage import (
    SPLAT_TYPE,
    Placement,
    SkippedPrim,
    is_bake_particles,
    open_stage,
    reading,
    stage_facts,
)


class SplatMotion:
    """The animated Gaussians of one variant of a stage.

    Parameters
    ----------
    path : the root layer of a bake, or any USD file with Gaussians.
    variant : None: the one that is selected in the file.
    captured : include visible Gaussians that were not written by a bake.
    particles : include those of a bake, visible or not.

    Raises
    ------
    InputError : the file is not valid USD.
    UsageError : the file has no such variant.
    """

    def __init__(
        self,
        path: Path,
        variant: str | None = None,
        *,
        captured: bool = True,
        particles: bool = False,
    ) -> None:
        self._path, self._notes = path, Notes()
        with reading(path):
            self._stage = open_stage(path)
            facts = stage_facts(self._stage, path, self._notes, meters_per_unit=None, up_axis=None)
            self._unit = facts.units.length
            self.up = (float(facts.up[0]), float(facts.up[1]), float(facts.up[2]))
            self.variants = variants_of(self._stage)
            self.variant = select_variant(self._stage, path, variant)
            default = self._stage.GetDefaultPrim()
            self.name = default.GetName() if default else path.stem
            self.rate = float(self._stage.GetTimeCodesPerSecond())
            prims = [
                prim
                for prim in placed_prims(self._stage, self._notes)
                if str(prim.GetTypeName()) == SPLAT_TYPE
            ]
            self._prims = [
                prim
                for prim in prims
                if (particles if is_bake_particles(prim) else captured and _is_rendered(prim))
            ]
            self.time_codes = tuple(frame_times(self._prims))

    def __bool__(self) -> bool:
        """True if there are any Gaussians."""
        return bool(self._prims)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on assumptions."""
        return self._notes.lines()

    def frames(self, time_codes: Sequence[float]) -> Iterator[tuple[RenderSplats, ...]]:
        """All sets of Gaussians at each time code, in stage order.

        Raises InputError where a set is empty, or its number of finite Gaussians varies in time.
        """
        counts: list[int] = []
        for code in time_codes:
            time = Usd.TimeCode(code)
            with reading(self._path):
                xforms = UsdGeom.XformCache(time)
                found = tuple(self._read(prim, time, xforms) for prim in self._prims)
            counts_now = [len(splats.positions) for splats in found]
            counts = counts or counts_now
            for splats, count, expected in zip(found, counts_now, counts):
                if count != expected:
                    raise InputError(
                        f"{self._path}: <{splats.name}> has {count} Gaussians that are finite at "
                        f"time code {code_text(code)} and {expected} at the first one",
                        "run gf-usd check for details, then bake the asset again",
                    )
            yield found

    def _read(self, prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache) -> RenderSplats:
        try:
            place = Placement.of(xforms.GetLocalToWorldTransform(prim))
            return read_splats(prim, time, place, self._unit, self._notes)
        except SkippedPrim as reason:
            raise InputError(
                f"{self._path}: <{prim.GetPath()}> {reason} at time code"
                f" {code_text(time.GetValue())}",
                "run gf-usd check for details, then bake the asset again",
            ) from reason


def _is_rendered(prim: Usd.Prim) -> bool:
    """Whether a prim is visible at the earliest time and its purpose is one of PURPOSES."""
    visible = is_visible(prim, Usd.TimeCode.EarliestTime())
    return visible and UsdGeom.Imageable(prim).ComputePurpose() in PURPOSES
