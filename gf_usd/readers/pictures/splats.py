"""The Gaussians of a stage over time: captured ones, and the particles of a bake."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pxr import Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.core.scene import RenderSplats
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.extent import sample_times
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
    """A stage opened to read the Gaussians of one variant.

    Parameters
    ----------
    path : the root layer of a bake, or any USD file with Gaussians.
    variant : to read; None: the one that is selected in the file.
    captured, particles : those that are visible and no bake of ours wrote; those of a bake, which
        may be hidden.

    Raises
    ------
    InputError : the file is not USD, or damaged.
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
                if (particles if is_bake_particles(prim) else captured and self._is_visible(prim))
            ]
            self.time_codes = tuple(sample_times(self._prims))

    def __bool__(self) -> bool:
        """True where there are any."""
        return bool(self._prims)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed, in words."""
        return self._notes.lines()

    def frames(self, time_codes: Sequence[float]) -> Iterator[tuple[RenderSplats, ...]]:
        """Every set of Gaussians at these time codes, in the order of the stage.

        Raises InputError where a set has none, or another number of them than before, or numbers
        that are not finite.
        """
        counts: list[int] = []
        for code in time_codes:
            time = Usd.TimeCode(code)
            with reading(self._path):
                xforms = UsdGeom.XformCache(time)
                found = tuple(self._read(prim, time, xforms) for prim in self._prims)
            now = [len(one.positions) for one in found]
            counts = counts or now
            for one, is_, was in zip(found, now, counts):
                if is_ != was:
                    raise InputError(
                        f"{self._path}: <{one.name}> has {is_} Gaussians that are finite at time"
                        f" code {code:g} and {was} at the first one.",
                        "run gf-usd check for details, then bake the asset again",
                    )
            yield found

    def _read(self, prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache) -> RenderSplats:
        try:
            place = Placement.of(xforms.GetLocalToWorldTransform(prim))
            return read_splats(prim, time, place, self._unit, self._notes)
        except SkippedPrim as reason:
            raise InputError(
                f"{self._path}: <{prim.GetPath()}> {reason} at time code {time.GetValue():g}.",
                "run gf-usd check for details, then bake the asset again",
            ) from reason

    @staticmethod
    def _is_visible(prim: Usd.Prim) -> bool:
        image = UsdGeom.Imageable(prim)
        time = Usd.TimeCode.EarliestTime()
        return (
            image.ComputeVisibility(time) != UsdGeom.Tokens.invisible
            and image.ComputePurpose() in PURPOSES
        )
