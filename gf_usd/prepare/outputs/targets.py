"""Which files a bake will write, found before anything is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.materials.material import Material
from gf_usd.prepare.options.sweep import Swept
from gf_usd.prepare.outputs.outputs import (
    Outputs,
    SplatSequence,
    Stamp,
    Stamps,
    interrupted,
    outputs,
    require_free,
    require_free_sequences,
    require_source_free,
    sequences,
    stamp,
    stamps,
)
from gf_usd.readers.inputs import layer_files

if TYPE_CHECKING:
    from gf_usd.readers.mesh.to_usd import MeshSource


@dataclass(frozen=True, kw_only=True)
class Targets:
    """The output files of a bake, and those that exist."""

    files: Outputs
    sequences: tuple[tuple[SplatSequence, ...], ...]  # splat files of each variant
    seen: Stamps
    overwrite: bool  # what is there may be replaced


def targets_of(
    source: Path,
    presets: Sequence[Any],
    target: str | None,
    *,
    flatten: bool,
    divided: bool,
    ply: str | None,
    spz: str | None,
    overwrite: bool,
    resume: bool,
) -> Targets:
    """The targets of a bake.

    divided : the faces of the asset are divided, see `outputs`; ply, spz : folders of splat files.

    Raises UsageError where existing files prevent it.
    """
    names = [preset.name for preset in presets]
    sweep = presets[0].swept if isinstance(presets[0], Swept) else None
    files = outputs(source, names, target, flatten, sweep, divided=divided)
    seen = stamps(files)
    # what it wrote before it ended was free to be written
    overwrite = overwrite or (resume and interrupted(files))
    require_free(files, overwrite, resume=resume)
    requested = sequences(source.stem, names, ply=ply, spz=spz)
    require_free_sequences(requested, overwrite)
    return Targets(files=files, sequences=requested, seen=seen, overwrite=overwrite)


def files_read(
    source: Path, material: str | tuple[str | Material, ...] | None, colliders: Sequence[str]
) -> list[Path]:
    """The files that a bake reads, with the layers of those of USD."""
    from gf_usd.readers.usd_bake.material_file import is_material_file

    named = material.split(",") if isinstance(material, str) else material or ()
    given = [source, *map(Path, colliders)]
    given += [Path(one) for one in named if isinstance(one, str) and is_material_file(one)]
    usd = [path for path in given if path.suffix.lower() in USD_SUFFIXES]
    return given + [file for path in usd for file in layer_files(path)]


def with_layer(
    targets: Targets, converted: MeshSource | None, *, shared: bool
) -> tuple[Outputs, Stamp]:
    """The outputs with the pictures of a mesh file, and the existing source layer.

    shared : by bakes of the mesh file.

    Raises UsageError where existing files prevent writing it.
    """
    files = targets.files
    if converted is None:
        return files, None
    if (layer := files.source) is not None:
        files = replace(files, textures=converted.textures(layer))
        seen = stamp(layer)
        other = converted.other_file(layer) if shared else ""
        require_source_free(
            files, converted.is_at(layer), targets.overwrite, other,
            other_version=converted.is_of_other_version(layer),
        )  # fmt: skip
        return files, seen
    if not files.is_package:
        files = replace(files, textures=converted.textures(files.root))
        require_free(files, targets.overwrite)
    return files, None
