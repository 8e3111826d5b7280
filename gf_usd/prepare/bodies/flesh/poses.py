"""The poses of a character: its bones at the frames, and where these take the surfaces."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.stage import BlendShapes, Skeleton
from gf_usd.prepare.bodies.flesh.animation import surface_points
from gf_usd.prepare.settings import Animation

if TYPE_CHECKING:
    from gf_usd.geometry.flesh.cores import Cores
    from gf_usd.geometry.solid import Solid


@dataclass(frozen=True, kw_only=True)
class Poses:
    """How low an animation takes the surfaces, and where they are in its first frame."""

    lowest: float  # [m] height of the lowest point in all poses, of the surfaces that have any
    still: tuple[str, ...] = ()  # prim paths of surfaces without joint weights next to others
    start: Mapping[str, Floats] = field(default_factory=dict)  # (V, 3) [m] by prim path


def joined_poses(every: Sequence[Poses]) -> Poses:
    """The poses of one or several characters."""
    return Poses(
        lowest=min(one.lowest for one in every),
        still=tuple(path for one in every for path in one.still),
    )


def read_bones(
    asset: Asset,
    solid: Solid,
    X: Floats,
    samples: SurfaceSamples,
    animation: Animation,
    file: Path,
    times: Sequence[float],
    *,
    radius: float,
    cell: float,
    spacing: float,
) -> tuple[Skeleton, Cores | None, Poses, tuple[str, ...]]:
    """The bones at some time codes: of the skeleton, or pieces of a body without one, whose cores
    are found with them.  The cores, else None; the poses; notes.
    """
    from gf_usd.geometry.flesh.medial import medial_skeleton
    from gf_usd.readers.usd.skeleton.bones import read_skeleton
    from gf_usd.readers.usd_bake.caches import read_cache

    paths = [s.path for s in asset.surfaces]
    when = {"first": animation.first, "times": times}
    if not animation.cached:
        loose = surface_points(asset) if animation.nearest else None
        skeleton = read_skeleton(file, paths, asset.facts, **when, loose=loose)
        start = int(np.searchsorted(times, animation.first))
        return skeleton, None, skinned_poses(asset, skeleton, start), ()
    lows: list[float] = []
    poses = _with_lows(read_cache(file, paths, asset.facts, **when), asset.facts.up, lows)
    skeleton, cores = medial_skeleton(
        solid, X, samples, poses,
        share=radius, cell=cell, spacing=spacing, where=str(asset.facts.path),
    )  # fmt: skip
    note = (
        f"it has no skeleton: {len(skeleton.bones)} pieces along its medial axis follow its"
        f" animated points as bones"
    )
    return skeleton, cores, Poses(lowest=min(lows)), (note,)


def changing_shapes(
    asset: Asset, animation: Animation, file: Path, times: Floats, frame_rows: Ints
) -> dict[str, BlendShapes]:
    """The blend shapes of the surfaces whose weights change, by prim path.

    times : different time codes of the animation; frame_rows : of each frame, in `times`.
    """
    from gf_usd.readers.usd.skeleton.blend_shapes import read_blend_shapes

    if animation.cached:
        return {}
    paths = [s.path for s in asset.surfaces if s.splats is None]
    when = {"first": animation.first, "times": times.tolist()}
    found = read_blend_shapes(file, paths, asset.facts, **when)
    return {p: replace(one, weights=one.weights[frame_rows]) for p, one in found.items()}


def _with_lows(
    poses: Iterable[dict[str, Floats]], up: Floats, lows: list[float]
) -> Iterator[dict[str, Floats]]:
    """The poses; the height [m] of the lowest point of each is appended to `lows`."""
    for pose in poses:
        lows.append(min(float((points @ up).min()) for points in pose.values()))
        yield pose


def skinned_poses(asset: Asset, skeleton: Skeleton, first: int) -> Poses:
    """The poses of the surfaces that have weights; first : row of the animation's first frame."""
    from gf_usd.geometry.flesh.linear_blend import bone_transforms, skinned

    linear, offset = bone_transforms(skeleton)
    # The height alone takes a third of the time of all three coordinates.
    slopes, heights = asset.facts.up @ linear, offset @ asset.facts.up
    least, start = np.inf, {}
    for surface in asset.surfaces:
        if surface.path not in skeleton.weights:
            continue
        weights, X = skeleton.weights[surface.path], surface.points
        for slope, height in zip(slopes, heights, strict=True):
            low = skinned(weights, slope[:, None], height[:, None], X).min(initial=np.inf)
            least = min(least, float(low))
        start[surface.path] = skinned(weights, linear[first], offset[first], X)
    still = tuple(s.path for s in asset.surfaces if s.path not in skeleton.weights)
    return Poses(lowest=least, still=still, start=start)
