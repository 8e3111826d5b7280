"""Output files of a bake, and the check that they may be written.

Also sequences of splat files, one for each frame, for viewers of Gaussians.
"""

from __future__ import annotations

import errno
import glob
import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gf_usd.core import CACHE_SUFFIX, PACKAGE_SUFFIX, USD_SUFFIXES
from gf_usd.core.asset import Splats
from gf_usd.core.errors import BakeError, UsageError
from gf_usd.core.frames.choices import SOURCE_VARIANT
from gf_usd.readers.splats.write import WRITERS
from gf_usd.system.atomic_files import (
    dropped_on_failure,
    is_utf8,
    partial_path,
    publish,
    same_place,
)

REPORT = ".report.json"
SHEET = ".sheet.png"


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """The output files of a bake."""

    root: Path
    caches: tuple[Path, ...]  # one for each variant
    report: Path
    source: Path | None = None  # USD layer of an asset that is not USD
    textures: tuple[Path, ...] = ()  # pictures that were inside it
    flat: bool = False  # the root holds everything; the caches are there while it is made
    sheet: Path | None = None  # pictures of all variants

    @property
    def own(self) -> tuple[Path, ...]:
        """The files that are not shared with other bakes."""
        if self.flat:
            return (self.root, *self.textures, self.report)
        sheet = (self.sheet,) if self.sheet else ()
        return (self.root, *self.caches, self.report, *sheet)

    @property
    def checkpoints(self) -> tuple[Path, ...]:
        """The checkpoints of an unfinished bake, one for each variant."""
        stems = (cache.name.removesuffix(CACHE_SUFFIX) for cache in self.caches)
        return tuple(self.root.with_name(f"{stem}.checkpoint.npz") for stem in stems)

    @property
    def is_package(self) -> bool:
        """Whether the one file is a usdz package."""
        return self.root.suffix == PACKAGE_SUFFIX

    @property
    def layers(self) -> Path:
        """The root layer over the caches; for a flattened bake it exists only while it is made."""
        return self.root.with_name(f"{self.stem}.layers.usda") if self.flat else self.root

    @property
    def stem(self) -> str:
        """``duck.rubber`` of ``duck.rubber.usda``."""
        return self.root.name[: -len(self.root.suffix)]

    @property
    def all(self) -> tuple[Path, ...]:
        """Every file."""
        shared = () if self.flat else self.textures
        return (*self.own, *([self.source] if self.source else []), *shared)


def outputs(
    source: Path,
    variants: Sequence[str],
    output: str | None,
    flatten: bool = False,
    sweep: str | None = None,
    *,
    divided: bool = False,
) -> Outputs:
    """Names of the results; variants are their names.

    `-o` names the root layer, or a folder if it ends in / or is one; default: the current folder.
    One variant: duck.rubber.usda and duck.rubber.cache.usdc.  Several: duck.rubber-jelly.usda with
    duck.rubber-jelly.rubber.cache.usdc and so on.  A mesh file duck.obj also gives
    duck.source.usdc, which all bakes of it share.  Flattened, or named .usdz, a bake is one file.
    A sweep has a name for all variants together, and duck.NAME.sheet.png.  divided : the faces of
    meshes are, and the bake lies over a layer of its own: duck.rubber.source.usdc.

    Raises UsageError for names that collide, with each other or with the asset.
    """
    _require_names(variants)
    if output is not None and "\0" in output:
        raise UsageError("-o holds a null character, which no path has", "choose another -o")
    name = f"{source.stem}.{sweep or '-'.join(variants)}.{'usdc' if flatten else 'usda'}"
    if output is None:
        root = Path(name)
    elif output.endswith("/") or Path(output).is_dir():
        root = Path(output) / name
    else:
        root = Path(output)
        if root.suffix not in USD_SUFFIXES:
            raise UsageError(
                f"-o {output}: a root layer ends in .usda, .usd or .usdc, a package in .usdz",
                f"name it {root.name}.usda, or end a folder's name in /",
            )
    flat = flatten or root.suffix == PACKAGE_SUFFIX
    if flat and len(variants) > 1:
        raise UsageError(
            f"{root.name} would be one file for {len(variants)} materials: {', '.join(variants)}",
            "a flattened bake holds one material: bake them one by one, or write layers",
        )
    if not is_utf8(root):
        shown = str(root).encode(errors="backslashreplace").decode()
        raise UsageError(
            f"-o {shown}: its path has bytes that are not UTF-8, and USD cannot open it",
            "choose another -o",
        )
    stem = root.name[: -len(root.suffix)]
    is_usd = source.suffix.lower() in USD_SUFFIXES
    parts = ("",) if len(variants) == 1 else tuple(f".{variant}" for variant in variants)
    layer = None
    if not flat and (divided or not is_usd):
        layer = root.with_name(f"{stem if divided else source.stem}.source.usdc")
    files = Outputs(
        root=root,
        caches=tuple(root.with_name(f"{stem}{part}{CACHE_SUFFIX}") for part in parts),
        report=root.with_name(f"{stem}{REPORT}"),
        source=layer,
        flat=flat,
        sheet=root.with_name(f"{stem}{SHEET}") if sweep else None,
    )
    for path in files.all:
        if same_place(path, source):
            raise UsageError(
                f"{path} is the asset itself, which is never modified", "choose another -o"
            )
        if files.all.count(path) > 1:
            raise UsageError(f"two results would be named {path}", "choose another -o")
    return files


def _require_names(variants: Sequence[str]) -> None:
    """Raise UsageError where two variants, and so their caches, would have one name."""
    for variant in variants:
        if variants.count(variant) > 1:
            raise UsageError(
                f"--material has {variants.count(variant)} materials named {variant!r}",
                "name each once; a material of a file is called after its prim",
            )
        if variant == SOURCE_VARIANT:
            raise UsageError(
                f"a material is named {variant!r}, which is the variant that shows the source",
                "give its prim another name",
            )


def require_free(files: Outputs, overwrite: bool, *, resume: bool = False) -> None:
    """Raise UsageError where a result exists already, or no folder can hold it.

    resume : the bake was to be resumed, and there is no checkpoint of it.
    """
    there = [p for p in files.own if p.exists() and not is_failure_report(p)]
    if there and not overwrite:
        left = ", and there is no checkpoint from which to resume" if resume else ""
        raise UsageError(
            f"{there[0]} exists already{left}",
            "add --overwrite to replace it, or choose another -o",
        )
    parent = files.root.parent
    while not parent.exists() and parent != parent.parent:
        if parent.is_symlink():
            raise UsageError(
                f"{parent} is a symbolic link to {os.readlink(parent)}, which does not exist",
                "make that folder, or choose another with -o",
            )
        parent = parent.parent
    if not parent.is_dir():
        raise UsageError(f"{parent} is not a folder", "choose a folder to write to with -o")
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise UsageError(
            f"{parent} cannot be written to: {error.strerror}",
            "choose another folder with -o, or change its permissions",
        ) from error


def require_no_input_of_bake(files: Outputs, inputs: Sequence[Path]) -> None:
    """Raise UsageError where a result would replace a file that the bake reads."""
    for path in files.all:
        if any(same_place(path, read) for read in inputs):
            raise UsageError(
                f"{path} is a file that the bake reads, which is never modified",
                "choose another -o",
            )


def require_source_free(
    files: Outputs,
    is_current: bool,
    overwrite: bool,
    other: str = "",
    *,
    other_version: bool = False,
) -> None:
    """Raise UsageError where the layer of a mesh file would replace a different one.

    is_current : the existing layer was made from the same file with the same options by the same
        version of the converter, and is reused.
    other : the file of another name of which it was made.  Its bakes are not what is to be
        overwritten, and would show this one.
    other_version : another version of the converter made it.
    """
    if other:
        raise UsageError(
            f"{files.source} was made from {other}, and bakes of it may be layered over it",
            f"choose another folder with -o, or delete {files.source} and these bakes",
        )
    if overwrite or is_current or files.source is None:
        return
    difference = "from another file or with other options"
    if other_version:
        difference = "by another version of gf-usd"
    there = [p for p in (files.source, *files.textures) if p.exists()]
    if there:
        raise UsageError(
            f"{there[0]} exists already, and was made {difference}",
            "add --overwrite to replace it (other bakes may be layered over it), or choose another"
            " folder with -o",
        )


def is_failure_report(path: Path) -> bool:
    """Whether a file is the report of a failed bake, which may be replaced."""
    if not path.name.endswith(REPORT):
        return False
    try:
        text = path.read_text(encoding="utf-8")
        report = json.loads(text) if '"failed"' in text else None  # reports are long
    except (OSError, ValueError):
        return False
    return isinstance(report, dict) and "failed" in report


def report_of_failure(files: Outputs) -> Path:
    """The report file of a failed bake: the report's name, unless it has the report of a good
    one.
    """
    good = files.report.exists() and not is_failure_report(files.report)
    return partial_path(files.report) if good else files.report


RESUME = "run the same command with --resume to continue"  # the hint of an interrupted bake


def interrupted(files: Outputs) -> bool:
    """Whether a bake of these names was interrupted and can be resumed."""
    return any(path.exists() for path in files.checkpoints)


def create_output_folder(files: Outputs) -> None:
    """Make the folder of the results, and remove files of a failed bake of these names.

    Raises UsageError where they cannot be removed.
    """
    files.root.parent.mkdir(parents=True, exist_ok=True)
    made = {*files.own, *files.caches, files.layers}
    stale = [partial_path(path) for path in sorted(made)]
    if is_failure_report(files.report):
        stale.append(files.report)
    for path in stale:
        remove_stale(path)


def remove_stale(path: Path, instead: str = "choose another -o") -> None:
    """Remove a file of an earlier bake, if it exists.

    Raises UsageError where that fails; instead : what else the hint proposes.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(
            f"{path} of an earlier bake cannot be removed: {error.strerror}",
            f"remove it, or {instead}",
        ) from error


DIGITS = 4


@dataclass(frozen=True, kw_only=True)
class SplatSequence:
    """The splat files of one bake: ``FOLDER/bob.jelly.0001.ply`` and so on."""

    folder: Path
    stem: str  # "bob.jelly"
    suffix: str  # a key of WRITERS

    def path(self, index: int) -> Path:
        """The file of a frame, counted from 0; its name counts from 1."""
        return self.folder / f"{self.stem}.{index + 1:0{DIGITS}d}.{self.suffix}"

    @property
    def lock(self) -> Path:
        """The lock file while frames are written."""
        return self.folder / f"{self.stem}.{self.suffix}"

    def existing_frames(self) -> list[Path]:
        """The existing files of this sequence."""
        stem = glob.escape(self.stem)  # of the asset's file, which may be called "duck[1]"
        return sorted(self.folder.glob(f"{stem}.{'[0-9]' * DIGITS}*.{self.suffix}"))

    def write(self, splats: Splats, index: int) -> Path:
        """Write a frame atomically.  Raises BakeError where it cannot be written."""
        path = self.path(index)
        with dropped_on_failure(path) as partial:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                partial.write_bytes(WRITERS[self.suffix](splats))
            except OSError as error:
                raise BakeError(
                    f"{partial} could not be written: {error.strerror}",
                    f"check that {self.folder} is writable and has space left",
                ) from error
            return publish(path)


def sequences(
    stem: str, variants: Sequence[str], *, ply: str | None, spz: str | None
) -> tuple[tuple[SplatSequence, ...], ...]:
    """The sequences of each variant; none where no folder is given."""
    requested = [(folder, suffix) for folder, suffix in ((ply, "ply"), (spz, "spz")) if folder]
    return tuple(
        tuple(
            SplatSequence(folder=Path(folder), stem=f"{stem}.{variant}", suffix=suffix)
            for folder, suffix in requested
        )
        for variant in variants
    )


def require_free_sequences(requested: Sequence[Sequence[SplatSequence]], overwrite: bool) -> None:
    """Raise UsageError where a frame exists already, or a folder's name is that of a file."""
    for sequence in (one for each in requested for one in each):
        if sequence.folder.exists() and not sequence.folder.is_dir():
            raise UsageError(f"{sequence.folder} is not a folder", "name another for the frames")
        there = sequence.existing_frames()
        if there and not overwrite:
            raise UsageError(
                f"{there[0]} exists already",
                "add --overwrite to replace it, or name another folder",
            )


def clear(requested: Sequence[SplatSequence]) -> None:
    """Remove the frames of an earlier bake, which may have been longer.

    Raises UsageError where one cannot be removed.
    """
    for path in (path for sequence in requested for path in sequence.existing_frames()):
        remove_stale(path, "name another folder")


Stamp = tuple[int, int] | None  # (time of change [ns], inode); None: no such file
Stamps = tuple[tuple[Path, Stamp], ...]


def stamps(files: Outputs) -> Stamps:
    """Identities of all result and checkpoint files."""
    paths = (files.root, *files.caches, files.report, *files.checkpoints)
    return tuple((path, stamp(path)) for path in paths)


def stamp(path: Path) -> Stamp:
    """Identity of the file at a path now.  Raises UsageError for a link that leads to itself."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise UsageError(f"{path}: {error.strerror}", "choose another -o") from error
    return found.st_mtime_ns, found.st_ino
