"""One run of the paper's scene: every figure of its tables, frame by frame."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.frames.frame import Frame
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.core.neighbors import slopes
from gf_usd.geometry.skinning import MeshSkin
from gf_usd.physics.per_particle import strains
from gf_usd.physics.total_lagrangian.shape_correction import WIDTH, wls_gradient
from gf_usd.pipeline.prepared import prepare
from tools.paper.drift import drift

WARM = 3  # frames
SAMPLES = Path(__file__).resolve().parents[2] / "samples"


@dataclass(kw_only=True)
class Series:
    """What one run measured; one number a frame in each list."""

    name: str
    seed: int
    drift_mean: list[float] = field(default_factory=list)  # [m]
    drift_max: list[float] = field(default_factory=list)  # [m]
    spread: list[float] = field(default_factory=list)  # of U_yy
    least_U: list[float] = field(default_factory=list)  # smallest U_yy
    sigma: list[float] = field(default_factory=list)  # mean smallest singular value of F
    sigma_least: list[float] = field(default_factory=list)
    min_J: list[float] = field(default_factory=list)
    clamped: list[int] = field(default_factory=list)
    rollbacks: int = 0
    seconds: float = 0.0  # of the solver alone, from frame WARM on: what compiles has compiled
    failed: str = ""  # why it ended early

    @property
    def milliseconds(self) -> float:
        """Of the solver, a frame."""
        return 1e3 * self.seconds / max(1, len(self.spread) - 1 - WARM)

    @property
    def peak(self) -> int:
        """The frame of the largest spread of U_yy: the paper's "peak squash"."""
        return int(np.argmax(self.spread))

    def at_peak(self) -> dict[str, float]:
        """The columns of Table 1."""
        k = self.peak
        return {
            "drift mean": self.drift_mean[k],
            "drift max": self.drift_max[k],
            "spread": self.spread[k],
            "sigma": self.sigma[k],
            "clamped": float(self.clamped[k]),
        }


def vertical_stretch(F: np.ndarray) -> np.ndarray:
    """U_yy (N,) of F = R U: the symmetric stretch along the up axis, Y."""
    C = np.einsum("nba,nbc->nac", F, F)
    w, Q = np.linalg.eigh(C)
    return np.einsum("nk,nk->n", Q[:, 1, :] ** 2, np.sqrt(np.maximum(w, 0.0)))


class Observer:
    """Measures frames of one plan."""

    def __init__(self, plan: Any, *, drift_every: int, wls: bool, resolution: int) -> None:
        self._plan, self._every, self._resolution = plan, drift_every, resolution
        X = plan.particles.X
        self._skin = MeshSkin("paper", plan.points, X)
        self._frames = matrix_from_quaternion(plan.particles.orientation)
        width = WIDTH * plan.particles.radius
        self._gradient = wls_gradient(X, width) if wls else None

    def add(self, series: Series, frame: Frame, *, drift_now: bool = False) -> None:
        """Append a frame's figures; the drift only where it is due, else the last one again."""
        pose = frame.particles
        F = pose.F
        if self._gradient is not None:
            # the unclamped WLS F, which is what the paper reads its strains from
            F = slopes(self._gradient, pose.x)
        U, s = vertical_stretch(F), strains(F)[0][:, 0]
        series.spread.append(float(np.ptp(U)))
        series.least_U.append(float(U.min()))
        series.sigma.append(float(s.mean()))
        series.sigma_least.append(float(s.min()))
        series.min_J.append(float(np.linalg.det(F).min()))
        series.clamped.append(frame.health.clamped)
        series.rollbacks += frame.health.rollbacks
        if drift_now or not series.drift_mean or frame.index % self._every == 0:
            mean, largest = self.measure_drift(frame)
        else:
            mean, largest = series.drift_mean[-1], series.drift_max[-1]
        series.drift_mean.append(mean)
        series.drift_max.append(largest)

    def measure_drift(self, frame: Frame) -> tuple[float, float]:
        """Mean and largest distance [m] of the mesh's vertices to the Gaussians' isosurface."""
        poses = self._skin.poses(frame.particles)
        vertices = np.concatenate([pose.x for pose in poses.values()])
        seen = drift(
            vertices, frame.particles.x, frame.particles.F, self._frames,
            self._plan.particles.spacing, resolution=self._resolution,
        )  # fmt: skip
        return seen.mean, seen.largest


def run(
    material: str,
    seed: int,
    *,
    asset: str = "sphere.usda",
    frames: int | None = None,
    drift_every: int = 0,
    resolution: int = 48,
    name: str = "",
    keep: list[Frame] | None = None,
    **options: Any,
) -> Series:
    """One drop with `--preset paper`; options are those of `gf_usd.bake`.

    drift_every : frames between drift measurements; 0: only at the peak of U_yy (and at rest).
    keep : receives the frames.
    """
    from gf_usd.core.errors import BakeError

    prepared = prepare(
        SAMPLES / asset, material=material, preset=options.pop("preset", "paper"), seed=seed,
        frames=frames, overwrite=True, drop=options.pop("drop", "3r"), **options,
    )  # fmt: skip
    plan = prepared.plan
    wls = plan.settings.wls
    observer = Observer(plan, drift_every=drift_every or 10**9, wls=wls, resolution=resolution)
    series = Series(name=name or material, seed=seed)
    best: Frame | None = None
    solver = prepared.solvers.take(plan.variants[0])
    began, watched = time.process_time(), 0.0
    try:
        for frame in solver.frames():
            start = time.process_time()
            observer.add(series, frame)
            if frame.index == WARM:
                began, watched = start, 0.0
            if series.peak == len(series.spread) - 1:
                best = frame
            if keep is not None:
                keep.append(frame)
            watched += time.process_time() - start
    except BakeError as error:
        series.failed = error.message
    series.seconds = time.process_time() - began - watched
    if best is not None:
        k = series.peak
        series.drift_mean[k], series.drift_max[k] = observer.measure_drift(best)
    return series
