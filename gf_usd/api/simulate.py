"""`gf_usd.simulate`: simulates a scene one frame at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gf_usd.api.call import keywords_of, named, naming
from gf_usd.api.host.guest import guest, require_this_process
from gf_usd.api.read import Table
from gf_usd.api.scene import Scene, at_frames
from gf_usd.core.errors import SolverError, UsageError, counted
from gf_usd.core.frames.frame import Health
from gf_usd.core.units import STRONGEST
from gf_usd.prepare.options import values
from gf_usd.prepare.options.texts import FASTEST

if TYPE_CHECKING:
    from gf_usd.core.frames.frame import Frame
    from gf_usd.core.frames.particles import Particles
    from gf_usd.core.frames.settings import Settings
    from gf_usd.core.materials.material import Material

Array = NDArray[np.float64]
# What `Simulation.save` adds to the state of the solver.
STATE = {"index", "health", "disturbed", "forces", "added_acceleration", "rest"}
# A scene has no options but these: bodies have a material and a velocity, and pins are its own.
KEYWORDS = keywords_of(
    "particles", "spacing", "frames", "fps", "drag", "self_contact", "filter_rate", "conversions",
    "stress", "device", "threads", "gravity", "floor", "material", "velocity", "spin", "friction",
    no_shortcuts="shortcuts=False", pins="scene.pin()", colliders="scene.add_obstacle()",
)  # fmt: skip
FRAMES = 48
FPS = 24.0


@dataclass(frozen=True, kw_only=True, repr=False)
class SimulationFrame:
    """One frame of a simulation, in SI and in the world frame of the scene."""

    index: int  # 0 for the start
    time: float  # [s]
    positions: Array  # (N, 3) [m] of the particles
    velocities: Array  # (N, 3) [m/s] of the particles
    F: Array  # (N, 3, 3) deformation gradients of the particles
    # (V, 3) [m] points of the surfaces of solid bodies, by name; of none with converted particles
    meshes: Mapping[str, Array]
    converted: NDArray[np.bool_] | None  # (N,) which particles were; None: none can be
    health: Health  # energies, momentum, strains and contact
    stress: Array | None  # (N,) [Pa] von Mises; None unless requested

    def __repr__(self) -> str:
        return (
            f"SimulationFrame(index={self.index}, time={self.time:.6g},"
            f" particles={len(self.positions)})"
        )


class Simulation(Iterator[SimulationFrame]):
    """A scene in motion; iterate over it, or call `next`.

    Between two frames `push`, `accelerate` and `set_velocities` act on the bodies, and `save` and
    `load` store and restore a state.  Forces and an acceleration add up.  `close` frees the memory;
    so does the end of a ``with`` block.  All simulations of a process share one Taichi runtime, so
    they have the same device and threads.  Taichi keeps the memory of freed arrays (about 2 MB for
    4,000 particles): to run one scene many times, save its first state and load it again.
    """

    def __init__(self, scene: Scene, frames: int, options: Mapping[str, Any]) -> None:
        from gf_usd.pipeline.scene import plan_scene, start_scene
        from gf_usd.system.taichi_runtime import epoch

        fps = options["fps"]
        times = [k / fps for k in range(frames)]
        spec = at_frames(scene, times, {**options, "frames": frames})
        self._plan = plan_scene(spec)
        self._solver: Any = start_scene(self._plan)
        self._epoch = epoch()
        self._frames = frames
        self._index = -1  # of the last frame
        self._last: Health | None = None
        self._disturbed = False  # since the last frame
        self._known_shapes: Mapping[str, tuple[int, ...]] | None = None  # see `_shapes`
        self._forces: Any = 0.0  # (n, 3) [m/s^2] of free nodes by `push`; 0: none
        self._acceleration: Any = 0.0  # the same by `accelerate`
        self.bodies: tuple[str, ...] = scene.bodies
        # assumptions, as text
        self.notes: tuple[str, ...] = tuple(
            KEYWORDS.hint(note) for note in (*scene._notes, *self._plan.notes)
        )

    def __repr__(self) -> str:
        if self._solver is None:
            return "Simulation(closed)"
        frame, count = min(self._index + 1, self._frames), len(self._plan.particles)
        return f"Simulation(next frame {frame} of {self._frames}, particles={count})"

    @property
    def particles(self) -> Particles:
        """The particles at rest: X (N, 3) [m], V0 (N,) [m^3], material (N,), body and others."""
        return self._plan.particles

    @property
    def body_of_particles(self) -> NDArray[np.int64]:
        """(N,) index into `bodies` of each particle."""
        return np.array(self._plan.particles.surface, np.int64)

    @property
    def masses(self) -> Array:
        """(N,) [kg] of the particles."""
        table = self._plan.variants[0].table
        density = np.array([material.density for material in table])
        return density[np.asarray(self._plan.particles.material)] * self._plan.particles.V0

    @property
    def materials(self) -> tuple[Material, ...]:
        """The materials, by the indices in `particles.material`."""
        return self._plan.variants[0].table

    @property
    def settings(self) -> Settings:
        """All settings of the solver."""
        return self._plan.settings

    @property
    def substeps(self) -> int:
        """Time steps of the next frame."""
        return self._running().substeps

    def __iter__(self) -> Simulation:
        return self

    def __next__(self) -> SimulationFrame:
        """The next frame; the first is the start.

        Raises SolverError where it cannot be had, and StopIteration after the last.
        """
        if self._solver is None or self._index + 1 >= self._frames:
            raise StopIteration
        solver = self._running()
        with naming(KEYWORDS), guest():
            if self._last is None:
                frame = solver.read(0)
            else:
                # what was changed since is not judged as if the solver had done it
                last = solver.read(self._index).health if self._disturbed else self._last
                frame = _next(solver, self._index + 1, last)
        self._index, self._last, self._disturbed = frame.index, frame.health, False
        return self._made(frame)

    def _made(self, frame: Frame) -> SimulationFrame:
        gone: set[str] = set()
        if frame.converted is not None:
            flows = set(self._plan.particles.body_of[frame.converted].tolist())
            gone = {path for path, body in self._plan.choices.converting if body in flows}
        return SimulationFrame(
            index=frame.index,
            time=frame.time,
            positions=np.asarray(frame.particles.x, float),
            velocities=np.asarray(frame.particles.v, float),
            F=np.asarray(frame.particles.F, float),
            meshes=Table(
                "meshes",
                {
                    path.removeprefix("/"): np.asarray(pose.x, float)
                    for path, pose in frame.embedded.items()
                    if path not in gone
                },
            ),
            converted=frame.converted,
            health=frame.health,
            stress=None if frame.stress is None else np.asarray(frame.stress, float),
        )

    def push(self, forces: ArrayLike) -> None:
        """Apply forces (N, 3) [N] to the particles during the following frames; 0 ends them.

        Raises UsageError if a body of the scene flows.
        """
        solver = self._pushed()
        wanted = self._rows("forces", forces)
        made = solver.body.mass.acceleration(solver.body.rows.combined.T @ wanted)
        _require_most("the acceleration by forces", made, STRONGEST, "m/s^2")
        self._forces = made
        self._act(solver)
        self._disturbed = True

    def accelerate(self, acceleration: ArrayLike | Callable[[Array], ArrayLike]) -> None:
        """Add an acceleration to gravity during the following frames; 0 ends it.

        acceleration : (3,) [m/s^2], or a function of rest positions (n, 3) [m] to (n, 3).

        Raises UsageError if a body of the scene flows.
        """
        solver = self._pushed()
        made = _field("acceleration", acceleration, solver.body.stencil.free_X)
        _require_most("acceleration", made, STRONGEST, "m/s^2")
        self._acceleration = made
        self._act(solver)
        self._disturbed = True

    def _act(self, solver: Any) -> None:
        with guest():
            solver.push(self._forces + self._acceleration + np.zeros(solver.places().shape))

    def set_velocities(self, velocities: ArrayLike | Callable[[Array], ArrayLike]) -> None:
        """Set the velocities at the start of the next frame; pinned parts keep theirs.

        velocities : (3,) [m/s], or a function of positions (n, 3) [m] to (n, 3).
        """
        solver = self._running()
        with guest():
            made = _field("velocities", velocities, solver.places())
            _require_most("velocities", made, FASTEST, "m/s")
            solver.throw(made)
        self._disturbed = True

    def save(self) -> dict[str, Any]:
        """Return the state, for `load` in a simulation of the same scene.

        It is the state after the last frame, with velocities, forces and accelerations set since.
        """
        solver = self._running()
        if self._last is None:
            raise UsageError("the simulation has not started", "request its first frame: next(it)")
        with guest():
            state = solver.save()
        return {
            **state, "index": self._index, "health": self._last, "disturbed": self._disturbed,
            "forces": self._forces, "added_acceleration": self._acceleration,
            "rest": self._plan.particles.X,
        }  # fmt: skip

    def _shapes(self, solver: Any) -> Mapping[str, tuple[int, ...]]:
        """The shapes of a state of this scene; read once, since that takes the whole state."""
        if self._known_shapes is None:
            with guest():
                self._known_shapes = {k: np.shape(value) for k, value in solver.save().items()}
        return self._known_shapes

    def load(self, state: Mapping[str, Any]) -> None:
        """Continue from a state of `save`; the frames that follow are identical to the bit.

        Raises UsageError for a state of another scene.
        """
        if not isinstance(state, Mapping) or not state.keys() >= STATE:
            raise UsageError("the state was not made by save()", "give what save() returned")
        solver = self._running()
        own = self._shapes(solver)
        theirs = {name: np.shape(value) for name, value in state.items() if name not in STATE}
        from gf_usd.physics.coupled.handover import FLOWING

        if FLOWING in own and FLOWING in theirs:  # the solver, and so its arrays, change meanwhile
            own, theirs = {FLOWING: own[FLOWING]}, {FLOWING: theirs[FLOWING]}
        if own != theirs or not np.array_equal(state["rest"], self._plan.particles.X):
            raise UsageError(
                f"the state is of another scene: of {len(state['rest'])} particles, and this one"
                f" has {len(self._plan.particles)}, or at other places, or of other kinds",
                "load it in a simulation of the same scene with the same options",
            )
        before = self._forces + self._acceleration
        self._forces, self._acceleration = state["forces"], state["added_acceleration"]
        if not np.array_equal(before, self._forces + self._acceleration):
            self._act(solver)  # before the rest of the state, because it wakes sleeping bodies
        with guest():
            solver.load(state)
        self._index, self._last = state["index"], state["health"]
        self._disturbed = state["disturbed"]

    def close(self) -> None:
        """End the simulation and free its solver."""
        self._solver = None

    def __enter__(self) -> Simulation:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _running(self) -> Any:
        from gf_usd.system.taichi_runtime import FORKED, SPAWN, epoch, is_forked, is_running

        if self._solver is None:
            raise UsageError("the simulation is closed", "start another: gf_usd.simulate(scene)")
        if is_forked():
            raise UsageError(f"{FORKED}: neither does the simulation", SPAWN)
        if not is_running():
            self._solver = None
            raise UsageError(
                "another part of this program started or reset Taichi, which ended the simulation",
                "run one of the two in a separate process",
            )
        if epoch() != self._epoch:
            self._solver = None
            raise UsageError(
                "Taichi was restarted with another device or number of threads, which ended the "
                "simulation",
                "give all simulations and bakes of a process the same device and threads",
            )
        return self._solver

    def _pushed(self) -> Any:
        """The solver, if it has forces on particles."""
        solver = self._running()
        if not solver.takes_forces:
            raise UsageError(
                "forces and accelerations do not act on a scene in which a body flows, or can be"
                " converted",
                "set velocities, give the scene another gravity, or move an obstacle",
            )
        return solver

    def _rows(self, name: str, given: ArrayLike) -> Array:
        count = len(self._plan.particles)
        try:
            rows = np.asarray(given, float)
        except (TypeError, ValueError):
            raise values.refuse(name, given, f"numbers of shape ({count}, 3), or 0") from None
        if rows.shape == () and rows == 0.0:
            return np.zeros((count, 3))
        wanted = f"give finite numbers of shape ({count}, 3), one row per particle"
        if rows.shape != (count, 3):
            raise UsageError(f"{name} has the shape {rows.shape}", wanted)
        _require_finite(name, rows, wanted)
        return rows


def _next(solver: Any, index: int, last: Health) -> Frame:
    """The solver's next frame; its failure with a hint for a scene, which has no options."""
    try:
        return solver.next(index, last)
    except SolverError as error:
        raise SolverError(
            error.message,
            "slow down what moves or meets the bodies, use a stiffer material or one of the law"
            " neoHookean, or use more frames per second",
            frame=error.frame,
            particle=error.particle,
        ) from error


def _require_finite(name: str, vectors: Array, hint: str) -> None:
    """Raise UsageError where vectors (3,) or (n, 3) hold infinities or NaN."""
    wrong = (~np.isfinite(np.atleast_2d(vectors))).any(axis=1)
    if not wrong.any():
        return
    count = int(wrong.sum())
    fault = f"has {counted(count, 'row')} that {'is' if count == 1 else 'are'} not finite"
    raise UsageError(f"{name} {fault if vectors.ndim > 1 else 'is not finite'}", hint)


def _require_most(name: str, vectors: Array, most: float, unit: str) -> None:
    """Raise UsageError where a component of vectors (n, 3) [unit] is larger than `most`."""
    largest = float(np.abs(vectors).max(initial=0.0))
    if largest > most:
        raise UsageError(
            f"{name}: the largest component is {largest:g} {unit}", f"give at most {most:g} {unit}"
        )


def _field(name: str, given: Any, at: Array) -> Array:
    """(n, 3) of a vector or a function at points (n, 3)."""
    form = f"three numbers, or a function of (n, 3) that returns (n, 3): here {at.shape}"
    made = given(at.copy()) if callable(given) else given
    try:
        found = np.asarray(made, float)
    except (TypeError, ValueError):
        raise values.refuse(name, made, form) from None
    whole = found.shape in ((3,), at.shape) or (found.shape == () and found == 0.0)
    if not whole:
        raise UsageError(f"{name} has the shape {found.shape}", f"give {form}")
    _require_finite(name, found, f"give {form}, all finite")
    return np.array(np.broadcast_to(found, at.shape))


@named
def simulate(
    scene: Scene,
    *,
    frames: int = FRAMES,
    fps: float = FPS,
    particles: int | None = None,
    spacing: float | None = None,
    drag: float | None = None,
    self_contact: bool | None = None,
    filter_rate: float | None = None,
    conversions: str | Sequence[str] = (),
    stress: bool = False,
    shortcuts: bool = True,
    device: str = "cpu",
    threads: int | None = None,
) -> Simulation:
    """Simulate a scene, one frame at a time.

    >>> simulation = gf_usd.simulate(scene, frames=3, particles=200)
    >>> for frame in simulation:
    ...     print(frame.index, f"{frame.time:.3f} s", frame.meshes["body0"].shape)
    0 0.000 s (8, 3)
    1 0.042 s (8, 3)
    2 0.083 s (8, 3)

    Nothing is written.  You can leave the loop early; ``with gf_usd.simulate(scene) as running:``
    frees the memory at the end of the block.

    Parameters
    ----------
    scene : the bodies, obstacles and pins.
    frames : number of frames, the start included; fps : frames per second.
    particles : approximate number; spacing : their mean distance [m] in its place.
    drag : on velocity [1/s].
    self_contact : let bodies collide with themselves; None: those that are not nearly convex.
    filter_rate : of the APIC filter [1/T].
    conversions : "[WHERE=]PRESET@LIMIT", which particles become a flowing material: WHERE is
        "/NAME" of a body or a box "x0,y0,z0,x1,y1,z1" [m], LIMIT "time:FRAME", "strain:VALUE" or
        "stress:VALUE" [Pa].
    stress : compute the von Mises stress of every particle.
    shortcuts : no substeps where all bodies fly freely or sleep.
    device : "cpu" or "cuda"; threads : CPU threads, None: all.

    Raises
    ------
    UsageError : the scene or an option makes no sense.
    InputError : a body cannot be filled.
    SolverError : raised while iterating, if the solver fails.
    """
    if not isinstance(scene, Scene):
        raise values.refuse("scene", scene, "a gf_usd.Scene; gf_usd.bake takes files")
    options = {
        "fps": values.real("fps", fps),
        "particles": None if particles is None else values.whole("particles", particles),
        "spacing": None if spacing is None else values.real("spacing", spacing),
        "drag": None if drag is None else values.real("drag", drag),
        "self_contact": None
        if self_contact is None
        else values.switch("self_contact", self_contact),
        "filter_rate": None if filter_rate is None else values.real("filter_rate", filter_rate),
        "conversions": values.conversions("conversions", conversions),
        "start": 0.0,  # time codes of frames are their numbers
        "stress": values.switch("stress", stress),
        "no_shortcuts": not values.switch("shortcuts", shortcuts),
        "device": values.text("device", device, "cpu or cuda"),
        "threads": None if threads is None else values.whole("threads", threads),
    }
    count = values.whole("frames", frames)
    if count < 1 or not options["fps"] > 0.0:
        raise UsageError(f"frames is {count} and fps is {options['fps']:g}", "give numbers above 0")
    require_this_process("simulate")
    with naming(KEYWORDS), guest():
        return Simulation(scene, count, options)
