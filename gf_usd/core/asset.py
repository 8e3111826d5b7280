"""An asset: surfaces, their shading materials, captured Gaussians, and facts of the stage.

The start of a bake and its time codes, if the source does not state them.

The rest pose, the physics, the pins and the settings of a bake all use this module, so that they
agree on the time of the first frame.

Captured Gaussians: one representation for all splat files.

    alpha(x) = o exp(-(x - p)^T Sigma^-1 (x - p) / 2),    Sigma = R diag(s^2) R^T
    c(d) = 1/2 + sum_k h_k Y_k(d)

with d the direction from the camera to the Gaussian in its own space.  Files differ in how they
store the numbers (logarithms, logits, bytes); here opacities lie in 0..1, scales are linear
standard deviations, quaternions are (w, x, y, z), and the coefficients are those of UsdVol: raw
f_dc first, then f_rest with degree 1, 2, 3 in order, each coefficient with its three colors.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import AXES, Floats, Ints
from gf_usd.core.errors import InputError, counted
from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import Welded, weld
from gf_usd.core.radiance import DEGREE, Y_0
from gf_usd.core.units import StageUnits

# Linear, of what has neither a material nor displayColor: what Storm, and so usdview, draws then.
# (UsdPreviewSurface's own fallback, 0.18, is that of a material without an authored color.)
NO_COLOR = (0.5, 0.5, 0.5)


@dataclass(frozen=True, kw_only=True)
class SurfaceMaterial:
    """The diffuse shading of a bound material."""

    path: str
    color: tuple[float, float, float]  # constant diffuse, linear
    texture: Texture | None = None  # multiplies nothing: replaces the constant where present


FILE, ASSUMED, OPTION = "file", "assumed", "option"  # where a unit or an axis comes from
BAKES = "gaussianFlesh"  # the variant set that root prims of a bake have
# in its metadata: files of obstacles, as paths from the root layer, and sha256 of each
COLLIDERS, COLLIDER_HASHES = "colliders", "colliderHashes"


@dataclass(frozen=True, kw_only=True)
class StageFacts:
    """Facts about the source stage."""

    path: Path  # the file as the user named it
    units: StageUnits
    up_axis: str  # "Y" or "Z"
    unit_from: str = FILE  # the unit of length: FILE, ASSUMED or OPTION
    axis_from: str = FILE  # the up axis, likewise
    time_codes_per_second: float | None  # None where the source authors none
    frames_per_second: float | None = None  # of playback; likewise
    start_time_code: float | None
    end_time_code: float | None
    root_prims: tuple[str, ...]  # every root prim path, in order
    default_prim: str | None
    animated: bool = False  # a layer of it holds time samples
    says_physics: bool = False  # a UsdPhysics scene or API is authored on the stage
    baked_prim: str | None = None  # a root prim with the variants of a bake
    baked: bool = False  # the stage is the result of a bake, in one file or with variants
    baked_from: str = ""  # the asset of that bake, as its command names it
    notes: tuple[str, ...] = ()  # assumptions and omissions

    @property
    def up(self) -> NDArray[np.float64]:
        """Unit vector (3,) of the up axis."""
        return np.eye(3)[AXES[self.up_axis]]

    def require_not_baked(self) -> None:
        """Raise InputError where the stage is the result of a bake."""
        if self.baked:
            raise baked_already(self.path, self.baked_prim, self.baked_from)


def baked_already(path: Path, prim: str | None, asset: str = "") -> InputError:
    """The refusal of the result of a bake of an asset.

    prim : the root prim with the variants of the bake; None: it is one file without them.
    """
    variants = "" if prim is None else f"<{prim}> already has a variant set {BAKES!r}: "
    return InputError(f"{path}: {variants}this file is the result of a bake", bake_original(asset))


def bake_original(asset: str) -> str:
    """A hint at the asset of a bake; "": it is not known."""
    return f"bake the original asset{f', {asset},' if asset else ''} instead"


@dataclass(frozen=True, kw_only=True)
class Texture:
    """A color texture as stored in its file."""

    pixels: NDArray[np.uint8]  # (H, W, 3), row 0 at the top
    srgb: bool  # True: pixels are sRGB-encoded; False: linear
    wrap_s: str = "repeat"  # repeat | clamp | mirror | black
    wrap_t: str = "repeat"


@dataclass(frozen=True, kw_only=True)
class LimitSurface:
    """What a renderer draws of the cage of a subdivision surface."""

    shift: float  # [m] from the cage, at the farthest of its points
    volume: float  # [m^3] that it encloses


@dataclass(frozen=True, kw_only=True)
class Surface:
    """One mesh of the asset, posed at the first frame."""

    path: str  # prim path in the source
    type_name: str  # "Mesh", "TetMesh", "Points"; anything else is an implicit shape
    points: Floats  # (V, 3) [m], world
    face_counts: Ints  # (P,) as authored
    face_indices: Ints  # (C,) as authored
    triangles: Ints  # (T, 3) into points, right-handed whatever the authored orientation
    triangle_corners: Ints  # (T, 3) into face_indices: the corner each triangle vertex came from
    normals: Floats | None = None  # (K, 3) authored normals, world, unit; None where none
    normals_interpolation: str = ""  # vertex | varying | faceVarying | uniform | ""
    normal_points: Ints | None = None  # (K,) the point whose deformation transforms each normal
    triangle_colors: Floats | None = None  # (T, 3, 3) displayColor at triangle corners, linear
    triangle_uvs: Floats | None = None  # (T, 3, 2) of the primvar that the texture reads
    triangle_materials: Ints | None = None  # (T,) into materials; -1 where nothing is bound
    materials: tuple[SurfaceMaterial, ...] = ()
    skinned: bool = False  # posed by UsdSkel: the cache must not let it be skinned again
    splats: Splats | None = None  # captured Gaussians that this surface was put around: they show
    own_points: int | None = None  # the first of `points` are the prim's own, the rest a surface
    # that was put around them, which is not written; None: all are
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] of the prim's own space, in world
    limit: LimitSurface | None = None  # of a cage that is far from it; None: the cage is drawn
    component: str = ""  # the model of kind component that the prim belongs to; "": none
    hole_faces: int = 0  # authored faces that are holes (holeIndices): no triangle is of one

    @cached_property
    def representative(self) -> Ints:
        """(V,) the first of the points that coincide with each: see `core.mesh.topology.weld`."""
        found = weld(self.points)[0]
        found.flags.writeable = False
        return found

    @cached_property
    def welded(self) -> Welded:
        """The triangles between representatives, without collapsed ones."""
        return Welded(self.representative, self.triangles)

    @cached_property
    def signed_volume(self) -> float:
        """[m^3] of the welded triangles, see `core.mesh.measures.signed_volume`."""
        return signed_volume(self.points, self.welded.triangles)

    @property
    def face_points(self) -> Floats:
        """(n, 3) [m] those of `points` that a face has: others are not drawn and enclose nothing.

        Exporters leave points without a face behind, often at the origin.
        """
        used = np.zeros(len(self.points), bool)
        used[self.triangles] = True
        return self.points[used] if used.any() else self.points


@dataclass(frozen=True, kw_only=True)
class Asset:
    """The result of reading a file."""

    facts: StageFacts
    surfaces: tuple[Surface, ...]
    skipped: tuple[tuple[str, str], ...] = ()  # (prim path, reason) of prims that are not changed
    splats: tuple[Splats, ...] = ()  # captured Gaussians, not yet given a surface

    def without(self, reasons: Mapping[str, str]) -> Asset:
        """The asset with surfaces among the prims that are skipped.

        reasons : why each is not part of what is baked, by prim path.
        """
        kept = tuple(s for s in self.surfaces if s.path not in reasons)
        return replace(self, surfaces=kept, skipped=(*self.skipped, *reasons.items()))


LATEST = 1e9  # time code: beyond, double precision leaves less than a millionth of one
FIRST = 1.0  # the time code of the first frame if neither the source nor the user states one
USD_RATE = 24.0  # USD's default of the time codes per second


def prim_name(text: str) -> str:
    """A prim name in ASCII, since programs with a USD before 24.03 read no other layers.

    Letters lose their accents; other letters and symbols become their code points, 形 u5F62, so
    that different names stay different.  Spaces and punctuation become "_".
    """
    out = "".join(_in_ascii(letter) for letter in unicodedata.normalize("NFC", text))
    return f"_{out}" if not out or out[0].isdigit() else out


def free_name(name: str, taken: Callable[[str], bool]) -> str:
    """A name that is not taken: this one, or with the first number from 2 on that is free."""
    found, count = name, 1
    while taken(found):
        count += 1
        found = f"{name}_{count}"
    return found


def _in_ascii(letter: str) -> str:
    parts = unicodedata.normalize("NFKD", letter)
    base = "".join(part for part in parts if not unicodedata.combining(part))
    if base.isascii() and base.isalnum():
        return base
    kind = unicodedata.category(letter)
    return "_" if letter.isascii() or kind[0] in "PZ" else f"u{ord(letter):04X}"


def first_time_code(facts: StageFacts, requested: float | None = None) -> float:
    """The requested time code, else the source's startTimeCode, else 1."""
    if requested is not None:
        return requested
    return FIRST if facts.start_time_code is None else facts.start_time_code


def authored_rate(facts: StageFacts) -> float | None:
    """Time codes per second that a bake must keep; None where no time sample depends on them."""
    if facts.time_codes_per_second is None and facts.animated:
        return USD_RATE
    return facts.time_codes_per_second


LARGEST = 1e31  # of any number: single precision still holds a box around it
BRIGHTEST = 1e4  # a coefficient is clipped to this: rotated ones are written in half precision


@dataclass(frozen=True, kw_only=True)
class Splats:
    """A set of Gaussians in their own space, and the transform of that space."""

    positions: Floats  # (N, 3) [local units]
    orientations: Floats  # (N, 4) unit, (w, x, y, z)
    scales: Floats  # (N, 3) [local units] standard deviations along the axes of R
    opacities: Floats  # (N,) 0..1
    harmonics: Floats  # (N, (degree + 1)^2, 3)
    path: str = ""  # prim path; "" for what comes from no stage
    to_world: Floats = field(default_factory=lambda: np.eye(4))  # (4, 4) x_world [m] = x M
    half: bool = False  # the coefficients are authored in half precision only
    anchors: Floats | None = None  # (N, 3) [m] the points of the body that they move with, world
    labels: Mapping[str, Ints] = field(default_factory=dict)  # (N,) of each whole-number property

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.harmonics.shape[1] ** 0.5) - 1

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) [m] centers, world."""
        return np.asarray(self.positions, float) @ self.to_world[:3, :3] + self.to_world[3, :3]

    @cached_property
    def axes(self) -> NDArray[np.float64]:
        """(N, 3, 3) [m] A with Sigma = A A^T, world: its columns are the scaled axes."""
        return self.to_world[:3, :3].T @ gaussian_axes(self.orientations, self.scales)

    @property
    def embedded_points(self) -> Floats:
        """(N, 3) [m] the points that are embedded in the body: the centers or their anchors."""
        return self.points if self.anchors is None else self.anchors

    @property
    def colors(self) -> NDArray[np.float64]:
        """(N, 3) of degree 0, encoded as the capture is: sRGB in practice."""
        return np.clip(0.5 + Y_0 * np.asarray(self.harmonics[:, 0], float), 0.0, 1.0)

    @property
    def frame_bytes(self) -> int:
        """Of one frame in the cache: positions, orientations, scales, and halves for radiance."""
        halves = 6 * self.harmonics.shape[1] if self.degree else 0
        return len(self) * (12 + 16 + 12 + halves)

    def take(self, rows: Ints) -> Splats:
        """Some of them, in the given order."""
        return Splats(
            positions=self.positions[rows],
            orientations=self.orientations[rows],
            scales=self.scales[rows],
            opacities=self.opacities[rows],
            harmonics=self.harmonics[rows],
            path=self.path,
            to_world=self.to_world,
            half=self.half,
            labels={name: values[rows] for name, values in self.labels.items()},
        )


@dataclass(frozen=True, kw_only=True)
class SplatPose:
    """Captured Gaussians at one time; all but the positions in the space of their prim."""

    positions: Floats  # (N, 3) [m] world
    orientations: Floats  # (N, 4) unit, continuous in time
    scales: Floats  # (N, 3) [local units] standard deviations
    harmonics: Floats | None = None  # (N, K, 3) turned; None where the degree is 0


def valid_gaussians(splats: Splats, where: str, note: Callable[[str], None]) -> Splats:
    """The valid Gaussians: finite, of a positive size, with normalized quaternions.

    `note` is called with each change.  Raises InputError if none remains.
    """
    norm = np.linalg.norm(np.asarray(splats.orientations, float), axis=1)
    finite = np.isfinite(norm) & np.isfinite(splats.opacities)
    for values in (splats.positions, splats.scales, splats.harmonics):
        held = np.abs(np.asarray(values, float)) <= LARGEST  # and is a number
        finite &= held.all(axis=tuple(range(1, np.ndim(values))))
    sized = (np.asarray(splats.scales) >= np.finfo(np.float32).tiny).all(axis=1)
    lost, flat = int((~finite).sum()), int((finite & ~sized).sum())
    if lost:
        note(f"{lost} of {len(splats)} Gaussians are not finite: left out")
    if flat:
        note(f"{flat} of {len(splats)} Gaussians have a scale of 0 or less: left out")
    keep = finite & sized
    if not keep.any():
        raise InputError(
            f"{where}: none of its {len(splats)} Gaussians is finite and has a size",
            "export it again, with at least one Gaussian",
        )
    turned = int((keep & (norm == 0.0)).sum())
    if turned:
        gaussians = counted(turned, "Gaussian has", "Gaussians have")
        note(f"{gaussians} a quaternion of length 0: no rotation is assumed")
    length = np.where(norm > 0.0, norm, 1.0)[:, None]
    unit = np.where(norm[:, None] > 0.0, splats.orientations / length, (1.0, 0.0, 0.0, 0.0))
    beyond = keep & ((splats.opacities < 0.0) | (splats.opacities > 1.0))
    if beyond.any():
        note(f"{counted(int(beyond.sum()), 'opacity', 'opacities')} outside 0..1: clipped")
    count = splats.harmonics.shape[1]
    most = (DEGREE + 1) ** 2
    if count > most:
        note(f"spherical harmonics above degree {DEGREE} are left out")
    harmonics = splats.harmonics[:, :most]
    bright = keep[:, None, None] & (np.abs(harmonics) > BRIGHTEST)
    if bright.any():
        many = counted(int(bright.sum()), "spherical harmonics coefficient")
        note(f"{many} beyond {BRIGHTEST:g}: clipped")
        harmonics = np.clip(harmonics, -BRIGHTEST, BRIGHTEST)
    sound = Splats(
        positions=splats.positions,
        orientations=unit,
        scales=splats.scales,
        opacities=np.clip(splats.opacities, 0.0, 1.0),
        harmonics=harmonics,
        path=splats.path,
        to_world=splats.to_world,
        half=splats.half,
        labels=splats.labels,
    )
    return sound if keep.all() else sound.take(np.flatnonzero(keep))


def joined(sets: Sequence[Splats]) -> Splats:
    """Several sets in one space as one; of different degrees, the lower are filled with zeros."""
    most = max(s.harmonics.shape[1] for s in sets)
    padded = [np.pad(s.harmonics, ((0, 0), (0, most - s.harmonics.shape[1]), (0, 0))) for s in sets]
    return Splats(
        positions=np.concatenate([s.positions for s in sets]),
        orientations=np.concatenate([s.orientations for s in sets]),
        scales=np.concatenate([s.scales for s in sets]),
        opacities=np.concatenate([s.opacities for s in sets]),
        harmonics=np.concatenate(padded),
    )
