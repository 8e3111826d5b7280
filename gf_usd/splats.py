"""Captured Gaussians: what every splat file means, in one value.

    alpha(x) = o exp(-(x - p)^T Sigma^-1 (x - p) / 2),    Sigma = R diag(s^2) R^T
    c(d) = 1/2 + sum_k h_k Y_k(d)

with d the direction from the camera to the Gaussian in its own space.  Files differ in how they
store the numbers (logarithms, logits, bytes); here opacities lie in 0..1, scales are linear
standard deviations, quaternions are (w, x, y, z), and the coefficients are those of UsdVol: raw
f_dc first, then f_rest with degree 1, 2, 3 in order, each coefficient with its three colours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gf_usd.errors import InputError
from gf_usd.harmonics import DEGREE, Y_0
from gf_usd.model import Floats, Ints
from gf_usd.scene import gaussian_axes

LARGEST = 1e31  # of any number: single precision still holds a box around it
BRIGHTEST = 1e4  # a coefficient is held to this: turned ones are written in half precision


@dataclass(frozen=True, kw_only=True)
class Splats:
    """A set of Gaussians in a space of their own, and where that space is."""

    positions: Floats  # (N, 3) [local units]
    orientations: Floats  # (N, 4) unit, (w, x, y, z)
    scales: Floats  # (N, 3) [local units] standard deviations along the axes of R
    opacities: Floats  # (N,) 0..1
    harmonics: Floats  # (N, (degree + 1)^2, 3)
    path: str = ""  # prim path; "" for what comes from no stage
    to_world: Floats = field(default_factory=lambda: np.eye(4))  # (4, 4) x_world [m] = x M
    half: bool = False  # the coefficients are authored in half precision only
    anchors: Floats | None = None  # (N, 3) [m] the points of the body that carry them, world
    labels: Mapping[str, Ints] = field(default_factory=dict)  # (N,) of each whole-number property

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.harmonics.shape[1] ** 0.5) - 1

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) [m] centres, world."""
        return np.asarray(self.positions, float) @ self.to_world[:3, :3] + self.to_world[3, :3]

    @cached_property
    def axes(self) -> NDArray[np.float64]:
        """(N, 3, 3) [m] A with Sigma = A A^T, world: its columns are the scaled axes."""
        return self.to_world[:3, :3].T @ gaussian_axes(self.orientations, self.scales)

    @property
    def riding(self) -> Floats:
        """(N, 3) [m] the points that ride on the body: the centres, or what carries them."""
        return self.points if self.anchors is None else self.anchors

    @property
    def colours(self) -> NDArray[np.float64]:
        """(N, 3) of degree 0, encoded as the capture is: sRGB in practice."""
        return np.clip(0.5 + Y_0 * np.asarray(self.harmonics[:, 0], float), 0.0, 1.0)

    @property
    def frame_bytes(self) -> int:
        """Of one frame in the cache: positions, orientations, scales, and halves for radiance."""
        halves = 6 * self.harmonics.shape[1] if self.degree else 0
        return len(self) * (12 + 16 + 12 + halves)

    def take(self, rows: Ints) -> Splats:
        """Some of them, in the given order."""
        return Splats(
            positions=self.positions[rows],
            orientations=self.orientations[rows],
            scales=self.scales[rows],
            opacities=self.opacities[rows],
            harmonics=self.harmonics[rows],
            path=self.path,
            to_world=self.to_world,
            half=self.half,
            labels={name: values[rows] for name, values in self.labels.items()},
        )


@dataclass(frozen=True, kw_only=True)
class SplatPose:
    """Captured Gaussians at one time; all but the positions in the space of their prim."""

    positions: Floats  # (N, 3) [m] world
    orientations: Floats  # (N, 4) unit, continuous in time
    scales: Floats  # (N, 3) [local units] standard deviations
    harmonics: Floats | None = None  # (N, K, 3) turned; None where the degree is 0


def tidy(splats: Splats, where: str, note: Callable[[str], None]) -> Splats:
    """The Gaussians that can be what was meant: finite, of some size, with unit quaternions.

    `note` gets what was changed, in words.  Raises InputError where none is left.
    """
    norm = np.linalg.norm(np.asarray(splats.orientations, float), axis=1)
    finite = np.isfinite(norm) & np.isfinite(splats.opacities)
    for values in (splats.positions, splats.scales, splats.harmonics):
        held = np.abs(np.asarray(values, float)) <= LARGEST  # and is a number
        finite &= held.all(axis=tuple(range(1, np.ndim(values))))
    sized = (np.asarray(splats.scales) >= np.finfo(np.float32).tiny).all(axis=1)
    lost, flat = int((~finite).sum()), int((finite & ~sized).sum())
    if lost:
        note(f"{lost} of {len(splats)} Gaussians are not finite: left out")
    if flat:
        note(f"{flat} of {len(splats)} Gaussians have a scale of 0 or less: left out")
    keep = finite & sized
    if not keep.any():
        raise InputError(
            f"{where}: none of its {len(splats)} Gaussians is finite and has a size",
            "export it again, with at least one Gaussian",
        )
    turned = int((keep & (norm == 0.0)).sum())
    if turned:
        note(f"{turned} Gaussians have a quaternion of length 0: no rotation is assumed")
    length = np.where(norm > 0.0, norm, 1.0)[:, None]
    unit = np.where(norm[:, None] > 0.0, splats.orientations / length, (1.0, 0.0, 0.0, 0.0))
    beyond = keep & ((splats.opacities < 0.0) | (splats.opacities > 1.0))
    if beyond.any():
        note(f"{int(beyond.sum())} opacities lie outside 0..1: clipped")
    count = splats.harmonics.shape[1]
    most = (DEGREE + 1) ** 2
    if count > most:
        note(f"spherical harmonics above degree {DEGREE} are left out")
    harmonics = splats.harmonics[:, :most]
    bright = keep[:, None, None] & (np.abs(harmonics) > BRIGHTEST)
    if bright.any():
        many = int(bright.sum())
        note(f"{many} spherical harmonics coefficients are beyond {BRIGHTEST:g}: clipped")
        harmonics = np.clip(harmonics, -BRIGHTEST, BRIGHTEST)
    sound = Splats(
        positions=splats.positions,
        orientations=unit,
        scales=splats.scales,
        opacities=np.clip(splats.opacities, 0.0, 1.0),
        harmonics=harmonics,
        path=splats.path,
        to_world=splats.to_world,
        half=splats.half,
        labels=splats.labels,
    )
    return sound if keep.all() else sound.take(np.flatnonzero(keep))


def joined(sets: Sequence[Splats]) -> Splats:
    """Several sets in one space as one; of different degrees, the lower are filled with zeros."""
    most = max(s.harmonics.shape[1] for s in sets)
    padded = [np.pad(s.harmonics, ((0, 0), (0, most - s.harmonics.shape[1]), (0, 0))) for s in sets]
    return Splats(
        positions=np.concatenate([s.positions for s in sets]),
        orientations=np.concatenate([s.orientations for s in sets]),
        scales=np.concatenate([s.scales for s in sets]),
        opacities=np.concatenate([s.opacities for s in sets]),
        harmonics=np.concatenate(padded),
    )
