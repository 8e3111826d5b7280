"""Reading of an asset in a child process, so that a library crash does not end the main process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core.asset import Asset
from gf_usd.core.stage import StageSpec
from gf_usd.system.sandbox import Isolated, Limits

if TYPE_CHECKING:
    from gf_usd.readers.mesh.to_usd import MeshSource

TASK = "gf_usd.readers.isolated:send"


@dataclass(frozen=True, kw_only=True)
class Source:
    """The data of an input file for a bake."""

    asset: Asset
    spec: StageSpec | None  # settings and physics of the stage; None: a mesh file, or not yet read
    converted: MeshSource | None = None  # of a mesh file, or of one whose faces were subdivided


@dataclass(frozen=True, kw_only=True)
class Sent:
    """A `Source` as the child process returns it."""

    asset: Asset
    spec: StageSpec | None
    folder: Path | None  # of the layer converted from a mesh file
    record: dict[str, str]
    notes: tuple[str, ...]
    sources: dict[str, str]  # origin of its unit and axis, as in `notes.source_of`


class Reading:
    """A file that is being read, in a child process where limits are given."""

    def __init__(self, path: Path, limits: Limits | None, **options: Any) -> None:
        """Options are those of `read_untrusted`."""
        self._path, self._options = path, options
        self._isolated = Isolated(path, TASK, limits, path, options)

    def result(self) -> Source:
        """The data read.  Raises InputError as `read_untrusted` and `Isolated.result`."""
        if not self._isolated.in_child:
            return read_untrusted(self._path, **self._options)
        sent: Sent = self._isolated.result()
        converted = None
        if sent.folder is not None:
            from gf_usd.readers.mesh.to_usd import Folder, MeshSource

            folder = Folder(sent.folder, self._isolated.scratch)
            converted = MeshSource(self._path, folder, sent.record, sent.notes, sent.sources)
        return Source(asset=sent.asset, spec=sent.spec, converted=converted)

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *error: object) -> None:
        self._isolated.__exit__(*error)


def send(path: Path, options: dict[str, Any]) -> Sent:
    """In the child process: read a file, and keep the folder of a converted layer."""
    read = read_untrusted(path, **options)
    made = read.converted
    return Sent(
        asset=read.asset,
        spec=read.spec,
        folder=None if made is None else made.folder.release(),
        record={} if made is None else made.record,
        notes=() if made is None else made.notes,
        sources={} if made is None else dict(made.sources),
    )


def read_untrusted(
    path: Path,
    *,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    time_code: float | None = None,
    elastic: bool = True,
    bind_pose: bool = False,
    fps: float | None = None,
    max_edge_length: float | None = None,
    edges_for: int | None = None,
) -> Source:
    """Read the data of a file for a bake, in this process.

    The options are those of `read_asset`, `convert` and `read_stage_spec`.

    max_edge_length : [stage units] faces with longer edges are subdivided.
    edges_for : number of particles; faces with edges longer than two of their spacings are
        subdivided.

    Raises InputError as these functions and `divided` do.
    """
    from gf_usd.readers import convert, read_asset

    converted = convert(
        path, meters_per_unit=meters_per_unit, up_axis=up_axis, rigged=bind_pose, fps=fps
    )
    if converted is not None:
        asset = converted.asset(prims=tuple(prims), time_code=time_code, bind_pose=bind_pose)
        if max_edge_length or edges_for:
            converted, notes = _divided(path, asset, max_edge_length, edges_for, converted)
            asset = converted.asset(prims=tuple(prims), time_code=time_code, bind_pose=bind_pose)
            asset = _noted(asset, notes)
        return Source(asset=asset, spec=None, converted=converted)
    # the import registers the schema before a stage is opened
    from gf_usd.readers.usd_bake.spec import read_stage_spec
    from gf_usd.system import usd_schema  # noqa: F401

    asset = read_asset(
        path,
        prims=prims,
        meters_per_unit=meters_per_unit,
        up_axis=up_axis,
        time_code=time_code,
        bind_pose=bind_pose,
    )
    file = path
    if max_edge_length or edges_for:
        from gf_usd.readers.usd.asset import read_usd

        converted, notes = _divided(path, asset, max_edge_length, edges_for)
        file = converted.layer
        asset = read_usd(
            file, prims=prims, meters_per_unit=meters_per_unit, up_axis=up_axis,
            time_code=time_code, bind_pose=bind_pose, named=path,
        )  # fmt: skip
        asset = _noted(asset, notes)
    if asset.splats:  # the stage is read later, for the surfaces reconstructed from them
        return Source(asset=asset, spec=None, converted=converted)
    # no animation precedes the bind pose, so that initial velocities are 0
    rest = None if bind_pose else time_code
    asset, spec = read_stage_spec(asset, file, prims, rest=rest, elastic=elastic)
    return Source(asset=asset, spec=spec, converted=converted)


def _divided(
    path: Path, asset: Asset, longest: float | None, particles: int | None,
    of: MeshSource | None = None,
) -> tuple[MeshSource, tuple[str, ...]]:  # fmt: skip
    """The subdivided asset, see `divided`, and notes."""
    from gf_usd.readers.mesh.divide.layer import divided, fine_edge
    from gf_usd.readers.notes import Notes

    notes, unit = Notes(), asset.facts.units.length
    edge = longest * unit if longest else fine_edge(asset.surfaces, particles or 1)
    made = divided(
        path, asset.surfaces, edge, given=longest is not None, of=of, unit=unit, note=notes.add
    )
    return made, notes.lines()


def _noted(asset: Asset, notes: tuple[str, ...]) -> Asset:
    return replace(asset, facts=replace(asset.facts, notes=(*asset.facts.notes, *notes)))
