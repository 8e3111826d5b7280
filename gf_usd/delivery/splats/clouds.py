"""Sets of Gaussians over all frames, as points of the bodies that move them.

The errors of those of a written file, relative to the bake, are

    e = |x' - x| / r    of a position, r the radius of the body
    c = |S' - S|_F / |S|_F    of a covariance S, |.|_F the Frobenius norm
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.radiance import Y_0, linear_to_srgb, turned
from gf_usd.core.scene import RenderSplats, to_frame
from gf_usd.delivery.motion import BodyMotion
from gf_usd.readers.pictures.splats import SplatMotion

NONE, CAPTURED, ALL, ONLY = "none", "captured", "all", "only"
CHOICES = (CAPTURED, ALL, ONLY, NONE)


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """A set of Gaussians, world, meters."""

    name: str  # prim path
    captured: bool  # False: particles of the bake
    positions: NDArray[np.float64]  # (T, N, 3) [m]
    axes: NDArray[np.float32]  # (T, N, 3, 3) [m] columns, as long as the standard deviations
    opacities: Floats  # (N,) 0..1
    harmonics: Floats  # (N, K, 3) of the first frame, in world axes; color = 1/2 + sum_k h_k Y_k
    srgb: bool  # the color is sRGB-encoded, else linear

    def __len__(self) -> int:
        return len(self.opacities)

    def covariances(self, frame: int) -> NDArray[np.float64]:
        """(N, 3, 3) [m^2] in a frame."""
        A = self.axes[frame].astype(np.float64)
        return A @ A.transpose(0, 2, 1)


def read_clouds(motion: SplatMotion, time_codes: Sequence[float]) -> tuple[Cloud, ...]:
    """Every set of a stage at these time codes.  Raises InputError where one changes its length."""
    if not motion:
        return ()
    first: tuple[RenderSplats, ...] = ()
    rows: list[list[tuple[Floats, NDArray[np.float32]]]] = []
    for found in motion.frames(time_codes):
        first = first or found
        rows.append([(one.positions, np.asarray(one.axes, np.float32)) for one in found])
    made = []
    for number, one in enumerate(first):
        harmonics, srgb = _radiance(one)
        made.append(
            Cloud(
                name=one.name,
                captured=not one.lit,
                positions=np.stack([row[number][0] for row in rows]),
                axes=np.stack([row[number][1] for row in rows]),
                opacities=one.opacities,
                harmonics=harmonics,
                srgb=srgb,
            )
        )
    return tuple(made)


def _radiance(splats: RenderSplats) -> tuple[Floats, bool]:
    """Coefficients in world axes, and whether their sum is sRGB-encoded."""
    light = splats.harmonics
    if light is None:
        # for degree 0 any encoding is allowed: sRGB, which every viewer supports
        base = linear_to_srgb(splats.colors)
        return ((base - 0.5) / Y_0)[:, None], True
    # `frame` turns world directions into the space of the coefficients: its inverse turns these
    U, _, Vt = np.linalg.svd(np.linalg.inv(light.frame))
    return turned(light.coefficients, U @ Vt), light.srgb


def with_splats(
    bodies: Sequence[BodyMotion], names: Sequence[str], clouds: Sequence[Cloud]
) -> tuple[BodyMotion, ...]:
    """Bodies with the Gaussians that move with them, and a body for each set of no other.

    A Gaussian goes to the body under its root prim with the nearest point in the first frame; a
    captured set only where its box meets that of the body, and both move or neither does.  None
    goes to one that is hidden in some frames.

    names : prim paths of the meshes, by the numbers that bodies have.
    """
    made = list(bodies)
    order = sorted(range(len(clouds)), key=lambda number: not clouds[number].captured)
    roots = [{names[i].split("/")[1] for i in body.meshes} for body in made]
    for number in order:
        cloud = clouds[number]
        root = cloud.name.split("/")[1]
        near = [
            i
            for i, body in enumerate(made)
            if not body.shown
            and root in roots[i]
            and (not cloud.captured or _moves_with(body, cloud))
        ]
        if not near:
            made.append(_alone(number, cloud))
            roots.append({root})
            continue
        of = _nearest([made[i].rest for i in near], cloud.positions[0])
        for k, i in enumerate(near):
            mine = np.flatnonzero(of == k)
            if len(mine):
                made[i] = _joined(made[i], number, mine, cloud)
    return tuple(made)


def _moves_with(body: BodyMotion, cloud: Cloud) -> bool:
    """True where their boxes meet at first, and both move or neither does."""
    at = _framed(cloud)
    moves = bool((cloud.positions != cloud.positions[:1]).any())
    return moves == body.moves and bool(
        (at.min(0) <= body.rest.max(0)).all() and (body.rest.min(0) <= at.max(0)).all()
    )


def _framed(cloud: Cloud) -> Floats:
    """Positions in the first frame of the Gaussians that are not outliers."""
    return cloud.positions[0][to_frame(cloud.positions[0], cloud.opacities)]


def _nearest(groups: Sequence[Floats], points: Floats) -> Ints:
    """(N,) the group of points that each point is nearest to."""
    if len(groups) == 1:
        return np.zeros(len(points), int)
    gaps = np.stack([kd_tree(group).query(points)[0] for group in groups])
    return gaps.argmin(axis=0)


def _alone(number: int, cloud: Cloud) -> BodyMotion:
    return BodyMotion(
        meshes=(),
        starts=np.array([0, len(cloud)]),
        frames=cloud.positions,
        radius=hull_radius(_framed(cloud)),
        splats=((number, np.arange(len(cloud))),),
    )


def _joined(body: BodyMotion, number: int, rows: Ints, cloud: Cloud) -> BodyMotion:
    return replace(
        body,
        starts=np.append(body.starts, body.starts[-1] + len(rows)),
        frames=np.concatenate([body.frames, cloud.positions[:, rows]], axis=1),
        splats=(*body.splats, (number, rows)),
    )


def hull_radius(points: Floats) -> float:
    """r = (3 V / 4 pi)^(1/3) [m], V the volume of the convex hull of points (n, 3) [m].

    Half the diagonal of their box where they have no volume.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(np.cbrt(3.0 * ConvexHull(points).volume / (4.0 * np.pi)))
    except QhullError:  # too few, or flat
        return float(np.linalg.norm(np.ptp(points, axis=0))) / 2.0


@dataclass(frozen=True, kw_only=True)
class SplatErrors:
    """Errors of the Gaussians of a file, over all of them and all frames."""

    position: float  # the largest [radii]
    covariance: tuple[float, float, float]  # relative: median, 99 in 100, largest


class Errors:
    """Collects the values of `SplatErrors`, frame by frame."""

    def __init__(self) -> None:
        self._position = 0.0
        self._covariance: list[Floats] = []

    def add(self, off: Floats, radius: float, found: Floats, wanted: Floats) -> None:
        """Differences of positions (n, 3) [m]; covariances (n, 3, 3) [m^2]."""
        far = np.sqrt((off**2).sum(axis=1).max(initial=0.0))
        self._position = max(self._position, float(far) / radius)
        size = np.linalg.norm(wanted, axis=(1, 2))
        gap = np.linalg.norm(found - wanted, axis=(1, 2))
        self._covariance.append(gap / np.where(size > 0.0, size, 1.0))

    @property
    def found(self) -> SplatErrors:
        """Of all that was added."""
        every = np.concatenate(self._covariance)
        middle, most = np.percentile(every, (50.0, 99.0))
        return SplatErrors(
            position=self._position, covariance=(float(middle), float(most), float(every.max()))
        )
