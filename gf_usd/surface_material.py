"""What colours a surface: the diffuse look of a material that is bound to it."""

from __future__ import annotations

from dataclasses import dataclass

from gf_usd.model import Texture


@dataclass(frozen=True, kw_only=True)
class SurfaceMaterial:
    """The diffuse look of a bound material."""

    path: str
    colour: tuple[float, float, float]  # constant diffuse, linear
    texture: Texture | None = None  # multiplies nothing: replaces the constant where present
