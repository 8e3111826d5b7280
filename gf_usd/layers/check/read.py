"""Reads a stage for the rules: one sample at a time, without assumptions about types.

Any file may be checked, so an attribute with a well-known name need not have the expected type: the
readers here return ``None`` then.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdVol

T = TypeVar("T")
Array = NDArray[Any]


def prims(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Every active prim that is no class, including overs; a prototype through its first instance
    only.

    Overs count because a cache layer that is opened by itself consists of overs.
    """
    predicate = Usd.TraverseInstanceProxies(Usd.PrimIsActive & ~Usd.PrimIsAbstract)
    seen: set[Sdf.Path] = set()
    walk = iter(Usd.PrimRange.Stage(stage, predicate))
    for prim in walk:
        if prim.IsInstance():
            prototype = prim.GetPrototype().GetPath()
            if prototype in seen:
                walk.PruneChildren()
            seen.add(prototype)
        yield prim


def authored(prim: Usd.Prim, *names: str) -> Usd.Attribute | None:
    """The first of these attributes that has a value of its own."""
    for name in names:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            return attribute
    return None


def position_attribute(prim: Usd.Prim) -> Usd.Attribute | None:
    """The attribute with the points of a particle field or a point-based prim.

    A prim without a type may be an over on a mesh, so its points count; the positions of a
    PointInstancer place whole prims and do not.
    """
    if prim.IsA(UsdVol.ParticleField):
        return authored(prim, "positions", "positionsh")
    if prim.IsA(UsdGeom.PointBased) or not prim.GetTypeName():
        return authored(prim, "points")
    return None


def applied_names(prim: Usd.Prim) -> list[str]:
    """The names in apiSchemas as authored, including those that are not registered in USD."""
    listed = prim.GetMetadata("apiSchemas")
    return [str(name) for name in listed.GetAppliedItems()] if listed else []


def times(*attributes: Usd.Attribute | None) -> list[Usd.TimeCode]:
    """When any of these attributes has a value: Default where one has, then every sample time."""
    present = [a for a in attributes if a is not None]
    codes = sorted({t for a in present for t in a.GetTimeSamples()})
    default = [Usd.TimeCode.Default()] if any(_shows_default(a) for a in present) else []
    return default + [Usd.TimeCode(t) for t in codes]


def _shows_default(attribute: Usd.Attribute) -> bool:
    """Whether an attribute has a default that belongs to its samples.

    The default of normals with value clips is that of the source, whose indices may be blocked: a
    default in the layer that has the clips would hide them.
    """
    default = Usd.TimeCode.Default()
    if not attribute.HasAuthoredValue() or attribute.Get(default) is None:
        return False
    if attribute.GetName() not in ("normals", "primvars:normals"):
        return True
    codes = attribute.GetTimeSamples()
    source = attribute.GetResolveInfo(codes[0]).GetSource() if codes else None
    return source != Usd.ResolveInfoSourceValueClips


def numbers(attribute: Usd.Attribute | None, time: Usd.TimeCode) -> Array | None:
    """The value as an array of numbers, halves widened; None for other values."""
    return None if attribute is None else array_of(attribute.Get(time))


def array_of(value: Any) -> Array | None:
    """What an attribute returned as an array of numbers, as `numbers` does."""
    if value is None:
        return None
    if hasattr(value, "GetImaginary"):
        value = (*value.GetImaginary(), value.GetReal())
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        return None
    return array.astype(np.float32) if array.dtype == np.float16 else array


def vectors(attribute: Usd.Attribute | None, time: Usd.TimeCode) -> Array | None:
    """The value as (N, 3) numbers; None where it has another shape."""
    return None if attribute is None else vectors_of(attribute.Get(time))


def vectors_of(value: Any) -> Array | None:
    """What an attribute returned as (N, 3) numbers, as `vectors` does."""
    array = array_of(value)
    if array is None or array.ndim != 2 or array.shape[1] != 3:
        return None
    return array


def samples(attribute: Usd.Attribute | None) -> Iterator[tuple[Usd.TimeCode, Array]]:
    """Every value of an attribute with its time, one at a time."""
    if attribute is None:
        return
    value_at = Usd.AttributeQuery(attribute).Get  # in half the time
    for time in times(attribute):
        array = array_of(value_at(time))
        if array is not None:
            yield time, array


class Track(Generic[T]):
    """A property of every sample of an attribute, with USD's interpolation of held values.

    Arrays of different lengths are not interpolated: the value at a time is that of the previous
    sample, or of the first one where there is none.
    """

    def __init__(self, attribute: Usd.Attribute | None, fact: Callable[[Array], T]) -> None:
        self.default: T | None = None
        self.codes: list[float] = []
        self.facts: list[T] = []
        for time, array in samples(attribute):
            if time.IsDefault():
                self.default = fact(array)
            else:
                self.codes.append(time.GetValue())
                self.facts.append(fact(array))

    def __bool__(self) -> bool:
        """Whether there is any value."""
        return self.default is not None or bool(self.codes)

    def at(self, time: Usd.TimeCode) -> T | None:
        """The fact at a time; None where the attribute has no value there."""
        if time.IsDefault() or not self.codes:
            return self.default
        return self.facts[max(bisect_right(self.codes, time.GetValue()) - 1, 0)]


def lengths(attribute: Usd.Attribute | None) -> Track[int]:
    """How many elements each sample has."""
    return Track(attribute, lambda array: array.shape[0] if array.ndim else 1)


def joint_times(*tracks: Track) -> list[Usd.TimeCode]:
    """When any of these tracks has a value: Default first."""
    default = any(track.default is not None for track in tracks)
    codes = sorted({code for track in tracks for code in track.codes})
    return ([Usd.TimeCode.Default()] if default else []) + [Usd.TimeCode(c) for c in codes]
