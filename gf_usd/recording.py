"""A baked motion as plain arrays, between the room that reads it and the room that shows it.

Lengths are metres in the world frame of the stage, colours linear Rec. 709.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.model import Floats
from gf_usd.scene import RenderMesh


@dataclass(frozen=True, kw_only=True)
class GaussianSet:
    """What does not change about the Gaussians of a bake."""

    name: str  # prim path
    colours: Floats  # (N, 3) linear
    opacities: Floats  # (N,)
    rest_scales: Floats  # (N, 3) [m] standard deviations at rest
    masses: Floats | None = None  # (N,) [kg]; None where the file has none

    def __len__(self) -> int:
        return len(self.opacities)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One look of a bake, without its frames."""

    path: Path  # the file as the user named it
    name: str  # of the asset
    look: str  # variant that is shown; "" where the file has no bake variants
    up: tuple[float, float, float]  # unit
    ground: float | None  # height of the floor along up [m]; None: no floor is known
    unit: float  # [m] per stage unit
    time_codes: tuple[float, ...]  # every time with a sample, in order
    time_codes_per_second: float
    meshes: tuple[RenderMesh, ...]  # as at the first frame
    baked: tuple[bool, ...]  # one a mesh: it is part of the soft body
    gaussians: GaussianSet | None = None
    about: Mapping[str, Any] = field(default_factory=dict)  # what the bake left in the root layer
    notes: tuple[str, ...] = ()  # what was assumed or left out, in words

    def seconds(self, time_code: float) -> float:
        """Playback time [s] of a time code, from the first frame."""
        return (time_code - self.time_codes[0]) / self.time_codes_per_second


@dataclass(frozen=True, kw_only=True)
class MotionFrame:
    """The moving arrays at one time."""

    time_code: float
    meshes: tuple[Floats, ...]  # (V, 3) [m], one for each mesh of the recording
    positions: Floats | None = None  # (N, 3) [m] of the Gaussians
    axes: Floats | None = None  # (N, 3, 3) [m] columns are the axes, as long as the deviations
    stress: Floats | None = None  # (N,) [Pa] von Mises, where the bake wrote it
