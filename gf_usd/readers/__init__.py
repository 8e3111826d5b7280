"""Readers of asset files: USD is read as an `Asset`; mesh files are first converted to USD."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError, meant, similar
from gf_usd.readers.formats import SUFFIXES, USD, Format, format_of
from gf_usd.system.atomic_files import require_utf8

if TYPE_CHECKING:
    from gf_usd.readers.mesh.to_usd import MeshSource


def read_asset(
    path: Path,
    *,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    time_code: float | None = None,
    bind_pose: bool = False,
) -> Asset:
    """The surfaces and stage metadata of an asset file, in meters, posed at one time.

    Parameters
    ----------
    path : the file as the user named it.
    prims : prim paths, each with its descendants; (): the default prim, or all root prims.
    meters_per_unit : [m] size of the file's unit; None: as in the file, or assumed.
    up_axis : "Y" or "Z"; None: as in the file, or assumed.
    time_code : of the pose; None: the file's startTimeCode, or 1.
    bind_pose : skinned meshes are read in the bind pose of their skeleton.

    Raises
    ------
    InputError : no such file, a folder, an empty or damaged file, an unsupported suffix, or no prim
        with a surface.
    """
    path = Path(path)
    row = _format(path)
    if row.kind != USD:
        source = convert(path, meters_per_unit=meters_per_unit, up_axis=up_axis, rigged=bind_pose)
        assert source is not None
        return source.asset(prims=prims, time_code=time_code, bind_pose=bind_pose)
    return row.function(
        path,
        prims=prims,
        meters_per_unit=meters_per_unit,
        up_axis=up_axis,
        time_code=time_code,
        bind_pose=bind_pose,
    )


def convert(
    path: Path,
    *,
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    rigged: bool = False,
    fps: float | None = None,
) -> MeshSource | None:
    """A mesh file converted to a USD layer in memory; None for a file that is USD.

    Arguments and errors are those of `read_asset` and `convert_mesh`.  The `asset` of the result
    is what `read_asset` returns, without parsing the file again; its `write` saves the layer.
    """
    path = Path(path)
    if _format(path).kind == USD:
        return None
    from gf_usd.readers.conversion import convert_mesh

    return convert_mesh(
        path, meters_per_unit=meters_per_unit, up_axis=up_axis, rigged=rigged, fps=fps
    )


def _format(path: Path) -> Format:
    """The format of a file, by its suffix; raises InputError if unknown, or if there is no file."""
    _require_file(path)
    row = format_of(path)
    if row is None:
        what = f"{path} has the suffix '{path.suffix}'" if path.suffix else f"{path} has no suffix"
        raise InputError(f"{what}, which is not supported", _what_can_be_read())
    return row


def _what_can_be_read() -> str:
    return f"give a file with one of these suffixes: {', '.join(SUFFIXES)}"


def _require_file(path: Path) -> None:
    """Raise InputError where `path` is not a regular, non-empty, readable file."""
    try:
        if path.is_dir():
            raise InputError(f"{path} is a folder, not an asset file", _of_folder(path))
        if not path.exists():
            raise InputError(f"{path} does not exist", f"{_near(path)}{_what_can_be_read()}")
        if not path.is_file():
            raise InputError(f"{path} is not a regular file", _what_can_be_read())
        require_utf8(path)
        with path.open("rb") as file:
            if not file.read(1):
                raise InputError(
                    f"{path} is empty (0 bytes)",
                    "export or copy it again: writing it may have been interrupted",
                )
    except OSError as error:
        raise InputError(
            f"{path} cannot be read: {error.strerror or error}",
            "check the spelling of the path and the permissions of the file",
        ) from error


PARTS = (".partial", ".cache", ".source")  # of bakes: unfinished, or read by a root layer


def _of_folder(folder: Path) -> str:
    """A hint at the asset file of a folder: the one with the folder's name, or the only one."""
    names = sorted(p.name for p in folder.iterdir() if _is_candidate(p))
    own = [name for name in names if Path(name).stem == folder.resolve().name]
    if len(found := own or names) == 1:
        return f"give the asset file in it: {folder / found[0]}"
    if found:
        shown = found if len(found) <= 4 else found[:3]  # "one of 1 others" is no help
        more = f" or one of {len(found) - 3} others" if len(found) > 4 else ""
        return f"give one of the asset files in it: {', '.join(shown)}{more}"
    return _what_can_be_read()


def _is_candidate(path: Path) -> bool:
    """Whether a hint may name a file: of a known suffix, not hidden, and no part of a bake."""
    known = path.suffix.lower() in SUFFIXES and path.is_file()
    return known and not path.name.startswith(".") and Path(path.stem).suffix not in PARTS


def _near(path: Path) -> str:
    """A hint at files with names similar to that of a missing one."""
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist either; "
    names = [p.name for p in path.parent.iterdir() if _is_candidate(p)]
    # a suffix in common makes no names similar
    stems = sorted({Path(name).stem for name in names})
    near = similar(path.stem, stems, most=3)
    close = [name for stem in near for name in sorted(names) if Path(name).stem == stem][:3]
    return f"{meant(close)}otherwise " if close else ""
