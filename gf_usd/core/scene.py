"""Scenes to render and baked motions, as plain arrays between the code that reads and the code that
draws.

Lengths are meters in the world frame of the stage, quaternions (w, x, y, z), colors linear
Rec. 709 unless a field says otherwise.  Everything here is immutable and independent of USD and
the renderer.  Also the choice of the captured Gaussians that an image must contain: captures have
outliers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Texture


@dataclass(frozen=True, kw_only=True)
class RenderMesh:
    """Triangles with a color, or a texture, at each corner."""

    name: str  # prim path
    points: Floats  # (V, 3) [m]
    triangles: Ints  # (T, 3) into points
    normals: Floats | None = None  # (T, 3, 3) at corners; None: computed from the points
    crease_angle: float = 50.0  # [deg] computed normals: faces that meet more sharply stay sharp
    colors: Floats  # (T, 3, 3) linear diffuse at corners; (3,) where it is one for all
    uvs: Floats | None = None  # (T, 3, 2); v = 0 is the bottom row of the texture
    textures: tuple[Texture, ...] = ()
    triangle_textures: Ints | None = None  # (T,) into textures; -1: the corner colors
    roughness: Floats  # (T,) or (): 0 mirror .. 1 matt
    metallic: Floats  # (T,) or (): 0 dielectric .. 1 metal
    values: Floats | None = None  # (V,) of the `Quantity` in the picture; None: has none


@dataclass(frozen=True, kw_only=True)
class RenderSplats:
    """Anisotropic Gaussians exp(-d' Sigma^-1 d / 2), Sigma = A A'."""

    name: str
    positions: Floats  # (N, 3) [m]
    axes: Floats  # (N, 3, 3) [m] A: columns are the axes, as long as the standard deviations
    colors: Floats  # (N, 3) linear
    opacities: Floats  # (N,) 0..1
    lit: bool = False  # True: colors are albedo; False: radiance as captured, shown unchanged
    harmonics: Harmonics | None = None  # where given, replaces the colors of unlit splats
    values: Floats | None = None  # (N,) of the `Quantity` in the picture; None: has none


@dataclass(frozen=True, kw_only=True)
class Harmonics:
    """View-dependent radiance as real spherical harmonics."""

    coefficients: Floats  # (N, K, 3), K = (degree + 1)^2, degree 0 first; 0.5 is added to the sum
    frame: Floats  # (3, 3) turns world directions into the space of the coefficients
    srgb: bool  # the sum is sRGB-encoded


@dataclass(frozen=True, kw_only=True)
class RenderEllipsoids:
    """Solid ellipsoids center + A s, |s| = 1; a sphere is A = radius times the identity."""

    name: str
    positions: Floats  # (N, 3) [m]
    axes: Floats  # (N, 3, 3) [m]; columns are the semi-axes
    colors: Floats  # (N, 3) linear diffuse
    values: Floats | None = None  # (N,) of the `Quantity` in the picture; None: has none


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """The quantity that an image shows, and the range of its colors."""

    title: str
    measure: str = ""  # of several that go by the title
    unit: str = ""  # SI; empty: a pure number
    low: float = 0.0  # in that unit
    high: float = 1.0
    largest: float = 1.0  # of any particle over the whole motion
    chosen: bool = False  # True: the range was given; False: it is that of the source
    source: tuple[str, ...] = ("99 % of particles", "in every frame,")  # of the range, as text


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera that looks from eye to target."""

    eye: tuple[float, float, float]  # [m]
    target: tuple[float, float, float]  # [m]
    up: tuple[float, float, float]
    fov: float = 30.0  # [deg] vertical
    shift: tuple[float, float] = (0.0, 0.0)  # tangents, right and up, of the picture's middle


@dataclass(frozen=True, kw_only=True)
class Light:
    """A distant light of a given angular radius."""

    direction: tuple[float, float, float]  # unit, from the scene towards the light
    radiance: tuple[float, float, float]  # irradiance / pi it gives a surface that faces it
    angle: float = 0.0  # [deg] angular radius: the softness of its shadow
    shadows: bool = True


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """An axis-aligned box."""

    low: tuple[float, float, float]  # [m]
    high: tuple[float, float, float]  # [m]

    @property
    def corners(self) -> NDArray[np.float64]:
        """(8, 3) [m]."""
        box = np.array([self.low, self.high])
        return np.array([[box[i, 0], box[j, 1], box[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])

    @property
    def diagonal(self) -> float:
        """Length [m] of the box's diagonal."""
        return float(np.linalg.norm(np.subtract(self.high, self.low)))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One frame to render."""

    up: tuple[float, float, float]  # unit
    meshes: tuple[RenderMesh, ...] = ()
    splats: tuple[RenderSplats, ...] = ()
    ellipsoids: tuple[RenderEllipsoids, ...] = ()
    ground: float | None = None  # height of the floor along up [m]; None: no floor
    focus: Bounds | None = None  # what the picture is of: shadows are sharp there; None: all
    lights: tuple[Light, ...] = ()  # two at most; none: a key and a rim that suit the camera
    notes: tuple[str, ...] = ()  # assumptions and omissions


@dataclass(frozen=True, kw_only=True)
class Motion:
    """The extent of a stage over its whole time range."""

    bounds: Bounds | None  # None: nothing visible
    framed: NDArray[np.float64]  # (K, 3) [m] what a picture of all of it contains; none: nothing
    up: tuple[float, float, float]  # unit
    ground: float | None  # height along up [m]
    time_codes: tuple[float, ...]  # every time with a sample, in order; empty: a still
    frames_per_second: float  # playback
    time_codes_per_second: float
    shown_until: float | None = None  # time code after which nothing that moves is in pictures


FAINT = 0.1  # opacity below which a Gaussian may be omitted
TAIL = 0.02  # share at either end of an axis that may be outliers
STRAY_MARGIN = 0.5  # of the middle's longest side: a Gaussian farther beyond it is an outlier


def to_frame(positions: Floats, opacities: Floats) -> NDArray[np.bool_]:
    """(n,) True for Gaussians of the object, at positions (n, 3) with opacities (n,).

    They are those of some opacity in the box of the middle 96 % on each axis, grown on all sides by
    half its longest side.  All are True where none would be.
    """
    solid = np.asarray(opacities) >= FAINT
    if not solid.any():
        return np.ones(len(solid), bool)
    low, high = np.quantile(np.asarray(positions)[solid], (TAIL, 1.0 - TAIL), axis=0)
    margin = STRAY_MARGIN * float((high - low).max())
    near = (
        solid & (positions >= low - margin).all(axis=1) & (positions <= high + margin).all(axis=1)
    )
    return near if near.any() else np.ones(len(solid), bool)


@dataclass(frozen=True, kw_only=True)
class GaussianSet:
    """The constant data of the Gaussians of a bake."""

    name: str  # prim path
    colors: Floats  # (N, 3) linear
    opacities: Floats  # (N,)
    rest_scales: Floats  # (N, 3) [m] standard deviations at rest
    masses: Floats | None = None  # (N,) [kg]; None where the file has none

    def __len__(self) -> int:
        return len(self.opacities)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One variant of a bake, without its frames."""

    path: Path  # the file as the user named it
    name: str  # of the asset
    variant: str  # that is shown; "" where the file has no bake variants
    up: tuple[float, float, float]  # unit
    ground: float | None  # height of the floor along up [m]; None: no floor is known
    unit: float  # [m] per stage unit
    time_codes: tuple[float, ...]  # every time with a sample, in order
    time_codes_per_second: float
    meshes: tuple[RenderMesh, ...]  # as at the first frame
    baked: tuple[bool, ...]  # one a mesh: it is part of the soft body
    flows: tuple[str, ...] = ()  # prim paths of meshes whose faces change from frame to frame
    vanishing: tuple[str, ...] = ()  # of `meshes`, those that are hidden in some frames
    converted: tuple[str, ...] = ()  # of these, those that particles or a surface replace then
    gaussians: GaussianSet | None = None
    about: Mapping[str, Any] = field(default_factory=dict)  # what the bake left in the root layer
    notes: tuple[str, ...] = ()  # assumptions and omissions
    framed: Bounds | None = None  # what its pictures contain; None: the whole motion
    shown_until: float | None = None  # as in `Motion`

    def seconds(self, time_code: float) -> float:
        """Playback time [s] of a time code, from the first frame."""
        return (time_code - self.time_codes[0]) / self.time_codes_per_second


@dataclass(frozen=True, kw_only=True)
class MotionFrame:
    """The moving arrays at one time."""

    time_code: float
    meshes: tuple[Floats, ...]  # (V, 3) [m], one for each mesh of the recording
    hidden: tuple[int, ...] = ()  # which of the meshes are invisible
    flows: tuple[RenderMesh, ...] = ()  # whole meshes whose faces change; those without faces are
    # left out
    positions: Floats | None = None  # (N, 3) [m] of the Gaussians
    axes: Floats | None = None  # (N, 3, 3) [m] columns are the axes, as long as the deviations
    # (N,) what the bake wrote of them: "stress" (von Mises) [Pa], "elastic", "plastic" strain
    measured: Mapping[str, Floats] = field(default_factory=dict)
