"""Morph targets of a glTF file: at fixed weights, or as blend shapes with weights over time.

glTF 2.0, 3.7.2.2: an attribute is at base + sum_i w_i target_i, before skinning.  The weights w_i
are those of the animation, else of the node, else those of its mesh, else 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, counted
from gf_usd.readers.mesh.data import REPAIR, FileShape
from gf_usd.readers.mesh.gltf.container import Gltf
from gf_usd.readers.mesh.gltf.primitives import Primitive, decoded
from gf_usd.readers.notes import Notes

MORPHED = ("POSITION", "NORMAL")  # other attributes keep their base values
NAMED = 4  # targets that a note lists


def target_count(mesh: dict[str, Any]) -> int:
    """The largest number of morph targets of a primitive of a mesh."""
    return max((len(row.get("targets", [])) for row in mesh["primitives"]), default=0)


def morphed(
    gltf: Gltf,
    node: dict[str, Any],
    primitives: dict[int, Primitive],
    notes: Notes,
    where: str,
    name: str,
    over_time: Floats | None = None,
) -> list[Primitive]:
    """The primitives of the mesh of a node with its morph targets applied, except for those whose
    weights change over time.

    primitives : of the mesh, by their index in it; where, name : of the mesh and the node, for
    notes; over_time : (F, K) weights of an animation.

    Raises InputError for weights and targets that do not fit the mesh.
    """
    mesh = gltf.row("meshes", node["mesh"])
    rows = {p: mesh["primitives"][p].get("targets", []) for p in primitives}
    count = max(map(len, rows.values()), default=0)
    if not count:
        return list(primitives.values())
    weights = node.get("weights") or mesh.get("weights") or [0.0] * count
    moving = np.zeros(len(weights), bool)
    if over_time is not None:
        weights, moving = over_time[0].tolist(), np.ptp(over_time, axis=0) > 0.0
    for p, targets in rows.items():  # a primitive without targets is the same at all weights
        if targets and not len(weights) == len(targets) == count:
            raise InputError(
                f"{gltf.path}: mesh '{where}' has {counted(len(weights), 'weight')} for the "
                f"{counted(len(targets), 'morph target')} of its primitive {p}",
                REPAIR,
            )
    used = [i for i in range(count) if weights[i] and not moving[i]]
    uses = (one for one in gltf.rows("nodes") if one.get("mesh") == node["mesh"])
    shared = any(one.get("weights") != node.get("weights") for one in uses)
    if not moving.all():
        still = _note(mesh, weights, used, int((~moving).sum()), animated=over_time is not None)
        notes.add(still, f"{where} of node {name}" if shared else where)
    return [
        _primitive(gltf, f"mesh '{where}', primitive {p}", primitive, rows[p], weights, used)
        if rows[p]
        else primitive
        for p, primitive in primitives.items()
    ]


def _primitive(
    gltf: Gltf,
    where: str,
    primitive: Primitive,
    targets: Sequence[dict[str, int]],
    weights: Sequence[float],
    used: Sequence[int],
) -> Primitive:
    """A primitive with the targets `used`."""
    values = {"POSITION": primitive.points} | primitive.attributes
    for key in MORPHED:
        for i in used:
            if key in values and key in targets[i]:
                offset = _offset(gltf, where, primitive, targets[i], i, key)
                values[key] = values[key] + weights[i] * offset
    points: Floats = values.pop("POSITION")
    return replace(primitive, points=points, attributes=values)


def _offset(
    gltf: Gltf, where: str, primitive: Primitive, target: dict[str, int], number: int, key: str
) -> Floats:
    """(V, 3) what a morph target adds to an attribute.  InputError where it does not fit."""
    offset = decoded(gltf, target[key])
    if offset.shape != (len(primitive.points), 3):
        raise InputError(
            f"{gltf.path}: {where}: {key} of morph target {number} has {len(offset)} rows "
            f"of {offset.shape[1]} values for {len(primitive.points)} points",
            REPAIR,
        )
    return offset


def changing_shapes(
    gltf: Gltf, number: int, primitives: dict[int, Primitive], over_time: Floats, where: str
) -> tuple[FileShape, ...]:
    """The morph targets of a mesh whose weights change, for its merged primitives.

    number : of the mesh; primitives : see `morphed`, which finds weights that do not fit;
    over_time : (F, K) weights; where : name of the mesh.
    """
    mesh = gltf.row("meshes", number)
    names = _names(mesh, over_time.shape[1])
    out = []
    for i in np.flatnonzero(np.ptp(over_time, axis=0) > 0.0).tolist():
        offsets: dict[str, list[Floats]] = {key: [] for key in MORPHED}
        for p, primitive in primitives.items():
            targets = mesh["primitives"][p].get("targets", [])
            target = targets[i] if targets else {}
            known = {"POSITION": primitive.points} | primitive.attributes
            for key, rows in offsets.items():
                if key in target and key in known:
                    label = f"mesh '{where}', primitive {p}"
                    rows.append(_offset(gltf, label, primitive, target, i, key))
                else:
                    rows.append(np.zeros((len(primitive.points), 3)))
        points, normals = (np.concatenate(offsets[key]) for key in MORPHED)
        if not points.any():
            continue
        out.append(
            FileShape(
                name=names[i],
                offsets=points,
                normal_offsets=normals if normals.any() else None,
                weights=over_time[:, i],
            )
        )
    return tuple(out)


def _note(
    mesh: dict[str, Any],
    weights: Sequence[float],
    used: Sequence[int],
    still: int,
    *,
    animated: bool,
) -> str:
    """The note on the morph targets `still` whose weights do not change, of which those `used` are
    not 0; animated : whether they have the weights of an animation.
    """
    if not used:
        return f"{counted(still, 'morph target')} of weight 0: left out"
    listed = _names(mesh, len(weights))
    shown = ", ".join(f"{listed[i]} with {weights[i]:.3g}" for i in used[:NAMED])
    others = f" and {len(used) - NAMED} more" if len(used) > NAMED else ""
    if animated:
        return f"is read with the morph targets whose weights do not change: {shown}{others}"
    return f"is read with its morph targets at their default weights: {shown}{others}"


def _names(mesh: dict[str, Any], count: int) -> list[str]:
    """The names of the morph targets of a mesh."""
    extras = mesh.get("extras")  # of any type, as the standard says
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    listed = names if isinstance(names, list) else []
    if len(listed) != count or not all(isinstance(name, str) for name in listed):
        return [f"target {i}" for i in range(count)]
    return listed
