"""Intermediate representation of a mesh file before its conversion to USD.

Lengths are in the file's unit, colors are linear Rec. 709, and texture coordinates have v = 0 at
the bottom of the image.  Matrices act on row vectors: x_parent = x M.

`load` parses files with trimesh, and converts its errors.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError

REPAIR = "repair the file in the program that made it, and export it again"
LFS = b"version https://git-lfs.github.com/spec"


@dataclass(frozen=True, kw_only=True)
class Picture:
    """An image: an existing file, or the bytes of an embedded one."""

    name: str  # file name it may have
    path: Path | None = None
    data: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class Slot:
    """A texture connected to one input of UsdPreviewSurface: scale * texel + bias."""

    input: str  # diffuseColor, roughness, metallic, normal, emissiveColor, occlusion
    picture: Picture
    channel: str = "rgb"  # rgb, r, g, b or a
    srgb: bool = True  # False: the texels are numbers, not colors
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wraps: tuple[str, str] = ("repeat", "repeat")  # repeat, clamp, mirror
    uv_scale: tuple[float, float] = (1.0, 1.0)  # uv' = uv_scale * uv + uv_offset
    uv_offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class FileMaterial:
    """A shading material; missing values have UsdPreviewSurface's fallbacks."""

    name: str
    values: Mapping[str, float | tuple[float, float, float]] = field(default_factory=dict)
    texture_slots: tuple[Slot, ...] = ()
    mesh_colors: bool = False  # diffuseColor is the mesh's own displayColor
    double_sided: bool = False


@dataclass(frozen=True, kw_only=True)
class FileSkeleton:
    """A joint hierarchy with its bind pose and animation; matrices act on row vectors."""

    name: str
    joints: tuple[str, ...]  # names, parents first
    parents: Ints  # (J,) -1: none
    bind: Floats  # (J, 4, 4) in the skeleton's space
    rest: Floats  # (J, 4, 4) relative to the joints above, without animation
    matrix: Floats  # (4, 4) from the skeleton's space to the scene
    # at each frame, relative to the parent joints; None: no animation
    translations: Floats | None = None  # (F, J, 3)
    rotations: Floats | None = None  # (F, J, 4) (w, x, y, z)
    scales: Floats | None = None  # (F, J, 3)


@dataclass(frozen=True, kw_only=True)
class FileSkin:
    """Skinning of a mesh to a skeleton: x(t) = sum_k w_k x G B_k^-1 J_k(t)."""

    skeleton: int  # into MeshFile.skeletons
    joints: Ints  # (V, k) into its joints
    weights: Floats  # (V, k) rows of sum 1
    matrix: Floats  # (4, 4) G, from the mesh's points to the bind pose


@dataclass(frozen=True, kw_only=True)
class FileShape:
    """A blend shape of a skinned mesh: it adds w(t) times its offsets to the points, before the
    skinning.
    """

    name: str
    offsets: Floats  # (V, 3) of the points
    normal_offsets: Floats | None  # (V, 3) of the normals; None: they do not change
    weights: Floats  # (F,) w at each frame of the skeleton's motion


@dataclass(frozen=True, kw_only=True)
class FileMesh:
    """One polygon mesh."""

    name: str
    points: Floats  # (V, 3)
    counts: Ints  # (P,) corners of each face
    indices: Ints  # (C,) points of the corners
    uvs: Floats | None = None  # (U, 2)
    uv_indices: Ints | None = None  # (C,) into uvs; None: uvs are one for each point
    normals: Floats | None = None  # (K, 3)
    normal_indices: Ints | None = None  # (C,) into normals; None: one for each point
    colors: Floats | None = None  # (V, 3), or (P, 3) where per_face
    colors_per_face: bool = False
    materials: Ints | None = None  # (P,) into MeshFile.materials; -1 none; None: none anywhere
    groups: tuple[tuple[str, Ints], ...] = ()  # named sets of faces
    skin: FileSkin | None = None
    shapes: tuple[FileShape, ...] = ()  # whose weights change; of a mesh with a skin


@dataclass(frozen=True, kw_only=True)
class FileNode:
    """A node of the file's hierarchy."""

    name: str
    matrix: Floats | None = None  # (4, 4) to the parent; None: identity
    mesh: FileMesh | None = None
    children: tuple[FileNode, ...] = ()

    def meshes(self) -> Iterator[FileMesh]:
        """The meshes of the node and its descendants."""
        if self.mesh is not None:
            yield self.mesh
        for child in self.children:
            yield from child.meshes()

    def names(self) -> Iterator[str]:
        """The names of the node and its descendants, and of their meshes."""
        yield self.name
        if self.mesh is not None and self.children:
            yield self.mesh.name
        for child in self.children:
            yield from child.names()


@dataclass(frozen=True, kw_only=True)
class MeshFile:
    """The contents of a mesh file."""

    path: Path
    format: str  # name for messages, e.g. "OBJ"
    nodes: tuple[FileNode, ...]
    materials: tuple[FileMaterial, ...] = ()
    meters_per_unit: float | None = None  # None: the format has no unit
    up_axis: str = "Y"
    up_axis_known: bool = False  # False: the format does not say, up_axis is usual for it
    inputs: tuple[Path, ...] = ()  # every file that was read
    notes: tuple[str, ...] = ()  # assumptions and omissions, as text
    skeletons: tuple[FileSkeleton, ...] = ()
    fps: float | None = None  # of the frames of their motion, the first at time code 1


def refuse_pointer(path: Path, data: bytes) -> None:
    """Raise InputError where `data` is a git-lfs pointer file instead of the asset."""
    if data.startswith(LFS):
        raise InputError(
            f"{path} is a git-lfs pointer ({len(data)} bytes of text), not the file itself",
            "fetch the file with: git lfs pull",
        )


def require_sound(file: MeshFile) -> MeshFile:
    """The file, after validation of its meshes.

    Raises
    ------
    InputError : no faces, points or offsets of blend shapes that are not finite, indices out of
        range, or a body of zero size.
    """
    meshes = [mesh for node in file.nodes for mesh in node.meshes()]
    if not any(len(mesh.counts) for mesh in meshes):
        raise InputError(
            f"{file.path}: the file contains no faces", "give a file that contains a mesh"
        )
    for mesh in meshes:
        where = f"{file.path}: mesh '{mesh.name}'"
        lost = int((~np.isfinite(mesh.points)).any(axis=1).sum())
        if lost:
            raise InputError(
                f"{where}: {lost} of {len(mesh.points)} points are not finite (NaN or infinity)",
                REPAIR,
            )
        for shape in mesh.shapes:
            for name, rows in (
                ("offsets", shape.offsets),
                ("normal offsets", shape.normal_offsets),
            ):
                lost = 0 if rows is None else int((~np.isfinite(rows)).any(axis=1).sum())
                if lost:
                    raise InputError(
                        f"{where}: {lost} of {len(shape.offsets)} {name} of its blend shape"
                        f" '{shape.name}' are not finite (NaN or infinity)",
                        REPAIR,
                    )
        outside = (mesh.indices < 0) | (mesh.indices >= len(mesh.points))
        if outside.any():
            raise InputError(
                f"{where}: {int(outside.sum())} of {len(mesh.indices)} indices do not refer to "
                f"any of its {len(mesh.points)} points; the first is {mesh.indices[outside][0]}",
                REPAIR,
            )
        if len(mesh.points) and not np.ptp(mesh.points, axis=0).any():
            raise InputError(
                f"{where} has no size: its {len(mesh.points)} points are all in one place", REPAIR
            )
    return file


def used_rows(values: Floats, indices: Ints) -> tuple[Floats, Ints]:
    """The rows of `values` that `indices` use, in order, and the indices into these."""
    used, new = np.unique(indices, return_inverse=True)
    return values[used], new.reshape(-1)


# Errors that trimesh raises for invalid files.  ImportError: for files that are not text, it loads
# packages that guess the encoding.
UNREADABLE = (
    ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError, NameError,
    NotImplementedError, ImportError, RecursionError, OSError, MemoryError,
)  # fmt: skip


def load(path: Path, data: bytes, kind: str) -> list[tuple[str, Floats, Ints]]:
    """(name, points (V, 3), triangles (T, 3)) of each mesh in a file.

    Raises InputError for a file that trimesh cannot read, or without triangles.
    """
    import trimesh  # not needed for USD assets

    try:
        with _quiet():
            loaded: Any = trimesh.load(BytesIO(data), file_type=kind, process=False)
    except UNREADABLE as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(f"{path} cannot be read as {kind.upper()}: {reason}", REPAIR) from error
    found = getattr(loaded, "geometry", None) or {"mesh": loaded}
    meshes = [
        (name, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))
        for name, mesh in found.items()
        if len(getattr(mesh, "faces", ()))
    ]
    if not meshes:
        raise InputError(f"{path}: the file contains no faces", "give a file that contains a mesh")
    return meshes


@contextmanager
def _quiet() -> Iterator[None]:
    """Context without trimesh's log output: its warnings are checked by the readers."""
    log, sink = logging.getLogger("trimesh"), logging.NullHandler()
    before = log.propagate
    log.addHandler(sink)
    log.propagate = False
    try:
        yield
    finally:
        log.propagate = before
        log.removeHandler(sink)
