"""The frame loop that all solvers share, and the guard that checks every frame.

A solver has a state, a method that advances it by a number of substeps, and a method that reads a
`Frame` from it.  This module chooses the number of substeps, rolls back a frame that the guard
rejects and repeats it with half the step, and raises an error where that does not help.

The step limit of `time_step` holds for the body at rest.  A material that is compressed to a tenth
of its volume is many times stiffer, and a step that is too long for it shows as an energy gain: a
body under gravity, floor contact and damping can only lose energy, up to the integrator's error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners
from gf_usd.core.errors import SolverError, counted
from gf_usd.core.frames.frame import Frame, Health, Pose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.units import length_text
from gf_usd.physics.contact.floor import FloorContact, pressed_step
from gf_usd.physics.contact.planes.intervals import Lateness
from gf_usd.physics.taichi_arrays import Saved
from gf_usd.physics.time_step import StableStep


@dataclass(frozen=True, kw_only=True)
class FrameStats:
    """Statistics of the substeps between two frames, named as in `Health`."""

    penetration: float = 0.0  # [m] deepest of a contact sample in the floor
    overlap: float = 0.0  # [m] deepest contact sample in a body or obstacle
    overlap_pair: str | None = None  # text on the body and what it was in; None: not known
    overlap_names: tuple[str, str] | None = None  # the two, in this order
    let_go: int = 0  # largest number of contact samples released at the same time
    friction_capped: int = 0
    work: float = 0.0  # [J] work of pins and goals on the body
    injected: float = 0.0  # [J] given to the body between substeps: see `shape_correction`
    planes: float = 0.0  # [J] of it, by new contact planes
    clamped: int = 0  # particles whose singular values of F were clipped
    stress_capped: int = 0  # particles whose stress was cut
    flying: int = 0  # bodies in free flight by the closed form, without substeps
    sleeping: int = 0  # sleeping bodies, without substeps
    plastic_dissipation: float | None = None  # [J] dissipated by flow; None: no law flows
    conversion_dissipation: float | None = None  # [J] of it, by conversion; None: there is none
    settling_dissipation: float | None = None  # [J] of `settling`; None: it is not active
    substeps: int | None = None  # None: as many as requested

    @property
    def rested(self) -> bool:
        """Whether the frame had no substeps."""
        return self.flying + self.sleeping > 0


class HasTimeStep(Protocol):
    """The values that determine the time step of a body."""

    @property
    def contact(self) -> FloorContact | None: ...

    @property
    def step(self) -> StableStep: ...


class Solver(ABC):
    """The protocol of a solver: construct it, then iterate over `frames()`.

    A solver has `particles`, `settings`, `body`, `guard`, `coarse` (substeps per frame for the
    stable step at rest), `strained` (substeps required by the current strain), `state`, and the
    abstract methods below.  `on_launch` is called after kernel launches, several times in a long
    frame; it may raise an exception to end the simulation within a frame.
    """

    particles: Particles
    settings: Settings
    body: HasTimeStep
    guard: Guard
    coarse: int
    strained: int = 1
    state: Saved
    on_launch: Callable[[], None] | None = None
    takes_forces = False  # whether it implements `push`

    @property
    def lateness(self) -> Lateness | None:
        """Whether contact was detected too late in the last attempt at a frame; None without it."""
        return None

    @property
    def in_place(self) -> bool:
        """Whether pins or goals prescribe the position of the body, so that it does not fall."""
        return False

    @abstractmethod
    def advance(self, index: int, substeps: int) -> FrameStats:
        """Advance to frame `index` in this number of substeps."""

    @abstractmethod
    def not_finite(self) -> tuple[int, str]:
        """The particle nearest to a value that is not finite, and the error; (-1, "") where there
        is none.
        """

    @abstractmethod
    def read(self, index: int) -> Frame:
        """The frame of the current state; its health lacks the values of `FrameStats`."""

    @abstractmethod
    def places(self) -> Floats:
        """(n, 3) [m] points whose velocities `throw` sets: free nodes, and particles that flow."""

    @abstractmethod
    def throw(self, velocities: Floats) -> None:
        """Set the velocities (n, 3) [m/s] at `places`."""

    @property
    def frame_time(self) -> float:
        """[s] of simulated time between frames."""
        return self.settings.frame_time

    def pressed(self, depth: float) -> int:
        """Substeps per frame that the floor's contact springs require at a penetration depth
        [m].
        """
        if self.settings.substeps:
            return 1
        step = pressed_step(self.body.contact, self.body.step, depth)
        return int(np.ceil(self.frame_time / step.dt))

    def required_substeps(self, strained: int, depth: float) -> int:
        """Substeps per frame for this strain, and this penetration depth [m] into the floor."""
        pressed = self.pressed(depth)
        return max(strained, pressed) if pressed > self.coarse else strained

    @property
    def substeps(self) -> int:
        """Substeps of the next frame."""
        return max(self.coarse, self.strained) << self.guard.halvings

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of the stiffest vibration of the grid at rest, by the material's
        damping.
        """
        return 0.5 * self.body.step.viscous_time * self.body.step.elastic

    @property
    def contact_factor(self) -> float:
        """Substeps at rest with contact springs, relative to those without."""
        return self.body.step.contact_factor

    @property
    def dt(self) -> float:
        """[s] length of the next frame's substeps."""
        return self.frame_time / self.substeps

    def frames(self) -> Iterator[Frame]:
        """Yield `settings.frames` frames, the first of which is the initial state.

        Raises SolverError where a frame fails; the frames before it are valid.
        """
        frame = self.read(0)
        yield frame
        yield from self.frames_after(0, frame.health)

    def frames_after(self, index: int, last: Health) -> Iterator[Frame]:
        """Yield the frames after `index`, which is the current state and whose health was `last`.

        Raises SolverError as `frames` does.
        """
        for following in range(index + 1, self.settings.frames):
            frame = self.next(following, last)
            last = frame.health
            yield frame

    def save(self) -> dict[str, Any]:
        """Everything that another solver of the same body needs to continue after this frame."""
        guard = {f"guard_{name}": value for name, value in self.guard.save().items()}
        return {**self.state.save(), **guard, "strained": self.strained}

    def load(self, saved: Mapping[str, Any]) -> None:
        """Restore the result of `save`; the continuation is bit-identical."""
        self.state.load(saved)
        known = self.guard.save()
        self.guard.load({name: float(saved[f"guard_{name}"]) for name in known})
        self.strained = int(saved["strained"])

    def _hint(self) -> str:
        """How to avoid the failure of a frame."""
        if self.settings.substeps:
            return "this preset uses the same few substeps for every frame: leave out --preset"
        gentler = "slow down what moves it" if self.in_place else "lower the impact (--drop)"
        return f"{gentler}, use a stiffer material or, if it is corotated, --law neoHookean"

    def next(self, index: int, last: Health) -> Frame:
        """Advance by a frame; if it fails, roll back and repeat it with half the step.

        If the floor's contact springs were compressed further than the step allows, it is repeated
        with their step; and where contact was detected too late, with sooner detections.
        """
        saved, late = self.state.save(), self.lateness
        if late is not None:
            late.renew()  # also after an attempt that ended with an exception
        for attempt in range(RETRIES + 1):
            substeps = self.substeps
            stats = self.advance(index, substeps)
            particle, fault = self.not_finite()
            # how deep and how far bodies go within a frame is only known at its end
            while not (fault or stats.rested):
                required = self.pressed(stats.penetration) << self.guard.halvings
                if required <= substeps and not (late and late.repeat()):
                    break
                self.state.load(saved)
                substeps = max(required, substeps)
                stats = self.advance(index, substeps)
                particle, fault = self.not_finite()
            if not fault:
                frame = self.read(index)
                done = 0 if stats.rested else substeps
                seen = {name: value for name, value in vars(stats).items() if value is not None}
                if (frame.health.pierced or 0.0) > stats.overlap:
                    seen["overlap"] = frame.health.pierced
                    seen["overlap_pair"] = frame.health.pierced_pair
                    seen["overlap_names"] = None
                health = replace(
                    frame.health, **{"substeps": done, "rollbacks": attempt, **seen}
                )  # fmt: skip
                particle, fault = self.guard.judge(last, health, frame.particles)
                if not fault:
                    self.guard.passed()
                    return replace(frame, health=health)
            if attempt == RETRIES:
                break
            self.state.load(saved)
            # A state that blew up may require any number of substeps by its strain.
            self.strained = min(self.strained, GROWTH * (substeps >> self.guard.halvings))
            self.guard.refine()
        raise SolverError(
            f"frame {index}: {fault}, with {counted(self.coarse, 'substep')}, and still after"
            f" {RETRIES} halvings of the step to {self.dt:.3g} s",
            self._hint() + "; the frames before it are in the partial cache",
            frame=index,
            particle=particle,
        )


def first_not_finite(values: Floats) -> int:
    """Index of the first row with a value that is not finite; -1 where there is none."""
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(1)
    return int(np.argmax(bad)) if bad.any() else -1


RETRIES = 6  # halvings of the step before giving up
GROWTH = 2  # times the substeps of a failed frame that its strain may require of the next attempt
CALM_FRAMES = 4  # accepted frames before a halved step is doubled again
# Position Verlet conserves a shadow energy; the energy itself oscillates by up to (w dt)^2 / 4 of
# that of the stiffest vibrations.  In correct bakes with all presets no frame gained 1e-4 of the
# scale below (measured), and an unstable one gains many times it.
GAIN = 0.02
# Only a body of which a piece has separated extends over this many radii.
ESCAPE = 100.0


class Guard:
    """Checks frames and stores the number of halvings of the step.

    scale : [J] an energy of the body, m g0 r, relative to which gains are small.
    reach : [m] extent of the body at rest; a particle a hundred times as far away has escaped.
    body : (N,) the body of each particle; None: a single body.
    """

    def __init__(self, scale: float, reach: float, body: Ints | None = None) -> None:
        self._scale, self._reach, self._body = scale, reach, body
        self._calm = 0
        # inverted particles that a shorter step did not prevent: caused by the law, not the step
        self._inverted = 0
        self._tried = -1  # inverted particles before the last refinement; -1: it had another reason
        self.halvings = 0

    def judge(self, last: Health, now: Health, particles: Pose) -> tuple[int, str]:
        """The particle and the error of a frame, as text; (-1, "") where the frame is valid."""
        before, after = last.energy, now.energy
        self._scale = max(self._scale, last.kinetic + last.elastic)
        gain = after - before - now.work - now.injected + now.dissipation
        # For a body at rest that a pin sets in motion, the work of the frame is the only scale.
        # The gain of an unstable step is quadratic in its forces, in which work is linear.
        most = GAIN * max(self._scale, abs(now.work))
        # A clipped F or a capped stress is not the gradient of an energy: its gain is no evidence
        # about the step.  The condition is such that an energy of NaN fails too.
        limited = now.clamped + now.stress_capped > 0 and np.isfinite(gain)
        if not (gain <= most or limited):
            return worst(particles), (
                f"energy rose by {gain:.4g} J without a cause within the frame, in which it went"
                f" from {before:.4g} J to {after:.4g} J"
                f" (at most {most:.2g} J can be rounding and integration error)"
            )
        # a particle's distance from its body's median is at most the diagonal of the bounding box
        low, high = corners(particles.x)
        if not np.linalg.norm(high - low) <= ESCAPE * self._reach:
            far = self._distances(particles.x)
            if far.max() > ESCAPE * self._reach:
                return int(far.argmax()), (
                    f"a particle is {length_text(far.max())} away from the others, but the body is "
                    f"{length_text(self._reach)} long at rest"
                )
        return self._judge_inversion(last, now, particles)

    def _distances(self, x: Floats) -> Floats:
        """(N,) [m] distance of each particle from the median position of its body."""
        body = np.zeros(len(x), np.int64) if self._body is None else self._body
        middles = [np.median(x[body == k], axis=0) for k in range(int(body.max()) + 1)]
        return np.linalg.norm(x - np.array(middles)[body], axis=1)

    def _judge_inversion(self, last: Health, now: Health, particles: Pose) -> tuple[int, str]:
        """A new inversion is repeated once with half the step; if it remains, it is accepted."""
        known = max(self._inverted, last.inverted)
        if now.inverted > known and self._tried < 0:
            self._tried = now.inverted
            return worst(particles), f"{counted(now.inverted, 'particle')} turned inside out"
        if self._tried >= 0:
            self._inverted = max(self._inverted, now.inverted)
        self._tried = -1
        return -1, ""

    def refine(self) -> None:
        """Halve the step."""
        self.halvings += 1
        self._calm = 0

    def passed(self) -> None:
        """Count an accepted frame; after CALM_FRAMES of them double a halved step."""
        self._calm += 1
        if self.halvings and self._calm >= CALM_FRAMES:
            self.halvings -= 1
            self._calm = 0

    def save(self) -> dict[str, float]:
        """The state of the guard, for checkpoints."""
        return {
            "scale": self._scale,
            "calm": self._calm,
            "inverted": self._inverted,
            "halvings": self.halvings,
        }

    def load(self, saved: Mapping[str, float]) -> None:
        """Restore the result of `save`."""
        self._scale = float(saved["scale"])
        self._calm, self._inverted = int(saved["calm"]), int(saved["inverted"])
        self.halvings = int(saved["halvings"])


def worst(particles: Pose) -> int:
    """Index of the particle with the least J."""
    return int(np.argmin(np.linalg.det(particles.F)))
