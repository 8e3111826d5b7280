"""Validated values of physics attributes, and the role of a prim in UsdPhysics."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, did_you_mean
from gf_usd.readers.usd.stage import upwards


def authored(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Any:
    """The authored value of an attribute; None where there is none."""
    attribute = prim.GetAttribute(name)
    return attribute.Get(time) if attribute and attribute.HasAuthoredValue() else None


def number(path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float | None:
    """An authored non-negative number; None where none is authored.

    path : the file, for messages.  Raises InputError for any other value.
    """
    value = authored(prim, name, time)
    if value is None:
        return None
    if not isinstance(value, float | int) or not 0.0 <= value < np.inf:
        raise invalid_value(path, prim, name, value, "author a number of 0 or more (0: not stated)")
    return float(value)


def count(path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> int | None:
    """An authored non-negative integer; None where none is authored.  Errors as `number`."""
    value = authored(prim, name, time)
    if value is not None and not (isinstance(value, int) and value >= 0):
        raise invalid_value(path, prim, name, value, "author an integer of 0 or more")
    return value


def flag(path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode) -> bool | None:
    """An authored bool; None where none is authored.  Raises InputError for another type."""
    value = authored(prim, name, time)
    if value is not None and not isinstance(value, bool):
        raise invalid_value(path, prim, name, value, "author it as a bool")
    return value


def word(
    path: Path, prim: Usd.Prim, name: str, time: Usd.TimeCode, known: Collection[str]
) -> str | None:
    """An authored token, one of `known`; None where none is authored.

    Raises InputError for any other, with a similar one in the hint.
    """
    value = authored(prim, name, time)
    if value is None or (isinstance(value, str) and value in known):
        return value
    shown = ", ".join(one for one in known if one)
    guess = did_you_mean(str(value), known)
    raise invalid_value(path, prim, name, value, f"{guess}author one of {shown}")


def vector(
    path: Path,
    prim: Usd.Prim,
    name: str,
    time: Usd.TimeCode,
    *,
    unstated: float | None = None,
) -> Floats | None:
    """An authored finite vector (3,); None where none is authored, or all three are `unstated`.

    Raises InputError for any other value.
    """
    value = authored(prim, name, time)
    if value is None:
        return None
    try:
        made = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        made = np.zeros(0)
    if unstated is not None and made.shape == (3,) and (made == unstated).all():
        return None
    if made.shape != (3,) or not np.isfinite(made).all():
        raise invalid_value(path, prim, name, value, "author three finite numbers")
    return made


def require_constant(path: Path, attribute: Usd.Attribute) -> None:
    """Raise InputError where a mass or a density varies over time.

    path : the file, for messages.
    """
    codes = attribute.GetTimeSamples() if attribute else []
    if len(codes) < 2:
        return
    values = [np.atleast_1d(np.asarray(attribute.Get(code), np.float64)) for code in codes]
    if all(np.array_equal(one, values[0]) for one in values):
        return
    low, high = (float(end(np.concatenate(values))) for end in (np.min, np.max))
    raise InputError(
        f"{path}: <{attribute.GetPrim().GetPath()}>: {attribute.GetName()} has {len(codes)} time"
        f" samples, from {low:g} to {high:g}, but the mass of a body cannot change",
        "author one value; only youngsModulus, poissonsRatio, dampingTime and dynamicFriction "
        "may change",
    )


def invalid_value(path: Path, prim: Usd.Prim, name: str, value: object, hint: str) -> InputError:
    """The error for an invalid value."""
    shown = f"{value:g}" if isinstance(value, float) else repr(value)
    return InputError(f"{path}: <{prim.GetPath()}>: {name} is {shown}", hint)


RIGID_BODY = "PhysicsRigidBodyAPI"
# Of the AOUSD proposal and of Omniverse, which usd-core does not define, with the attributes that
# enable the body and make it kinematic.
SOFT_BODIES = {
    "PhysicsDeformableBodyAPI": ("physics:bodyEnabled", "physics:kinematicEnabled"),
    "OmniPhysicsDeformableBodyAPI": (
        "omniphysics:deformableBodyEnabled",
        "omniphysics:kinematicEnabled",
    ),
}
BODIES = {RIGID_BODY: ("physics:rigidBodyEnabled", "physics:kinematicEnabled"), **SOFT_BODIES}
COLLISION = "PhysicsCollisionAPI"


def apis(prim: Usd.Prim) -> set[str]:
    """Names of the applied API schemas, including those without a definition in this USD."""
    return {*prim.GetAppliedSchemas(), *prim.GetPrimTypeInfo().GetAppliedAPISchemas()}


def switch(prim: Usd.Prim, name: str, time: Usd.TimeCode, *, otherwise: bool) -> bool:
    """The value of a boolean attribute; `otherwise` where it is not authored."""
    attribute = prim.GetAttribute(name)
    value = attribute.Get(time) if attribute else None
    return otherwise if value is None else bool(value)


def body_of(prim: Usd.Prim, time: Usd.TimeCode) -> Usd.Prim | None:
    """The prim or its nearest ancestor that is an enabled rigid or deformable body."""
    for above in upwards(prim):
        for api in apis(above) & BODIES.keys():
            if switch(above, BODIES[api][0], time, otherwise=True):
                return above
    return None


def is_collider(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether the prim itself is an enabled collider."""
    return COLLISION in apis(prim) and switch(
        prim, "physics:collisionEnabled", time, otherwise=True
    )


def role(prim: Usd.Prim, time: Usd.TimeCode) -> str:
    """Role of a prim: "dynamic" or "kinematic" (part of such a body), "static" (a collider without
    a body), or "".
    """
    body = body_of(prim, time)
    if body is None:
        return "static" if is_collider(prim, time) else ""
    follows = any(
        switch(body, BODIES[api][1], time, otherwise=False) for api in apis(body) & BODIES.keys()
    )
    return "kinematic" if follows else "dynamic"


def stands(prim: Usd.Prim, time: Usd.TimeCode, named: Sequence[str]) -> bool:
    """Whether a prim is an obstacle, which follows its animation, and stays an instance.

    named : prim paths of --prim, which are no obstacles.
    """
    if role(prim, time) not in ("static", "kinematic") or str(prim.GetPath()) in named:
        return False
    above = (prim.GetStage().GetPrimAtPath(path) for path in prim.GetPath().GetPrefixes())
    return not any(one.GetAttribute("gaussianFlesh:enabled").Get(time) for one in above)
