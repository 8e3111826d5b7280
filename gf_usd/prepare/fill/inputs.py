"""What all steps of `fill` read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core.asset import Asset
from gf_usd.core.frames.settings import MIXED
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.bodies.flesh.character_file import CharacterFile
from gf_usd.prepare.fill.meshes import FilledMeshes, ResolutionOf, repair_for_fill
from gf_usd.prepare.materials.flowing import Dispatch
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.settings import Resolution, resolution

if TYPE_CHECKING:
    from gf_usd.geometry.repair import Repairs
    from gf_usd.geometry.solid import Solid
    from gf_usd.geometry.thin.thickness import Thickness


Progress = Callable[[str], None]  # called with each step of the fill, in brackets
MESHES, THICKNESS, PARTICLES, SAMPLES, CONTACT, LIMBS = (
    f"({step})"
    for step in (
        "checking the meshes", "measuring thickness", "placing particles", "sampling the surface",
        "preparing contact", "separating limbs",
    )
)  # fmt: skip


def silent(step: str) -> None:
    """No progress is shown."""


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """What all steps of `fill` read."""

    meshes: FilledMeshes
    request: Request  # completed by `with_flow` and `with_stage`
    spec: StageSpec
    presets: Sequence[Any]
    law: str | None
    file: Path | None
    flow: Dispatch
    characters: CharacterFile | None = None  # of --flesh, where the asset has a file
    progress: Progress = silent

    @property
    def asset(self) -> Asset:
        return self.meshes.asset

    @property
    def solid(self) -> Solid:
        return self.meshes.solid

    @property
    def unit(self) -> float:
        """[m] of the length unit of the stage."""
        return self.asset.facts.units.length

    @property
    def paper(self) -> bool:
        return self.request.preset == "paper"

    @property
    def mixed(self) -> bool:
        """Whether there are solid and flowing bodies."""
        return self.request.solver == MIXED


def resolution_of(
    request: Request,
    spec: StageSpec,
    unit: float,
    volumes: Callable[[], Mapping[tuple[str, ...], float]],
    thin: Callable[[], tuple[float, Thickness | None]] | None = None,
) -> Resolution:
    """See `resolution`; unit : [m] of the stage's."""
    spacing = request.spacing * unit if request.spacing else None
    paper = request.preset == "paper"
    return resolution(request.particles, spacing, spec, volumes, thin, paper=paper)


def resolution_function(request: Request, spec: StageSpec, unit: float) -> ResolutionOf:
    """`resolution_of` as a function of the volumes, which are known later."""
    return lambda volumes: resolution_of(request, spec, unit, volumes)


def repair_asset_for_fill(
    asset: Asset, request: Request, spec: StageSpec
) -> tuple[Asset, Asset, tuple[Repairs, ...], float | None]:
    """See `repair_for_fill`."""
    resolution = resolution_function(request, spec, asset.facts.units.length)
    return repair_for_fill(asset, resolution, paper=request.preset == "paper")
