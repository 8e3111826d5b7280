"""Morph targets of a glTF file, at the weights that its viewers show without an animation.

glTF 2.0, 3.7.2.2: an attribute is at base + sum_i w_i target_i, before skinning.  The weights w_i
are those of the node, else those of its mesh, else 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, counted
from gf_usd.readers.mesh.data import REPAIR
from gf_usd.readers.mesh.gltf.container import Gltf
from gf_usd.readers.mesh.gltf.primitives import Primitive, decoded
from gf_usd.readers.notes import Notes

MORPHED = ("POSITION", "NORMAL")  # other attributes keep their base values
NAMED = 4  # targets that a note lists


def morphed(
    gltf: Gltf,
    node: dict[str, Any],
    primitives: dict[int, Primitive],
    notes: Notes,
    where: str,
    name: str,
) -> list[Primitive]:
    """The primitives of the mesh of a node with its morph targets applied.

    primitives : of the mesh, by their index in it; where, name : of the mesh and the node, for
    notes.

    Raises InputError for weights and targets that do not fit the mesh.
    """
    mesh = gltf.row("meshes", node["mesh"])
    rows = {p: mesh["primitives"][p].get("targets", []) for p in primitives}
    count = max(map(len, rows.values()), default=0)
    if not count:
        return list(primitives.values())
    weights = node.get("weights") or mesh.get("weights") or [0.0] * count
    for p, targets in rows.items():  # a primitive without targets is the same at all weights
        if targets and not len(weights) == len(targets) == count:
            raise InputError(
                f"{gltf.path}: mesh '{where}' has {counted(len(weights), 'weight')} for the "
                f"{counted(len(targets), 'morph target')} of its primitive {p}",
                REPAIR,
            )
    used = [i for i in range(count) if weights[i]]
    uses = (one for one in gltf.rows("nodes") if one.get("mesh") == node["mesh"])
    shared = any(one.get("weights") != node.get("weights") for one in uses)
    notes.add(_note(mesh, weights, used), f"{where} of node {name}" if shared else where)
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
                offset = decoded(gltf, targets[i][key])
                if offset.shape != values[key].shape:
                    raise InputError(
                        f"{gltf.path}: {where}: {key} of morph target {i} has {len(offset)} rows "
                        f"of {offset.shape[1]} values for {len(primitive.points)} points",
                        REPAIR,
                    )
                values[key] = values[key] + weights[i] * offset
    points: Floats = values.pop("POSITION")
    return replace(primitive, points=points, attributes=values)


def _note(mesh: dict[str, Any], weights: Sequence[float], used: Sequence[int]) -> str:
    if not used:
        return f"{counted(len(weights), 'morph target')} of weight 0: left out"
    extras = mesh.get("extras")  # of any type, as the standard says
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    listed = names if isinstance(names, list) else []
    if len(listed) != len(weights) or not all(isinstance(name, str) for name in listed):
        listed = [f"target {i}" for i in range(len(weights))]
    shown = ", ".join(f"{listed[i]} with {weights[i]:.3g}" for i in used[:NAMED])
    others = f" and {len(used) - NAMED} more" if len(used) > NAMED else ""
    return f"is read with its morph targets at their default weights: {shown}{others}"
