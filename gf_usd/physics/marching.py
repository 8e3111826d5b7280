"""Frame by frame, each believed only once the guard has seen it: what every solver shares.

A solver is a state, a way to move it by so many substeps, and a way to read a `Frame` off it.  This
file turns the three into frames: it chooses the number of substeps, rolls a frame that failed back
and redoes it with half the step, and ends in words where that does not help.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gf_usd.errors import SolverError
from gf_usd.model import Floats, Frame, Health, Particles, Settings
from gf_usd.physics.guard import RETRIES, Guard


@dataclass(frozen=True, kw_only=True)
class Passage:
    """What was noticed between two frames, on the substeps, under the names of `Health`."""

    penetration: float = 0.0  # [m] deepest of a contact sample in the floor
    overlap: float = 0.0  # [m] deepest of a contact sample in another body or an obstacle
    let_go: int = 0  # contact samples at once that seemed deeper than they can have come
    friction_capped: int = 0
    work: float = 0.0  # [J] done on the body by what holds it
    injected: float = 0.0  # [J] given to the body between substeps: see `reanchor`
    clamped: int = 0  # particles whose singular values of F were clipped
    stress_capped: int = 0  # particles whose stress was cut
    flying: int = 0  # bodies that flew by the closed form: there were no substeps
    sleeping: int = 0  # bodies that slept: there were no substeps


class Marcher(ABC):
    """The protocol of a solver: construct it, then iterate `frames()`.

    What makes one: `particles`, `settings`, `guard`, `coarse` (substeps a frame of the stable step
    at rest), `strained` (those that the body as it is now asks for), `time` [s], and the abstract
    methods below.
    """

    particles: Particles
    settings: Settings
    guard: Guard
    coarse: int
    strained: int = 1
    time: float

    @abstractmethod
    def save(self) -> dict[str, Any]:
        """The whole state as arrays and numbers, from which `restore` goes on to the bit."""

    @abstractmethod
    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what `save` returned."""

    @abstractmethod
    def advance(self, index: int, substeps: int) -> Passage:
        """Move to frame `index` in so many substeps."""

    @abstractmethod
    def not_finite(self) -> tuple[int, str]:
        """The particle nearest to what is no number, and the fault; (-1, "") where all is sound."""

    @abstractmethod
    def read(self, index: int) -> Frame:
        """The frame of the present state; its health lacks what only the passage knows."""

    @property
    def frame_time(self) -> float:
        """[s] of simulated time between frames."""
        return self.settings.time_scale / self.settings.fps

    @property
    def substeps(self) -> int:
        """Substeps of the next frame."""
        return max(self.coarse, self.strained) << self.guard.halvings

    @property
    def dt(self) -> float:
        """[s] length of the next frame's substeps."""
        return self.frame_time / self.substeps

    def frames(self) -> Iterator[Frame]:
        """Yield `settings.frames` frames, the first at rest where the body was put.

        Raises SolverError where a frame cannot be had; those before it were sound.
        """
        frame = self.read(0)
        yield frame
        yield from self.frames_after(0, frame.health)

    def frames_after(self, index: int, last: Health) -> Iterator[Frame]:
        """Yield the frames after `index`, at which the state stands and whose health was `last`.

        Raises SolverError as `frames` does.
        """
        for following in range(index + 1, self.settings.frames):
            frame = self.next(following, last)
            last = frame.health
            yield frame

    def standing(self) -> dict[str, Any]:
        """Between two frames, all that another solver of the same body needs to go on alike."""
        guard = {f"guard_{name}": value for name, value in self.guard.state().items()}
        return {**self.save(), **guard, "strained": self.strained}

    def stand(self, standing: Mapping[str, Any]) -> None:
        """Go on from `standing`, to the bit."""
        self.restore(dict(standing))
        known = self.guard.state()
        self.guard.recall({name: float(standing[f"guard_{name}"]) for name in known})
        self.strained = int(standing["strained"])

    def _hint(self) -> str:
        """What a person may do about a frame that cannot be had."""
        if self.settings.substeps:
            return "this preset gives every frame the same few substeps: leave --preset out"
        return "lower the impact (--drop), use a stiffer material or --law neoHookean"

    def next(self, index: int, last: Health) -> Frame:
        """Move by a frame; where it fails, roll back and redo it with half the step."""
        saved = self.save()
        for attempt in range(RETRIES + 1):
            substeps = self.substeps
            passage = self.advance(index, substeps)
            particle, fault = self.not_finite()
            if not fault:
                frame = self.read(index)
                done = 0 if passage.flying or passage.sleeping else substeps
                health = replace(frame.health, substeps=done, rollbacks=attempt, **vars(passage))
                particle, fault = self.guard.judge(last, health, frame.particles)
                if not fault:
                    self.guard.passed()
                    return replace(frame, health=health)
            if attempt == RETRIES:
                break
            self.restore(saved)
            self.guard.refine()
        raise SolverError(
            f"frame {index}: {fault}, with {self.coarse} substeps and still after {RETRIES}"
            f" halvings of the step to {self.dt:.3g} s",
            self._hint() + "; the frames before it are in the partial cache",
            frame=index,
            particle=particle,
        )


def first_bad(values: Floats) -> int:
    """Index of the first row that holds something that is no number; -1 where none does."""
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(1)
    return int(np.argmax(bad)) if bad.any() else -1
