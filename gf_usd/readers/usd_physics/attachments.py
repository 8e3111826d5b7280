"""Attachments of the AOUSD proposal for deformables: points of a body that a prim carries along.

    PhysicsAttachment   physics:src0, type0 "point", indices0    points of a mesh that is baked
                        physics:src1, type1 "xform", coords1     places in the frame of a prim
                        physics:stiffness                        inf, or not authored: held

The faces whose corners are all attached are held, and move as the prim does.  What stands for a
spring, and what attaches other things, is left alone with a note.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts, first_time_code
from gf_usd.core.errors import InputError
from gf_usd.core.stage import Region
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.mesh import read_surface
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.readers.usd_physics.attributes import authored, switch
from gf_usd.readers.usd_physics.motion import Readings, matrix, transform_varies

ATTACHMENT = "PhysicsAttachment"
ENABLED, STIFFNESS = "physics:attachmentEnabled", "physics:stiffness"
APART = 1e-3  # of the body: farther apart than this, attached points are not where they are held


def attachments_of(
    prims: Iterable[Usd.Prim], bodies: Sequence[str], time: Usd.TimeCode, notes: Notes
) -> tuple[str, ...]:
    """Paths of the enabled attachments that hold points of the bodies; notes on the others."""
    found = []
    for prim in prims:
        if prim.GetTypeName() != ATTACHMENT or not switch(prim, ENABLED, time, otherwise=True):
            continue
        sources = [_source(prim, name) for name in ("src0", "src1")]
        if not set(sources) & set(bodies):
            continue
        path = str(prim.GetPath())
        kinds = [authored(prim, f"physics:type{k}", time) for k in (0, 1)]
        stiffness = authored(prim, STIFFNESS, time)
        if kinds != ["point", "xform"] or sources[0] not in bodies:
            notes.add("attaches other than points of a mesh to an xform: not read", path)
        elif stiffness is not None and stiffness < np.inf:
            notes.add("is a soft attachment: not read, only those of stiffness inf hold", path)
        else:
            found.append(path)
    return tuple(found)


def read_attachments(
    file: Path,
    paths: Sequence[str],
    facts: StageFacts,
    *,
    rest: float | None,
    times: Sequence[float],
) -> tuple[tuple[Region, ...], tuple[str, ...]]:
    """The regions that attachments hold, and notes; arguments as of `read_physics`.

    Raises InputError for arrays that do not fit each other or the mesh, and for a source that is
    not there.
    """
    with reading(file):
        stage, notes, readings = open_stage(file), Notes(), Readings(facts)
        time = Usd.TimeCode(first_time_code(facts, rest))
        regions = [
            _region(named_prim(stage, facts.path, path), readings, time, times, notes)
            for path in paths
        ]
    return tuple(regions), notes.lines()


def _source(prim: Usd.Prim, name: str) -> str:
    """The path that a relationship names; empty where it names none, or several."""
    relation = prim.GetRelationship(f"physics:{name}")
    targets = relation.GetForwardedTargets() if relation else []
    return str(targets[0]) if len(targets) == 1 else ""


def _region(
    prim: Usd.Prim, readings: Readings, time: Usd.TimeCode, times: Sequence[float], notes: Notes
) -> Region:
    facts, stage = readings.facts, prim.GetStage()
    where = f"{facts.path}: <{prim.GetPath()}>"
    body, carrier = (named_prim(stage, facts.path, _source(prim, n)) for n in ("src0", "src1"))
    surface = read_surface(body, readings.at(time))
    indices = np.asarray(_array(prim, "indices0", time), np.int64).reshape(-1)
    coords = np.asarray(_array(prim, "coords1", time), np.float64).reshape(-1, 3)
    if len(coords) != len(indices) or not len(indices):
        raise InputError(
            f"{where} has {len(indices)} indices0 and {len(coords)} coords1",
            "author one place for each attached point",
        )
    if indices.min() < 0 or indices.max() >= len(surface.points):
        raise InputError(
            f"{where}: its indices0 reach from {indices.min()} to {indices.max()}, and"
            f" <{body.GetPath()}> has {len(surface.points)} points",
            "attach points of the mesh",
        )
    chosen = surface.triangles[np.isin(surface.triangles, indices).all(1)]
    if not len(chosen):
        raise InputError(
            f"{where}: its {len(indices)} points are all corners of no face",
            "attach all corners of the faces that are to be held",
        )
    used, renumbered = np.unique(chosen, return_inverse=True)
    places = coords[_rows(indices, used)]
    points = surface.points[used]
    path = _carried(carrier, readings, places, times if transform_varies(carrier) else times[:1])
    apart = float(np.linalg.norm(path[0] - points, axis=1).max())
    if apart > APART * float(np.linalg.norm(np.ptp(surface.points, axis=0))):
        notes.add(
            f"has points up to {apart:.3g} m from their places: they are held where they are, and"
            " move as the places do",
            str(prim.GetPath()),
        )
    return Region(
        name=str(prim.GetPath()),
        kind="patch",
        points=points,
        triangles=renumbered.reshape(-1, 3),
        path=points + (path - path[0]),
        body=str(body.GetPath()),
    )


def _array(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Floats:
    value = authored(prim, f"physics:{name}", time)
    return np.asarray([] if value is None else value)


def _rows(indices: Ints, used: Ints) -> Ints:
    """Where each used point stands among the indices; the first of several."""
    order = np.argsort(indices, kind="stable")
    return order[np.searchsorted(indices[order], used)]


def _carried(
    carrier: Usd.Prim, readings: Readings, places: Floats, times: Sequence[float]
) -> NDArray[np.float64]:
    """(F, n, 3) [m] world of places (n, 3) in the frame of a prim."""
    rows = [matrix(carrier, readings.at(Usd.TimeCode(code))) for code in times]
    unit = readings.facts.units.length
    return np.stack([(places @ M[:3, :3] + M[3, :3]) * unit for M in rows])
