"""Reader of tracked points (such as motion tracking of footage) in a USD file.

Two representations are supported, in the units and local space of their prims:

- BasisCurves: each curve is the trajectory of one point, and its vertices are the positions at
  successive time codes from the stage's startTimeCode.  A vertex primvar `timeCode` overrides the
  time codes.
- Points with time samples: each point is one track; the number of points is constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.stage import Placement, SkippedPrim, open_stage, reading, stage_facts

SAME = 1e-6  # time codes


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """P points at T time codes, in SI and in the world frame of their stage."""

    time_codes: Floats  # (T,) ascending
    time_codes_per_second: float
    x: Floats  # (T, P, 3) [m]; NaN where a point is not tracked
    up: tuple[float, float, float]


def read_tracks(path: Path) -> Tracks | None:
    """The tracks of a file; None where it has neither curves nor animated points.

    Raises InputError for a file that cannot be read, and for arrays of inconsistent lengths.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist", "check the spelling of --target")
    with reading(path):
        stage = open_stage(path)
        facts = stage_facts(stage, path, Notes(), meters_per_unit=None, up_axis=None)
        seen: dict[tuple[int, float], Floats] = {}
        count = 0
        for prim in stage.Traverse():
            if prim.IsA(UsdGeom.BasisCurves):
                rows = _of_curves(prim, path)
            elif prim.IsA(UsdGeom.Points):
                rows = _of_points(prim, path)
            else:
                continue
            for codes, places in rows:
                for code, place in zip(codes, places):
                    seen[count, round(float(code) / SAME) * SAME] = place
                count += 1
    if not seen:
        return None
    codes = sorted({code for _, code in seen})
    index = {code: k for k, code in enumerate(codes)}
    x = np.full((len(codes), count, 3), np.nan)
    for (track, code), place in seen.items():
        x[index[code], track] = place * facts.units.length
    up = facts.up
    return Tracks(
        time_codes=np.array(codes), time_codes_per_second=float(stage.GetTimeCodesPerSecond()),
        x=x, up=(float(up[0]), float(up[1]), float(up[2])),
    )  # fmt: skip


Rows = list[tuple[Floats, Floats]]  # (k,) time codes, (k, 3) positions [stage units] of each track


def _of_curves(prim: Usd.Prim, path: Path) -> Rows:
    curves = UsdGeom.BasisCurves(prim)
    counts = np.asarray(curves.GetCurveVertexCountsAttr().Get() or (), np.int64)
    points = np.asarray(curves.GetPointsAttr().Get() or np.zeros((0, 3)), np.float64)
    if counts.sum() != len(points) or not np.isfinite(points).all():
        raise InputError(
            f"{path}: <{prim.GetPath()}> has {len(points)} points for curves of {counts.sum()}"
            " vertices, or some are not finite",
            "export the tracks again with a curve for each tracked point and a vertex for each "
            "frame",
        )
    world = _placed(prim, Usd.TimeCode.Default(), path).points(points)
    begin = prim.GetStage().GetStartTimeCode()
    stated = UsdGeom.PrimvarsAPI(prim).GetPrimvar("timeCode")
    codes = np.concatenate([begin + np.arange(n) for n in counts]) if len(counts) else np.zeros(0)
    if stated and stated.HasAuthoredValue():
        codes = np.asarray(stated.ComputeFlattened(), np.float64)
    if len(codes) != len(points):
        raise InputError(
            f"{path}: <{prim.GetPath()}> has {len(codes)} values of primvars:timeCode for"
            f" {len(points)} points",
            "author one value for each vertex, with vertex interpolation",
        )
    ends = np.cumsum(counts)
    return [(codes[e - n : e], world[e - n : e]) for n, e in zip(counts, ends)]


def _of_points(prim: Usd.Prim, path: Path) -> Rows:
    attribute = UsdGeom.Points(prim).GetPointsAttr()
    times = attribute.GetTimeSamples()
    if len(times) < 2:
        return []
    places = []
    for code in times:
        time = Usd.TimeCode(code)
        found = np.asarray(attribute.Get(time), np.float64)
        places.append(_placed(prim, time, path).points(found))
    if len({len(one) for one in places}) > 1 or not np.isfinite(np.concatenate(places)).all():
        raise InputError(
            f"{path}: <{prim.GetPath()}> has a changing number of points, or some are not finite",
            "export tracks of the same points in all frames, or curves, which need not cover "
            "all frames",
        )
    x = np.array(places)
    return [(np.array(times), x[:, k]) for k in range(x.shape[1])]


def _placed(prim: Usd.Prim, time: Usd.TimeCode, path: Path) -> Placement:
    try:
        return Placement.of(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim))
    except SkippedPrim as reason:
        raise InputError(
            f"{path}: <{prim.GetPath()}>: {reason}", "export the tracks with another transform"
        ) from reason
