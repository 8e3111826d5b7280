"""Frame by frame, each believed only once the guard has seen it: what every solver shares.

A solver is a state, a way to move it by so many substeps, and a way to read a `Frame` off it.  This
file turns the three into frames: it chooses the number of substeps, rolls a frame that failed back
and redoes it with half the step, and ends in words where that does not help.

Watching a run: what no sound frame does is not believed.

The step limit of `time_step` holds for the body at rest.  A material crushed to a tenth of its
volume is many times stiffer, and a step too long for it shows as energy: without a source of its
own a body under gravity, floor and damping can only lose some, up to the integrator's error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners
from gf_usd.core.errors import SolverError
from gf_usd.core.frames import Frame, Health, Particles, Pose, Settings
from gf_usd.physics.contact.floor import FloorContact, pressed_step
from gf_usd.physics.taichi_arrays import Saved
from gf_usd.physics.time_step import StableStep


@dataclass(frozen=True, kw_only=True)
class FrameStats:
    """What was noticed between two frames, on the substeps, under the names of `Health`."""

    penetration: float = 0.0  # [m] deepest of a contact sample in the floor
    overlap: float = 0.0  # [m] deepest contact sample in a body or obstacle
    let_go: int = 0  # most contact samples released at the same time
    friction_capped: int = 0
    work: float = 0.0  # [J] done on the body by what holds it
    injected: float = 0.0  # [J] given to the body between substeps: see `shape_correction`
    planes: float = 0.0  # [J] of it, that new contact planes gave
    clamped: int = 0  # particles whose singular values of F were clipped
    stress_capped: int = 0  # particles whose stress was cut
    flying: int = 0  # bodies that flew by the closed form: there were no substeps
    sleeping: int = 0  # bodies that slept: there were no substeps
    plastic_dissipation: float | None = None  # [J] lost to flow; None: no law flows
    conversion_dissipation: float | None = None  # [J] of it, by conversion; None: there is none
    settling_dissipation: float | None = None  # [J] of `settling`; None: it does not act
    substeps: int | None = None  # that there were; None: as many as were asked for

    @property
    def rested(self) -> bool:
        """Whether there were no substeps."""
        return self.flying + self.sleeping > 0


class Stepped(Protocol):
    """What the step of a body follows from."""

    @property
    def contact(self) -> FloorContact | None: ...

    @property
    def step(self) -> StableStep: ...


class Solver(ABC):
    """The protocol of a solver: construct it, then iterate `frames()`.

    What makes one: `particles`, `settings`, `body`, `guard`, `coarse` (substeps a frame of the
    stable step at rest), `strained` (those that the body as it is now asks for), `state`, and the
    abstract methods below.  `on_launch` is called after launches of kernels, several times in a
    long frame; it may raise, to end the simulation within a frame.
    """

    particles: Particles
    settings: Settings
    body: Stepped
    guard: Guard
    coarse: int
    strained: int = 1
    state: Saved
    on_launch: Callable[[], None] | None = None
    takes_forces = False  # whether it has `push`

    @property
    def in_place(self) -> bool:
        """Whether pins or goals say where the body is, so that it has no height to fall from."""
        return False

    @abstractmethod
    def advance(self, index: int, substeps: int) -> FrameStats:
        """Move to frame `index` in so many substeps."""

    @abstractmethod
    def not_finite(self) -> tuple[int, str]:
        """The particle nearest to what is no number, and the fault; (-1, "") where all is sound."""

    @abstractmethod
    def read(self, index: int) -> Frame:
        """The frame of the present state; its health lacks what only `FrameStats` knows."""

    @abstractmethod
    def places(self) -> Floats:
        """(n, 3) [m] where `throw` sets velocities: of free nodes and of particles that flow."""

    @abstractmethod
    def throw(self, velocities: Floats) -> None:
        """Replace the velocities (n, 3) [m/s] at `places`."""

    @property
    def frame_time(self) -> float:
        """[s] of simulated time between frames."""
        return self.settings.frame_time

    def pressed(self, depth: float) -> int:
        """Substeps a frame that the floor's springs ask for where the deepest is so deep [m]."""
        if self.settings.substeps:
            return 1
        step = pressed_step(self.body.contact, self.body.step, depth)
        return int(np.ceil(self.frame_time / step.dt))

    def asked(self, strained: int, depth: float) -> int:
        """Substeps a frame of a body so strained, and pressed so deep [m] into the floor."""
        pressed = self.pressed(depth)
        return max(strained, pressed) if pressed > self.coarse else strained

    @property
    def substeps(self) -> int:
        """Substeps of the next frame."""
        return max(self.coarse, self.strained) << self.guard.halvings

    @property
    def damping_ratio(self) -> float:
        """Of the stiffest vibration of the grid at rest, by the material's own damping."""
        return 0.5 * self.body.step.viscous_time * self.body.step.elastic

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

    def save(self) -> dict[str, Any]:
        """Between two frames, all that another solver of the same body needs to go on alike."""
        guard = {f"guard_{name}": value for name, value in self.guard.save().items()}
        return {**self.state.save(), **guard, "strained": self.strained}

    def load(self, saved: Mapping[str, Any]) -> None:
        """Go on from what `save` returned, to the bit."""
        self.state.load(saved)
        known = self.guard.save()
        self.guard.load({name: float(saved[f"guard_{name}"]) for name in known})
        self.strained = int(saved["strained"])

    def _hint(self) -> str:
        """What a person may do about a frame that cannot be had."""
        if self.settings.substeps:
            return "this preset uses the same few substeps for every frame: leave out --preset"
        gentler = "slow down what moves it" if self.in_place else "lower the impact (--drop)"
        return f"{gentler}, use a stiffer material or, if it is corotated, --law neoHookean"

    def next(self, index: int, last: Health) -> Frame:
        """Move by a frame; where it fails, roll back and redo it with half the step.

        Where it pressed the floor's springs harder than its step allows, it is redone with theirs.
        """
        saved = self.state.save()
        for attempt in range(RETRIES + 1):
            substeps = self.substeps
            stats = self.advance(index, substeps)
            particle, fault = self.not_finite()
            # How deep a frame presses its samples is known at its end.
            while (
                not (fault or stats.rested)
                and (asked := self.pressed(stats.penetration) << self.guard.halvings) > substeps
            ):
                self.state.load(saved)
                substeps = asked
                stats = self.advance(index, substeps)
                particle, fault = self.not_finite()
            if not fault:
                frame = self.read(index)
                done = 0 if stats.rested else substeps
                seen = {name: value for name, value in vars(stats).items() if value is not None}
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
            self.guard.refine()
        raise SolverError(
            f"frame {index}: {fault}, with {self.coarse} substeps, and still after {RETRIES} "
            f"halvings of the step to {self.dt:.3g} s",
            self._hint() + "; the frames before it are in the partial cache",
            frame=index,
            particle=particle,
        )


def first_bad(values: Floats) -> int:
    """Index of the first row that holds something that is no number; -1 where none does."""
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(1)
    return int(np.argmax(bad)) if bad.any() else -1


RETRIES = 6  # halvings of the step before giving up
CALM_FRAMES = 4  # good frames before a halved step is doubled again
# Position Verlet keeps a shadow energy; the energy itself swings by up to (w dt)^2 / 4 of what the
# stiffest vibrations hold.  In sound bakes of all looks no frame gained 1e-4 of the scale below
# (measured), and an unstable one gains many times it.
GAIN = 0.02
# No look, falling or pulled at, is ever this many radii long; a piece that flew off is.
ESCAPE = 100.0


class Guard:
    """Judges frames and holds the number of halvings.

    scale : [J] an energy of the body, m g0 r: what counts as little.
    reach : [m] the body's own extent at rest; a particle a hundred times as far off has escaped.
    body : (N,) the body of each particle; None: all are one.
    """

    def __init__(self, scale: float, reach: float, body: Ints | None = None) -> None:
        self._scale, self._reach, self._body = scale, reach, body
        self._calm = 0
        self._inverted = 0  # that a shorter step did not help: the law's doing, not the step's
        self._tried = -1  # inverted particles before the last refinement; -1: none was for them
        self.halvings = 0

    def judge(self, last: Health, now: Health, particles: Pose) -> tuple[int, str]:
        """The particle and the fault of a frame, in words; (-1, "") where nothing is wrong."""
        before, after = energy(last), energy(now)
        self._scale = max(self._scale, last.kinetic + last.elastic)
        gain = after - before - now.work - now.injected + now.dissipation
        # Of a body at rest that a pin sets in motion the work of the frame is the only measure.  An
        # unstable step gains by the square of its forces, of which work has the first power.
        most = GAIN * max(self._scale, abs(now.work))
        # A clipped F or a cut stress is no gradient of an energy: what it gains says nothing of
        # the step.  Written so that an energy that is no number fails too.
        limited = now.clamped + now.stress_capped > 0 and np.isfinite(gain)
        if not (gain <= most or limited):
            return worst(particles), (
                f"energy rose from {before:.4g} J to {after:.4g} J within the frame"
                f" (at most {most:.2g} J can be rounding and integration error)"
            )
        # A particle is no further from the middle of its body than the box around all is long.
        low, high = corners(particles.x)
        if not np.linalg.norm(high - low) <= ESCAPE * self._reach:
            far = self._distances(particles.x)
            if far.max() > ESCAPE * self._reach:
                return int(far.argmax()), (
                    f"a particle is {far.max():.4g} m away from the others, but the body is "
                    f"{self._reach:.3g} m long at rest"
                )
        return self._judge_inversion(last, now, particles)

    def _distances(self, x: Floats) -> Floats:
        """(N,) [m] of particles from the middle of their body."""
        body = np.zeros(len(x), np.int64) if self._body is None else self._body
        middles = [np.median(x[body == k], axis=0) for k in range(int(body.max()) + 1)]
        return np.linalg.norm(x - np.array(middles)[body], axis=1)

    def _judge_inversion(self, last: Health, now: Health, particles: Pose) -> tuple[int, str]:
        """A new inversion is worth one try with half the step; what that leaves is believed."""
        known = max(self._inverted, last.inverted)
        if now.inverted > known and self._tried < 0:
            self._tried = now.inverted
            return worst(particles), f"{now.inverted} particles turned inside out"
        if self._tried >= 0:
            self._inverted = max(self._inverted, now.inverted)
        self._tried = -1
        return -1, ""

    def refine(self) -> None:
        """Halve the step."""
        self.halvings += 1
        self._calm = 0

    def passed(self) -> None:
        """Count a good frame; after enough of them double a halved step."""
        self._calm += 1
        if self.halvings and self._calm >= CALM_FRAMES:
            self.halvings -= 1
            self._calm = 0

    def save(self) -> dict[str, float]:
        """What a checkpoint keeps of it."""
        return {
            "scale": self._scale,
            "calm": self._calm,
            "inverted": self._inverted,
            "halvings": self.halvings,
        }

    def load(self, saved: Mapping[str, float]) -> None:
        """Go on from what `save` returned."""
        self._scale = float(saved["scale"])
        self._calm, self._inverted = int(saved["calm"]), int(saved["inverted"])
        self.halvings = int(saved["halvings"])


def energy(h: Health) -> float:
    """Kinetic, elastic, potential and contact energy [J]."""
    return h.kinetic + h.elastic + h.potential + h.contact


def worst(particles: Pose) -> int:
    """The particle that is most strained: least J."""
    return int(np.argmin(np.linalg.det(particles.F)))
