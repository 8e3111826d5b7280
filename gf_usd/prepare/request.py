"""From what a person asked to `Settings` with nothing left open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, triple
from gf_usd.core.errors import UsageError
from gf_usd.core.frames import parse_only
from gf_usd.core.materials import G0, time_scale
from gf_usd.core.units import number, positive
from gf_usd.prepare import paper as paper_options
from gf_usd.prepare.regions import parse_regions

DEFAULT_PARTICLES = 8000  # quality and time: a duck looks smooth and bakes in seconds
DEFAULT_FPS = 24.0
DEFAULT_DROP = "3r"
LONGEST = 1e9  # of a fall, in stage units or radii: a faster one has no step
STRONGEST = 1e9  # [m/s^2]
SKINS = ("embed", "idw", "paper")
SOLVERS = ("tl", "ul")  # Total and Updated Lagrangian, see physics/solvers.py

# GaussianFlesh section 4, with what it leaves out as fitted in docs/physics.md: a unit sphere,
# so that rates are given in units of 1/T with its T.
PAPER_T = time_scale(1.0)
PAPER_PARTICLES = 120
PAPER_FRAMES = 260
PAPER_SUBSTEPS = 10
PAPER_DRAG = 0.5 * PAPER_T
PAPER_CONTACT = 2000.0 * PAPER_T**2


@dataclass(frozen=True, kw_only=True)
class Request:
    """The options of a bake as asked; None where nothing was said."""

    particles: int | None = None
    spacing: float | None = None  # [stage units]
    frames: int | None = None
    fps: float | None = None
    start: float | None = None  # time code
    drop: str | None = None  # "3r" or a length in stage units
    gravity: str | None = None  # "9.81" along -up, or "x,y,z" [m/s^2]
    seed: int | None = None  # None: 0
    device: str = "cpu"
    threads: int | None = None
    filter_rate: float | None = None  # [1/T]; inf: APIC every substep, 0: none
    drag: float | None = None  # [1/s]
    damping_time: float | None = None  # [s]
    friction: float | None = None
    restitution: float | None = None
    time_scale: str | None = None  # simulated seconds per second of playback, or "auto"
    preset: str | None = None  # "paper"
    deformation_gradients: bool = False
    stress: bool = False
    blend_width: float | None = None  # [stage units] between materials of a body; None: 0
    material_boxes: tuple[str, ...] = ()  # "PRESET:x0,y0,z0,x1,y1,z1" [stage units]
    material_labels: tuple[str, ...] = ()  # "NAME=VALUE:PRESET"
    skin: str | None = None  # one of SKINS
    solver: str | None = None  # one of SOLVERS
    pins: tuple[str, ...] = ()  # prim paths, or "box:x0,y0,z0,x1,y1,z1" [stage units]
    wls: bool | None = None  # F anew from the positions once a frame
    procrustes: float | None = None  # shape correction a frame, 0 to 1
    clamp: str | None = None  # limits of the stretches, "0.2:5", or "none"
    stress_cap: str | None = None  # largest |P| [Pa], or "none"
    export_ply: str | None = None  # folder of a sequence of 3DGS PLY files
    export_spz: str | None = None  # the same of SPZ files
    combine: bool = False  # all meshes are one body
    self_contact: bool = False  # bodies meet themselves
    floor: str | None = None  # "none", a height [stage units], a normal "x,y,z", or "height:x,y,z"
    only: str | None = None  # "mesh", "gaussians,points", ...
    flatten: bool = False  # one file
    samples_per_frame: int | None = None
    range: str | None = None  # time codes "FIRST:LAST" that are written
    handles: int | None = None  # frames written on both sides besides
    clip_frames: int | None = None  # of a value clip; 0: one file
    half: bool = False
    no_shortcuts: bool = False  # substeps also where all bodies fly freely or sleep

    def check(self) -> None:
        """Raise UsageError for values that make no sense, before anything is read."""
        positive("--particles", self.particles)
        positive("--spacing", self.spacing)
        positive("--frames", self.frames)
        positive("--fps", self.fps)
        positive("--threads", self.threads)
        for option, value, high in (
            ("--filter-rate", self.filter_rate, np.inf),
            ("--drag", self.drag, 1e6),
            ("--blend-width", self.blend_width, 1e6),
            ("--damping-time", self.damping_time, 1e6),
            ("--friction", self.friction, 100.0),
            ("--restitution", self.restitution, 1.0),
        ):
            if value is not None and not 0.0 <= value <= high:
                raise UsageError(f"{option} is {value:g}", f"give a number from 0 to {high:g}")
        if self.preset not in (None, "paper"):
            raise UsageError(f"there is no preset {self.preset!r}", "the only preset is paper")
        if self.skin not in (None, *SKINS):
            raise UsageError(f"there is no skin {self.skin!r}", f"choose {', '.join(SKINS)}")
        self._check_solver()
        regions = parse_regions(self.material_boxes, self.material_labels)
        if regions and self.blend_width:
            raise UsageError(
                f"--blend-width {self.blend_width:g} and {regions[0].option} were both given",
                "leave one out: materials blend between faces only",
            )
        paper_options.check(
            self.wls, self.procrustes, self.clamp, self.stress_cap,
            solver=self.solver, pinned=bool(self.pins),
        )  # fmt: skip
        parse_time_scale(self.time_scale, 1.0)
        if self.particles and self.spacing:
            raise UsageError(
                f"--particles {self.particles} and --spacing {self.spacing:g} were both given",
                "give one: the number of particles follows from the spacing",
            )
        if self.device not in ("cpu", "cuda"):
            raise UsageError(f"there is no device {self.device!r}", "choose cpu or cuda")
        if self.seed is not None and self.seed < 0:
            raise UsageError(f"--seed is {self.seed}", "give a number of 0 or more")
        if self.start is not None and not np.isfinite(self.start):
            raise UsageError(f"--start is {self.start}", "give a finite time code")
        self._check_output()
        parse_length("--drop", self.drop or DEFAULT_DROP, 1.0, 1.0)
        parse_gravity(self.gravity, np.array([0.0, 1.0, 0.0]))
        parse_floor(self.floor, np.array([0.0, 1.0, 0.0]), 1.0)

    def _check_output(self) -> None:
        """Raise UsageError for output choices that make no sense."""
        parse_only(self.only)
        if self.range is not None:
            parse_range(self.range)
        for option, value, low in (
            ("--samples-per-frame", self.samples_per_frame, 1),
            ("--handles", self.handles, 0),
            ("--clip-frames", self.clip_frames, 0),
        ):
            if value is not None and value < low:
                raise UsageError(f"{option} is {value}", f"give a number of {low} or more")
        if self.flatten and self.clip_frames:
            raise UsageError(
                f"--clip-frames {self.clip_frames} and --flatten were both given",
                "give one: a flattened bake is one file",
            )
        asked = (self.preset, self.wls, self.procrustes)
        if (self.samples_per_frame or 1) > 1 and any(asked):
            raise UsageError(
                f"--samples-per-frame {self.samples_per_frame} does not go with --preset paper,"
                " --wls or --procrustes",
                "leave them out: what they do once a frame would be done at every sample",
            )

    def _check_solver(self) -> None:
        """Raise UsageError for options that the solver asked for does not know."""
        if self.solver not in (None, *SOLVERS):
            raise UsageError(f"there is no solver {self.solver!r}", "choose tl or ul")
        finite = self.filter_rate is not None and np.isfinite(self.filter_rate)
        for option, given in (
            ("--pin", bool(self.pins)),
            ("--filter-rate", finite),
            ("--self-contact", self.self_contact),
        ):
            if self.solver == "ul" and given:
                raise UsageError(
                    f"--solver ul does not know {option}",
                    f"leave {option} out, or use --solver tl",
                )


def parse_time_scale(text: str | None, T: float) -> float:
    """Simulated seconds per second of playback; "auto" plays T [s] as that of a 1 m body."""
    if text is None:
        return 1.0
    if text == "auto":
        return T / PAPER_T
    value = number("--time-scale", text, "a number such as 0.2 (five times slower), or auto")
    if value <= 0.0:
        raise UsageError(f"--time-scale is {text}", "give a number above 0, or auto")
    return value


def parse_length(option: str, text: str, radius: float, unit: float) -> float:
    """Metres of "2.5" (stage units) or "3r" (radii)."""
    body, scale = (text[:-1], radius) if text.endswith("r") else (text, unit)
    value = number(option, body, "a length such as 2.5 (stage units) or 3r (radii of the body)")
    if value < 0.0:
        raise UsageError(f"{option} is {text}", "give a length of 0 or more")
    if value > LONGEST:
        raise UsageError(f"{option} is {text}", f"give a length of up to {LONGEST:g}")
    return value * scale


def parse_floor(text: str | None, up: Floats, unit: float) -> tuple[float | None, Floats]:
    """Distance along the normal [m], None for no floor, and the unit normal (3,), of "none",
    "1.5" (height in stage units), "x,y,z" (normal) or "1.5:x,y,z".
    """
    what = "none, a height such as 0.5 (stage units), a normal x,y,z, or both: 0.5:0.2,1,0"
    if text is None or text == "none":
        return (0.0 if text is None else None), up
    height, _, direction = text.rpartition(":") if "," in text else (text, "", "")
    normal = up
    if direction:
        parts = direction.split(",")
        if len(parts) != 3:
            raise UsageError(f"--floor is {text!r}", f"give {what}")
        normal = np.array([number("--floor", part, what) for part in parts])
        length = float(np.linalg.norm(normal))
        if length == 0.0 or normal @ up <= 0.1 * length:
            raise UsageError(
                f"--floor {text}: the normal {direction} does not point up", f"give {what}"
            )
        normal = normal / length
    at = number("--floor", height, what) * unit if height else 0.0
    return at * float(normal @ up), normal


def parse_gravity(text: str | None, up: Floats) -> tuple[float, float, float]:
    """[m/s^2] of "9.81" (along minus up) or "x,y,z"."""
    parts = str(G0 if text is None else text).split(",")
    what = "9.81 (m/s^2, downward) or three numbers x,y,z"
    if len(parts) not in (1, 3):
        raise UsageError(f"--gravity is {text!r}", f"give {what}")
    values = np.array([number("--gravity", part, what) for part in parts])
    if np.abs(values).max() > STRONGEST:
        raise UsageError(f"--gravity is {text}", f"give up to {STRONGEST:g} m/s^2")
    g = -values[0] * up if len(values) == 1 else values
    return triple(g + 0.0)


def parse_range(text: str) -> tuple[float | None, float | None]:
    """Time codes of "10:20", "10:" or ":20"; None where the range is open.

    Raises UsageError for anything else.
    """
    first, colon, last = text.partition(":")
    try:
        low = float(first) if first.strip() else None
        high = float(last) if last.strip() else None
    except ValueError:
        low = high = np.nan
    finite = all(code is None or np.isfinite(code) for code in (low, high))
    ordered = low is None or high is None or low <= high
    if not (colon and finite and ordered):
        raise UsageError(f"--range is {text!r}", "give two time codes FIRST:LAST; 10: is open")
    return low, high
