"""Registry of the input formats: one row of FORMATS each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from gf_usd.core import USD_SUFFIXES

USD, MESH, SPLATS, PROGRAM = "USD", "mesh", "splats", "program"


@dataclass(frozen=True, kw_only=True)
class Format:
    """An input format.

    read : "module:function" of the reader, imported on demand.  By kind, its signature is

        USD      the arguments of `read_asset` -> Asset
        mesh     path -> MeshFile
        splats   path -> Splats
        program  path, meters_per_unit, up_axis -> MeshSource; an external program reads the file
    """

    name: str  # for messages
    suffixes: tuple[str, ...]
    kind: str
    read: str
    says_axis: bool = True  # splats: whether the format defines the up axis
    # mesh: "module:function" with the signature path, frames per second -> MeshFile with skeletons;
    # "": skeletons of this format are not supported
    rigged: str = ""

    @property
    def function(self) -> Callable[..., Any]:
        """The reader."""
        return _imported(self.read)

    @property
    def rigged_function(self) -> Callable[..., Any]:
        """The reader of files with skeletons."""
        return _imported(self.rigged)


def _imported(where: str) -> Callable[..., Any]:
    module, name = where.split(":")
    return getattr(import_module(module), name)


# A suffix may be in a row of meshes and one of splats (.ply): the contents of the file decide.
FORMATS = (
    Format(
        name="USD", suffixes=USD_SUFFIXES, kind=USD,
        read="gf_usd.readers.usd.asset:read_usd",
    ),
    Format(name="OBJ", suffixes=(".obj",), kind=MESH, read="gf_usd.readers.mesh.obj:read_obj"),
    Format(name="PLY", suffixes=(".ply",), kind=MESH, read="gf_usd.readers.mesh.ply.read:read_ply"),
    Format(name="STL", suffixes=(".stl",), kind=MESH, read="gf_usd.readers.mesh.stl:read_stl"),
    Format(name="OFF", suffixes=(".off",), kind=MESH, read="gf_usd.readers.mesh.off:read_off"),
    Format(
        name="glTF", suffixes=(".glb", ".gltf"), kind=MESH,
        read="gf_usd.readers.mesh.gltf.scene:read_gltf",
        rigged="gf_usd.readers.mesh.gltf.scene:read_rigged_gltf",
    ),
    Format(name="FBX", suffixes=(".fbx",), kind=PROGRAM,
           read="gf_usd.readers.mesh.fbx:convert_fbx"),
    Format(
        name="3DGS PLY", suffixes=(".ply",), kind=SPLATS,
        read="gf_usd.readers.splats.ply:read_splat_ply", says_axis=False,
    ),
    Format(name="SPZ", suffixes=(".spz",), kind=SPLATS, read="gf_usd.readers.splats.spz:read_spz"),
    Format(
        name=".splat", suffixes=(".splat",), kind=SPLATS,
        read="gf_usd.readers.splats.raw:read_raw_splats", says_axis=False,
    ),
)  # fmt: skip
SUFFIXES = tuple(sorted({suffix for row in FORMATS for suffix in row.suffixes}))


def format_of(path: Path, *kinds: str) -> Format | None:
    """The format of a file by its suffix, among some kinds or all; None where it is unknown."""
    rows = (row for row in FORMATS if path.suffix.lower() in row.suffixes)
    return next((row for row in rows if not kinds or row.kind in kinds), None)
