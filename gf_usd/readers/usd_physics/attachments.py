"""Attachments of the AOUSD proposal for deformables: points of a body attached to a prim.

    PhysicsAttachment   physics:src0, type0 "point", indices0    points of a baked mesh
                        physics:src1, type1 "xform", coords1     positions in the frame of a prim
                        physics:stiffness                        inf, or not authored: constraint
                        physics:damping                          of springs

    OmniPhysicsVtxXformAttachment, of Omniverse: omniphysics:src0, :vtxIndicesSrc0, :src1,
    :localPositionsSrc1, :stiffness and :damping, with the same meaning

Faces whose corners are all attached are constrained to the motion of the prim.  A finite stiffness
k [mass / second^2] and damping c [mass / second] give each point p a spring and a damper to its
target y, of force k (y - p) + c (dy/dt - dp/dt).  These are the units of Omniverse's schema.  The
proposal (OpenUSD-proposals 111, June 2026) has the same damping, and a stiffness of force / area,
which is not defined for a pair of points: it is read as force / length.  As in the proposal,
damping applies only where the stiffness is finite.  Attachments of other types are skipped with a
note.

Targets may have time samples.  A bake with `--tets` writes attachments of its tetrahedra for other
simulators; their attribute gaussianFlesh:pin names the region of the mesh that they represent,
which is pinned when that stage is baked again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts, Surface, first_time_code
from gf_usd.core.errors import InputError
from gf_usd.core.stage import Region
from gf_usd.core.units import code_text, length_text
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.mesh import read_surface
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.readers.usd_physics.attributes import authored, invalid_value, switch
from gf_usd.readers.usd_physics.motion import Readings, matrix, transform_varies

T = TypeVar("T")

AOUSD, OMNI = "PhysicsAttachment", "OmniPhysicsVtxXformAttachment"
# by prim type: prefix of its attributes, and names of the arrays of points and of targets
KINDS = {
    AOUSD: ("physics:", "indices0", "coords1"),
    OMNI: ("omniphysics:", "vtxIndicesSrc0", "localPositionsSrc1"),
}
ENABLED, STIFFNESS, DAMPING = "attachmentEnabled", "stiffness", "damping"
PIN, ANCHORS = "gaussianFlesh:pin", "gaussianFlesh:anchors"
MESHES = "gaussianFlesh:sourceMeshes"
APART = 1e-3  # of the body's size: distance of points from their targets that is noted


def attachments_of(
    prims: Iterable[Usd.Prim],
    bodies: Sequence[str],
    time: Usd.TimeCode,
    notes: Notes,
    *,
    file: Path,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Paths of the enabled attachments of the bodies: constraints, and springs; notes on others.

    file : for messages.  Raises InputError for a negative stiffness or damping, or one that is not
    a number.
    """
    found: list[str] = []
    soft: list[str] = []
    for prim in prims:
        if prim.GetTypeName() not in KINDS:
            continue
        if not switch(prim, _name(prim, ENABLED), time, otherwise=True):
            continue
        if authored(prim, PIN, time) is not None:
            if _concerns(prim, bodies):
                found.append(str(prim.GetPath()))
            continue
        sources = [_source(prim, name) for name in ("src0", "src1")]
        if not set(sources) & set(bodies):
            continue
        path = str(prim.GetPath())
        kinds = [authored(prim, _name(prim, f"type{k}"), time) for k in (0, 1)]
        if prim.GetTypeName() == OMNI:
            kinds = ["point", "xform"]
        stiffness, _ = (_constant(file, prim, name, time) for name in (STIFFNESS, DAMPING))
        for name in (STIFFNESS, DAMPING):
            attribute = prim.GetAttribute(_name(prim, name))
            if attribute and attribute.GetNumTimeSamples() > 1:
                notes.add(f"{name} has time samples but keeps the value of the rest pose", path)
        if kinds != ["point", "xform"] or sources[0] not in bodies:
            notes.add("does not attach points of a mesh to an xform: ignored", path)
        elif stiffness is None or stiffness == np.inf:
            found.append(path)
        elif stiffness == 0.0:
            notes.add("is an attachment of stiffness 0: ignored", path)
        else:
            soft.append(path)
    return tuple(found), tuple(soft)


def _concerns(prim: Usd.Prim, bodies: Sequence[str]) -> bool:
    """Whether an attachment written by a bake is of one of the bodies."""
    relation = prim.GetRelationship(MESHES)
    meshes = {str(path) for path in relation.GetForwardedTargets()} if relation else set()
    return not meshes or bool(meshes & set(bodies))


def _constant(file: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float | None:
    """A stiffness or damping, stage units; None where it is not authored."""
    value = authored(prim, _name(prim, name), time)
    if value is None:
        return None
    finite = name == STIFFNESS or value != np.inf
    if not isinstance(value, float | int) or not value >= 0.0 or not finite:
        raise invalid_value(file, prim, _name(prim, name), value, "author a number of 0 or more")
    return float(value)


def read_attachments(
    file: Path,
    paths: Sequence[str],
    facts: StageFacts,
    *,
    rest: float | None,
    times: Sequence[float],
) -> tuple[tuple[Region, ...], tuple[str, ...]]:
    """The regions that attachments constrain, and notes; arguments as of `read_physics`.

    Raises InputError for arrays of inconsistent lengths, indices that are not points of the mesh,
    and a missing source.
    """
    notes = Notes()
    regions = _each(
        file, paths, facts, rest,
        lambda prim, readings, time: _region(prim, readings, time, times, notes),
    )  # fmt: skip
    return tuple(regions), notes.lines()


def _each(
    file: Path,
    paths: Sequence[str],
    facts: StageFacts,
    rest: float | None,
    read: Callable[[Usd.Prim, Readings, Usd.TimeCode], T],
) -> list[T]:
    """The results of `read` for each attachment; rest : time code of the rest pose."""
    with reading(file):
        stage, readings = open_stage(file), Readings(facts)
        time = Usd.TimeCode(first_time_code(facts, rest))
        return [read(named_prim(stage, facts.path, path), readings, time) for path in paths]


@dataclass(frozen=True, kw_only=True)
class WrittenPin:
    """A pin that an earlier bake wrote as an attachment."""

    name: str  # prim path of the attachment
    region: str  # in the syntax of --pin
    path: Floats  # (F, n, 3) [m] positions of the targets at each frame; F = 1: constant


def read_written_pins(
    file: Path,
    paths: Sequence[str],
    facts: StageFacts,
    *,
    rest: float | None,
    times: Sequence[float],
) -> tuple[WrittenPin, ...]:
    """The attachments with gaussianFlesh:pin; arguments and errors as of `read_attachments`."""

    def read(prim: Usd.Prim, readings: Readings, time: Usd.TimeCode) -> WrittenPin | None:
        region = authored(prim, PIN, time)
        if region is None:
            return None
        if not isinstance(region, str) or not region:
            raise invalid_value(
                facts.path, prim, PIN, region, "author a region in the form that --pin accepts"
            )
        if region.startswith("/") and not prim.GetStage().GetPrimAtPath(region):
            raise invalid_value(
                facts.path, prim, PIN, region, "author the path of an existing prim"
            )
        has_anchors = authored(prim, ANCHORS, time) is not None
        places = _Targets(prim, readings, ANCHORS if has_anchors else "")
        if not places.at(time).size:
            raise invalid_value(
                facts.path, prim, places.name, [], "author the positions that are held, or bake"
                " the asset again with --pin and --tets",
            )  # fmt: skip
        return WrittenPin(name=str(prim.GetPath()), region=region, path=places.over(time, times))

    return tuple(one for one in _each(file, paths, facts, rest, read) if one is not None)


@dataclass(frozen=True, kw_only=True)
class SoftAttachment:
    """Points of a mesh that are attached by springs."""

    body: str  # prim path of the mesh
    points: Ints  # (n,) of the mesh
    X: Floats  # (n, 3) [m] at rest, world
    path: Floats  # (F, n, 3) [m] positions of the targets; F = 1: constant
    stiffness: float  # [N/m] of each
    damping: float  # [N s/m] of each


def read_soft_attachments(
    file: Path,
    paths: Sequence[str],
    facts: StageFacts,
    *,
    rest: float | None,
    times: Sequence[float],
) -> tuple[SoftAttachment, ...]:
    """The springs of attachments; arguments and errors as of `read_attachments`."""

    def read(prim: Usd.Prim, readings: Readings, time: Usd.TimeCode) -> SoftAttachment:
        surface, indices, places = _attached(prim, readings, time)
        each = [_constant(facts.path, prim, name, time) or 0.0 for name in (STIFFNESS, DAMPING)]
        return SoftAttachment(
            body=surface.path,
            points=indices,
            X=surface.points[indices],
            path=places.over(time, times),
            stiffness=each[0] * facts.units.mass,
            damping=each[1] * facts.units.mass,
        )

    return tuple(_each(file, paths, facts, rest, read))


def _name(prim: Usd.Prim, name: str) -> str:
    """The full name of an attribute for the prim's attachment type."""
    return KINDS[str(prim.GetTypeName())][0] + name


def _source(prim: Usd.Prim, name: str) -> str:
    """The target of a relationship; "" where it has none, or several."""
    relation = prim.GetRelationship(_name(prim, name))
    targets = relation.GetForwardedTargets() if relation else []
    return str(targets[0]) if len(targets) == 1 else ""


def _region(
    prim: Usd.Prim, readings: Readings, time: Usd.TimeCode, times: Sequence[float], notes: Notes
) -> Region:
    where = f"{readings.facts.path}: <{prim.GetPath()}>"
    surface, indices, places = _attached(prim, readings, time)
    chosen = surface.triangles[np.isin(surface.triangles, indices).all(1)]
    if not len(chosen):
        raise InputError(
            f"{where}: its {len(indices)} points do not include all corners of any face",
            "attach all corners of each face to be held",
        )
    used, renumbered = np.unique(chosen, return_inverse=True)
    points = surface.points[used]
    path = places.over(time, times)[:, _rows(indices, used)]
    apart = float(np.linalg.norm(path[0] - points, axis=1).max())
    if apart > APART * float(np.linalg.norm(np.ptp(surface.points, axis=0))):
        notes.add(
            f"has points up to {length_text(apart)} away from the positions they are attached"
            f" to: they are held at their own positions and move with them",
            str(prim.GetPath()),
        )
    return Region(
        name=str(prim.GetPath()),
        kind="patch",
        points=points,
        triangles=renumbered.reshape(-1, 3),
        path=points + (path - path[0]),
        body=surface.path,
    )


class _Targets:
    """The target positions of an attachment over time.

    name : of the attribute; "": that of the attachment's type.
    Raises InputError where the prim that they are relative to does not exist.
    """

    def __init__(self, prim: Usd.Prim, readings: Readings, name: str = "") -> None:
        self._prim, self._readings = prim, readings
        facts = readings.facts
        self._carrier = named_prim(prim.GetStage(), facts.path, _source(prim, "src1"))
        self.name = name or _name(prim, KINDS[str(prim.GetTypeName())][2])
        self._where = f"{facts.path}: <{prim.GetPath()}>"

    def at(self, time: Usd.TimeCode) -> NDArray[np.float64]:
        """(n, 3) in the frame of the target prim, stage units."""
        value = authored(self._prim, self.name, time)
        return np.asarray([] if value is None else value, np.float64).reshape(-1, 3)

    def over(self, rest: Usd.TimeCode, times: Sequence[float]) -> NDArray[np.float64]:
        """(F, n, 3) [m] world positions at time codes; F = 1 where they are constant.

        Raises InputError for a number of positions that varies over time.
        """
        attribute = self._prim.GetAttribute(self.name)
        moves = transform_varies(self._carrier) or attribute.ValueMightBeTimeVarying()
        still = self.at(rest)
        rows = [self._world(still, Usd.TimeCode(code)) for code in (times if moves else times[:1])]
        return np.stack(rows)

    def _world(self, still: Floats, time: Usd.TimeCode) -> NDArray[np.float64]:
        places = self.at(time)
        if places.shape != still.shape:
            raise InputError(
                f"{self._where}: {self.name} has {len(places)} positions at time code "
                f"{code_text(time.GetValue())} but {len(still)} at rest",
                "author the same number of positions at all times",
            )
        M = matrix(self._carrier, self._readings.at(time))
        return (places @ M[:3, :3] + M[3, :3]) * self._readings.facts.units.length


def _attached(
    prim: Usd.Prim, readings: Readings, time: Usd.TimeCode
) -> tuple[Surface, Ints, _Targets]:
    """The mesh, its attached points (n,), and their targets.

    Raises InputError where they are inconsistent.
    """
    facts, stage = readings.facts, prim.GetStage()
    where = f"{facts.path}: <{prim.GetPath()}>"
    body = named_prim(stage, facts.path, _source(prim, "src0"))
    surface = read_surface(body, readings.at(time))
    _, of, name = KINDS[str(prim.GetTypeName())]
    places = _Targets(prim, readings)
    indices = np.asarray(_array(prim, of, time), np.int64).reshape(-1)
    coords = places.at(time)
    if len(coords) != len(indices) or not len(indices):
        raise InputError(
            f"{where} has {len(indices)} {of} but {len(coords)} {name}",
            "author one position for each attached point",
        )
    if indices.min() < 0 or indices.max() >= len(surface.points):
        raise InputError(
            f"{where}: its {of} range from {indices.min()} to {indices.max()}, but"
            f" <{body.GetPath()}> has {len(surface.points)} points",
            "give indices of points of the mesh",
        )
    return surface, indices, places


def _array(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Floats:
    value = authored(prim, _name(prim, name), time)
    return np.asarray([] if value is None else value)


def _rows(indices: Ints, used: Ints) -> Ints:
    """The first row in `indices` of each used point."""
    order = np.argsort(indices, kind="stable")
    return order[np.searchsorted(indices[order], used)]
