"""Settings of a bake: the samples that are simulated and written, and the resolution.

Frames are counted from 0, the body at rest where it was put, at the time code `Settings.start`.
The simulation runs from there to the last frame that is written.  With n samples per frame the
solver makes n times as many frames at n times the rate; sample k is frame k / n.

How finely a body is filled: by a spacing or by a count, from the options or from the stage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats, triple
from gf_usd.core.asset import StageFacts, authored_rate, first_time_code
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.particles import times_as_long
from gf_usd.core.frames.settings import CONSISTENT, LUMPED, MIXED, Field, Settings, written
from gf_usd.core.materials.dimensionless import FILTER_RATE, G0, SHOT_LENGTH, time_scale
from gf_usd.core.stage import StageSpec
from gf_usd.core.units import code_text, length_text
from gf_usd.prepare.options.fields import GravityKeys, in_meters, parse_field
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.texts import AUTO, Floor, Height, Triple

if TYPE_CHECKING:
    from gf_usd.geometry.thin.thickness import Thickness

ROUNDING = 1e-6  # frames: time codes are typed in decimals
DEFAULT_PARTICLES = 8000  # quality and time: a duck looks smooth and bakes in seconds
# Three particles across are two grid cells or nearly so: a part then has a middle and two sides.
ACROSS = 3.0
FINEST = 4  # times as many at most, for thin parts
SHORT = 0.98  # times ACROSS: from here on more particles would not be seen
SAME = 1e-3  # relative: spacings that differ by less are one
SENSIBLE = 2_000_000  # particles: more is no advice
DEFAULT_FPS = 24.0
LEAD = 1.0  # [s] that a pre-roll takes at least: what its start shakes up dies away
DEFAULT_DROP = Height(value=3.0, in_radii=True)
ON_FLOOR = Height(value=0.0, in_radii=False)

# GaussianFlesh section 4, with what it leaves out as fitted in docs/physics.md: a unit sphere,
# so that rates are given in units of 1/T with its T.
PAPER_T = time_scale(1.0)
PAPER_PARTICLES = 120
PAPER_FRAMES = 260
PAPER_SUBSTEPS = 10
PAPER_DRAG = 0.5 * PAPER_T
PAPER_CONTACT = 2000.0 * PAPER_T**2

SETTLING = 10  # times as long as a shot may everything take to come to rest
ROLLING_RESISTANCE = 0.05  # soft rubber on a hard floor; a bouncing ball has 0.01 to 0.05
# Particle-substeps until then above which a bake ends with the shot where no length is given:
# half an hour on one core.
REST_WORK = 2e10
# [s] of playback that rest usually takes, above which it does so: of bodies of 17 m in radius.
REST_SECONDS = 60.0


def span(
    range: tuple[float | None, float | None] | None,
    handles: int,
    *,
    start: float,
    step: float,
    frames: int,
    fixed: bool,
    option: str,
) -> tuple[int, int]:
    """(first frame that is written, number of frames simulated) with range and handles.

    Parameters
    ----------
    range : first and last time code, each None where it is open; None: all.
    handles : additional frames that are written on both sides.
    start : time code of frame 0; step : time codes per frame.
    frames : of the bake without a range; fixed : they were given.
    option : the option as it was given, for the message.

    A first frame below 0 holds the rest pose.  Raises UsageError for a range outside the bake.
    """
    first, last = 0, frames - 1
    if range is not None:
        low, high = range
        if low is not None:
            first = int(np.ceil((low - start) / step - ROUNDING))
        if high is not None:
            last = int(np.floor((high - start) / step + ROUNDING))
        _require_inside(option, first, last, start, step, frames if fixed else None)
    return first - handles, last + 1 + handles


def _require_inside(
    option: str, first: int, last: int, start: float, step: float, frames: int | None
) -> None:
    if first < 0:
        raise UsageError(
            f"{option} begins before the simulation, which starts at time code {code_text(start)}",
            "start later; --handles holds the rest pose before the start",
        )
    if last < first:
        raise UsageError(
            f"{option} contains no frame: frames are at {code_text(start)} + k * {step:g}",
            "give a range with a frame in it",
        )
    if frames is not None and last > frames - 1:
        raise UsageError(
            f"{option} ends after the last of --frames {frames}, at time code"
            f" {code_text(start + (frames - 1) * step)}",
            "leave --frames out: the range sets the length of the simulation",
        )


def time_scale_of(requested: float | str | None, T: float) -> float:
    """Simulated seconds per second of playback; "auto" plays T [s] as that of a 1 m body."""
    if requested is None:
        return 1.0
    return T / PAPER_T if requested == AUTO else float(requested)


def floor_plane(requested: Floor | None, up: Floats, unit: float) -> tuple[float | None, Floats]:
    """Distance along the normal [m], None for no floor, and the unit normal (3,).

    up : unit (3,); unit : [m] per stage length.  Raises UsageError for a normal that does not point
    up.
    """
    if requested is None or requested.height is None:
        return (0.0 if requested is None else None), up
    normal = up
    if requested.normal is not None:
        normal = np.array(requested.normal)
        length = float(np.linalg.norm(normal))
        requested.require_upright(float(normal @ up) / length)
        normal = normal / length
    return requested.height * unit * float(normal @ up), normal


def fields_of(
    request: Request, facts: StageFacts, keys: Sequence[tuple[float, Triple]], stated: Sequence[str]
) -> tuple[Field, ...]:
    """Body forces in addition to gravity; keys : of gravity [m/s^2] in the stage; stated : fields
    of the stage, which are used where the request has none.
    """
    requested = request.parsed["gravity"]
    if isinstance(requested, GravityKeys):
        values = [gravity_vector(value, facts.up) for value in requested.values]
        keys = list(zip(requested.times, values, strict=True))
    times, vectors = tuple(k for k, _ in keys), tuple(g for _, g in keys)
    moving = (Field(kind="gravity", times=times, values=vectors),) if len(keys) > 1 else ()
    given = [parse_field(text) for text in request.fields]
    if not given:
        given = [parse_field(text, f"{facts.path}: a field of the PhysicsScene") for text in stated]
    return (*moving, *(in_meters(field, facts.units.length) for field in given))


def gravity_vector(requested: float | Triple | GravityKeys | None, up: Floats) -> Triple:
    """[m/s^2] of a magnitude along minus the unit vector up (3,), or of a vector; of keys, the
    first.
    """
    if isinstance(requested, GravityKeys):
        requested = requested.values[0]
    if isinstance(requested, tuple):
        return triple(np.array(requested) + 0.0)
    return triple(-(G0 if requested is None else requested) * up + 0.0)


@dataclass(frozen=True, kw_only=True)
class Animation:
    """The animation that a character's flesh follows."""

    first: float  # time code
    last: float
    reach: float  # [m] from the bind pose to the first pose, of the part that goes the farthest
    closed: bool = False  # whether the last pose is the first one
    cached: bool = False  # of points; False: of a skeleton
    nearest: str = ""  # the Skeleton whose nearest bones points without joint weights follow

    def cycle(self, frames: int) -> int:
        """Frames of a period, from the first to the last time code."""
        return max(1, frames - 1 if self.closed else frames)

    def lead(self, settings: Settings, repeated: int = 0) -> int:
        """Number of simulated frames from the bind pose to the first pose.

        repeated : frames of cycles before the written one.
        """
        step = settings.time_codes_per_second / settings.fps
        return round((self.first - settings.start) / step) - repeated

    def preroll(self, fps: float, time_scale: float) -> int:
        """Frames from the bind pose to the first pose.

        Along s = 3 r^2 - 2 r^3, a distance D takes the largest acceleration 6 D / T^2: T is such
        that it is at most gravity. time_scale : simulated seconds per second of playback.
        """
        seconds = max(LEAD, (6.0 * self.reach / G0) ** 0.5)
        return int(np.ceil(seconds * fps / time_scale - ROUNDING))


def is_placed(request: Request, facts: StageFacts) -> bool:
    """Whether bodies begin where a stage with UsdPhysics has placed them."""
    return facts.says_physics and request.preset != "paper" and request.drop is None


def resolve(
    request: Request,
    facts: StageFacts,
    radius: float,
    lowest: float,
    animation: Animation | None = None,
    gravity_keys: Sequence[tuple[float, Triple]] = (),
    *,
    stated_fields: Sequence[str] = (),
    attached: bool = False,
    rounding: float = 0.0,
) -> Settings:
    """Settings of a bake, except for those that depend on its material (`paper.of_material`).

    radius : r = (3 V / 4 pi)^(1/3) [m]; lowest : [m] of the asset along the floor's normal.
    animation : that the bones of --flesh follow; gravity_keys : time codes and [m/s^2] of the
    stage; stated_fields : its fields; attached : attachments of the stage pin the body.
    rounding : [m] of `lowest`.
    """
    paper = request.preset == "paper"
    authored = authored_rate(facts)
    T = time_scale(radius)
    # The paper's 60 frames per second are for a body of 1 m; others keep its frames per T.
    playback = facts.frames_per_second or authored or DEFAULT_FPS
    fps = request.fps or (60.0 * PAPER_T / T if paper else playback)
    requested = request.parsed
    floor, normal = floor_plane(requested["floor"], facts.up, facts.units.length)
    lift = _lift(
        request, facts, radius, ((floor or 0.0) - lowest) / float(normal @ facts.up),
        floor=floor is not None, animated=animation is not None, attached=attached,
        rounding=rounding,
    )  # fmt: skip
    slow = time_scale_of(requested["time_scale"], T)
    shot = int(np.ceil(SHOT_LENGTH * T * fps / slow)) + 1
    start, first, frames = _frame_range(
        request, facts, animation, fps=fps, slow=slow, shot=shot, step=(authored or fps) / fps
    )
    rate = request.filter_rate
    if rate is None:
        rate = np.inf if paper or request.solver == "ul" else FILTER_RATE
    drag = (PAPER_DRAG / T if paper else 0.0) if request.drag is None else request.drag
    return Settings(
        frames=frames,
        first=first,
        samples_per_frame=request.samples_per_frame or 1,
        fps=fps,
        time_codes_per_second=authored or fps,
        start=start,
        gravity=gravity_vector(requested["gravity"], facts.up),
        up=triple(facts.up),
        floor=floor,
        floor_normal=None if np.array_equal(normal, facts.up) else triple(normal),
        lift=triple(lift * facts.up),
        seed=request.seed or 0,
        filter_rate=float(rate) / T,
        drag=drag,
        device=request.device,
        threads=request.threads,
        time_scale=slow,
        substeps=PAPER_SUBSTEPS if paper else None,
        cell=radius / 4.0 if paper else None,
        contact_rate=PAPER_CONTACT / T**2 if paper else None,
        sampling="rejection" if paper else "strata",
        followers=not paper,
        mass=LUMPED if paper else CONSISTENT,
        deformation_gradients=request.deformation_gradients,
        stress=request.stress,
        internal=request.internal,
        skin=request.skin or ("paper" if paper else "embed"),
        solver=request.solver or "tl",
        shortcuts=not request.no_shortcuts,
        mass_scaling=request.mass_scaling or 1.0,
        fields=fields_of(request, facts, gravity_keys, stated_fields),
        rolling=_rolling(request, paper),
        settling=not (paper or request.no_settling or request.solver in ("ul", MIXED)),
    )


def _lift(
    request: Request,
    facts: StageFacts,
    radius: float,
    to_floor: float,
    *,
    floor: bool,
    animated: bool,
    attached: bool,
    rounding: float,
) -> float:
    """[m] by which bodies are moved up at the start.

    to_floor : [m] by which their lowest point would be moved to the floor, or to height 0 where
    there is no floor.  animated : bones of --flesh support them; attached : attachments do.
    rounding : [m] by which they may be below the floor where a stage has placed them.
    """
    placed = is_placed(request, facts)
    drop = ON_FLOOR if placed else request.parsed["drop"] or DEFAULT_DROP
    height = drop.meters(radius, facts.units.length)
    # What is pinned, or has no floor, stays where it is.
    if animated or (request.drop is None and (request.pins or attached or not floor)):
        return 0.0
    if not floor:
        return height
    lift = height + to_floor
    # the stage may have placed it in the air
    return (lift if lift > rounding else 0.0) if placed else lift


def _frame_range(
    request: Request,
    facts: StageFacts,
    animation: Animation | None,
    *,
    fps: float,
    slow: float,
    shot: int,
    step: float,
) -> tuple[float, int, int]:
    """The time code of the first simulated frame, the first frame that is written, and the number
    of simulated frames.

    fps : frames per second; slow : seconds simulated per second of playback; shot : frames of a
    bake of default length; step : time codes of a frame.
    """
    start = first_time_code(facts, request.start)
    if animation:
        start = animation.first
        shot = int(np.floor((animation.last - start) / step + ROUNDING)) + 1
    if request.settle_only or request.until_rest:
        shot = settled_frames(shot)
    requested = request.parsed
    most = requested["frames"].frames if requested["frames"] else None
    paper = request.preset == "paper" and not request.until_rest
    frames = most or (PAPER_FRAMES if paper else shot)
    first, frames = span(
        requested["range"], request.handles or 0, start=start, step=step,
        frames=frames, fixed=bool(request.frames), option=f"--range {request.range}",
    )  # fmt: skip
    if animation:
        lead = request.preroll or animation.preroll(fps, slow)
        lead += request.cycles.repeats * animation.cycle(shot)
        first, frames, start = first + lead, frames + lead, start - lead * step
    return start, first, frames


def _rolling(request: Request, paper: bool) -> float:
    if request.rolling_resistance is not None:
        return request.rolling_resistance
    return 0.0 if paper or request.solver in ("ul", MIXED) else ROLLING_RESISTANCE


def frames_until(code: float, start: float, step: float) -> int:
    """Number of frames from time code `start` on, `step` apart, to the first at or after `code`."""
    return int(np.ceil((code - start) / step - ROUNDING)) + 1


def settled_frames(shot: int) -> int:
    """Frames in which all bodies should come to rest, for a shot of `shot` frames."""
    return SETTLING * (shot - 1) + 1


def shot_frames(settled: int) -> int:
    """Frames of a shot; the inverse of `settled_frames`."""
    return (settled - 1) // SETTLING + 1


@dataclass(frozen=True, kw_only=True)
class Extension:
    """The number of frames of a bake of default length whose pins or obstacles move for longer."""

    what: str  # moves, as words
    until: float  # time code
    least: int  # frames of the default length
    needed: int  # frames until then
    limit: str = ""  # what `needed` would take too much of; "": it does not

    def note(self, settings: Settings) -> str:
        """The note on the number of frames of these settings."""
        frames, handles = settings.frames, -settings.first
        made = f"{frames} frames are simulated"
        if handles:
            made = f"{written(settings)} frames are written, {frames} of them simulated"
        until = f"time code {code_text(self.until)}"
        if not self.limit:
            return f"{made}, as {self.what} moves until {until}: --frames sets another number"
        return (
            f"{made}, although {self.what} moves until {until}, which would take more than"
            f" {self.limit}; use --frames {self.needed - handles} for that"
        )


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """The resolution of the fill."""

    spacing: float | None  # [m]; None: by the count
    particles: int  # that hold where there is no spacing
    note: str = ""


def resolution(
    particles: int | None,
    spacing: float | None,
    spec: StageSpec,
    volumes: Callable[[], Mapping[tuple[str, ...], float]],
    thin: Callable[[], tuple[float, Thickness | None]] | None = None,
    *,
    paper: bool,
) -> Resolution:
    """An option takes precedence over the stage, and the stage over the defaults.

    spacing : [m]; volumes : see `stated_spacing`, called where needed.
    thin : of the solid its volume [m^3] and its thickness, called where neither does; None
    where thickness follows the spacing.
    """
    if paper or particles is not None or spacing is not None:
        return Resolution(
            spacing=spacing,
            particles=particles or (PAPER_PARTICLES if paper else DEFAULT_PARTICLES),
        )
    spacing, note = stated_spacing(spec, volumes())
    if spacing is not None or thin is None:
        return Resolution(spacing=spacing, particles=DEFAULT_PARTICLES, note=note)
    return by_thickness(*thin())


def stated_spacing(
    spec: StageSpec, volumes: Mapping[tuple[str, ...], float]
) -> tuple[float | None, str]:
    """Spacing [m] that the stage states, and a note where it states several: the finest.

    volumes : [m^3] of each surface, by the prim paths of the meshes that it consists of.
    """
    requested: dict[str, float] = {}
    groups: dict[str, tuple[int, float]] = {}
    for path, bake in spec.bakes.items():
        if bake.spacing is not None:
            requested[path] = bake.spacing
    for paths, volume in volumes.items():
        bakes = [spec.bakes[path] for path in paths if path in spec.bakes]
        counts = {b.particles_of: b.particles for b in bakes if b.particles and b.spacing is None}
        for prim, count in counts.items():
            groups[prim] = count, groups.get(prim, (count, 0.0))[1] + volume
    requested |= {p: float(np.cbrt(v / n)) for p, (n, v) in groups.items() if v > 0.0}
    if not requested:
        return None, ""
    path, finest = min(requested.items(), key=lambda item: item[1])
    several = max(requested.values()) > (1.0 + SAME) * finest
    note = (
        f"a bake has one spacing: the {length_text(finest)} of <{path}> is used for all bodies"
        if several
        else ""
    )
    return finest, note


def by_thickness(volume: float, thick: Thickness | None) -> Resolution:
    """Number of particles for `ACROSS` particles across all but the thinnest 5 % of the surface.

    Between `DEFAULT_PARTICLES` and `FINEST` times as many, because the time of a bake grows as
    N^(4/3): N particles, and time steps proportional to the distance between them.

    volume : [m^3] of the solid.
    """
    base = DEFAULT_PARTICLES
    wanted = volume * (ACROSS / thick.thin) ** 3 if thick else 0.0
    if thick is None or wanted <= base:
        return Resolution(spacing=None, particles=base)
    count = int(np.ceil(min(wanted, FINEST * base)))
    longer = times_as_long(count, base)
    if not longer:
        return Resolution(spacing=None, particles=count)
    thin = f"5 % of the surface is at most {length_text(thick.thin)} thick"
    time = f"take {longer} as {base}"
    note = f"{thin}: {count} particles put {ACROSS:g} across it and {time}"
    across = thick.across(float(np.cbrt(volume / count)))
    if wanted > count and across < SHORT * ACROSS:
        digit = 10.0 ** (np.floor(np.log10(wanted)) - 1.0)
        more = int(np.ceil(wanted / digit) * digit)
        remedy = (
            f"--particles {more} would put {ACROSS:g} across and take {times_as_long(more, count)}"
            if more <= SENSIBLE
            else f"{ACROSS:g} across would need more than {SENSIBLE} particles"
        )
        most = f"{count} particles, the most by default, put {across:.1f} across it"
        note = f"{thin}: {most} and {time}; {remedy}"
    return Resolution(spacing=None, particles=count, note=note)
