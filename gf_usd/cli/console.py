"""Output of ``bake``: the plan, the progress, the summary."""

from __future__ import annotations

import json
import sys
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from gf_usd.core.errors import counted
from gf_usd.core.units import bytes_text, code_text, length_text, volume_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from gf_usd.pipeline.cost.forecast import Activity
    from gf_usd.pipeline.prepared import Prepared
    from gf_usd.pipeline.result import BakeResult, VariantResult
    from gf_usd.prepare.plan import Plan


COARSE = "coarse-mesh"
TOUCHES = 1e-3  # [spacings] from the floor: a body this near rests on it


def show_plan(
    prepared: Prepared, *, max_hours: float, as_json: bool = False, err: bool = False
) -> None:
    """Print the plan and its estimated cost; max_hours : the limit of `run`."""
    from gf_usd.prepare.plan import describe

    d = {**describe(prepared.plan), **prepared.cost}
    if as_json:
        typer.echo(json.dumps(d, indent=1))
        return
    drop = drop_of(prepared.plan, length_text(d["drop_m"]), "none")
    too_long = d["estimated_seconds"] > 3600.0 * max_hours
    lines = [
        f"{d['source']}: {counted(len(d['bodies']), 'mesh', 'meshes')},"
        f" {volume_text(d['volume_m3'])}, radius {length_text(d['radius_m'])}",
        *(f"  {path}" for path in d["bodies"]),
        f"particles   {d['particles']}, {length_text(d['spacing_m'])} apart",
        f"frames      {frames_of(d)} at {d['fps']:g} fps from time code {code_text(d['start'])}",
        "substeps    "
        + ", ".join(f"{n} per frame ({variant})" for variant, n in d["substeps_per_frame"].items()),
        f"drop        {drop}, {landing_of(prepared.plan, d)}",
        f"time        {time_of(d)}"
        + (f": refused because it is more than --max-hours {max_hours:g}" if too_long else ""),
        f"memory      about {bytes_text(d['estimated_memory_bytes'])}",
        f"disk        {disk_of(d)}",
        *(f"would write {path}" for path in d["outputs"]),
        *(_note_line(prepared.plan, note) for note in (*d["notes"], *prepared.shortcuts)),
    ]
    typer.echo("\n".join(lines), err=err)


def drops(plan: Plan) -> bool:
    """Whether a body falls onto a floor; bodies held by bones or pins do if they were lifted."""
    held = plan.held or plan.goals is not None
    return plan.settings.floor is not None and (any(plan.settings.lift) or not held)


def drop_of(plan: Plan, text: str, none: str) -> str:
    """The text of a drop, or that there is none, and where the bodies are then."""
    if not drops(plan):
        return none
    if plan.drop > TOUCHES * plan.particles.spacing:
        return text
    deep = plan.drop < -TOUCHES * plan.particles.spacing
    return f"{none}: it starts {'in' if deep else 'on'} the floor"


def landing_of(plan: Plan, cost: Mapping[str, Any]) -> str:
    """When the body first touches the floor, by the estimate of its cost."""
    from gf_usd.pipeline.prepared import reason_not_free_fall

    if more := reason_not_free_fall(plan):
        return f"first contact is not estimated with {more}"
    frame = cost["first_contact_frame"]
    return "no contact with a floor" if frame is None else f"first contact at frame {frame}"


def announce(prepared: Prepared) -> None:
    """Print one line with the estimated cost on stderr, and the notes."""
    plan, cost = prepared.plan, prepared.cost
    substeps = cost["substeps_per_frame"]
    each = ", ".join(
        f"{n} ({variant})" if len(substeps) > 1 else f"{n}" for variant, n in substeps.items()
    )
    for note in (*plan.notes, *prepared.shortcuts):
        typer.echo(_note_line(plan, note), err=True)
    forecast = {"frames": plan.settings.frames, **cost}
    first = plan.settings.first
    lead = f" (the first {first} are pre-roll and are not written)" if first > 0 else ""
    typer.echo(
        f"{len(plan.particles)} particles, {frames_of(forecast)}{lead}, {each} substeps per frame:"
        f" {time_of(forecast)}, {disk_of(forecast)}",
        err=True,
    )


def frames_of(forecast: Mapping[str, Any]) -> str:
    """The number of simulated frames as text; forecast : its limit, and the cost of the plan."""
    frames = forecast["frames"]
    if not forecast["ends_early"]:
        return counted(frames, "frame")
    if forecast["usual_frames"] >= frames:
        return f"at most {counted(frames, 'frame')}"
    return f"at most {frames} frames (usually about {forecast['usual_frames']})"


def time_of(forecast: Mapping[str, Any]) -> str:
    """The duration of a bake as text; forecast : as of `frames_of`."""
    from gf_usd.pipeline.cost.budget import rough_duration, rough_range

    whole, usual, most, usual_most = (
        forecast[name]
        for name in ("estimated_seconds", "usual_seconds", "most_seconds", "usual_most_seconds")
    )
    if not forecast["ends_early"] or rough_duration(whole) == rough_duration(usual):
        return f"about {rough_range(whole, most)}"
    about = rough_range(usual, usual_most)
    longest = rough_duration(whole if about == rough_duration(usual) else most)
    return f"about {about}, at most {longest}"


def _note_line(plan: Plan, note: str) -> str:
    """A note as a line; an implausible size or density is a warning, as in `inspect`."""
    from gf_usd.prepare.asset_size import implausible_size

    odd = note in (implausible_size(plan.asset), plan.heavy)
    return f"{'warning' if odd else 'note'}: {note}"


def disk_of(forecast: Mapping[str, Any]) -> str:
    """The size of the files as text; forecast : as of `frames_of`."""
    limit = "at most" if forecast["ends_early"] else "about"
    return f"{limit} {bytes_text(forecast['estimated_bytes'])}"


EVERY = 30.0  # [s] between plain lines, at most
PATIENCE = 5.0  # [s] before reading or filling is worth a line
STEP = 0.1  # of the frames between plain lines, at most
COMPILES = " (or loading them from the cache, once a bake with the same laws has compiled them)"


@contextmanager
def progress(*, shown: bool, stays: bool = True) -> Iterator[Spent]:
    """What shows the activities of a bake on stderr: a bar on a terminal, plain lines elsewhere.

    stays : the bar is left on the terminal at the end.
    """
    if not shown:
        yield Spent(lambda now: None)
    elif sys.stderr.isatty():
        with _bar(stays=stays) as show:
            yield Spent(show)
    else:
        lines = Lines(lambda line: typer.echo(line, err=True))
        with _ticking(lines.tick):
            yield Spent(lines)


@contextmanager
def _ticking(tick: Callable[[], None]) -> Iterator[None]:
    """Call `tick` once a second from a thread."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(1.0):
            tick()

    thread = threading.Thread(target=run, name="gf-usd progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Spent:
    """Passes activities on, and measures the time of each stage.

    show : displays them; clock : [s].
    """

    def __init__(
        self, show: Callable[[Activity], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._show, self._clock = show, clock
        self._stage, self._since = "", clock()
        self._seconds: dict[str, float] = {}

    def __call__(self, now: Activity) -> None:
        """The bake is at this."""
        if now.stage != self._stage:
            self._count()
            self._stage = now.stage
        self._show(now)

    def _count(self) -> None:
        at = self._clock()
        if self._stage:
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + at - self._since
        self._since = at

    def text(self) -> str:
        """The seconds so far, and those of each stage."""
        self._count()
        each = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in self._seconds.items())
        return f"{sum(self._seconds.values()):.1f} s: {each}"


class Lines:
    """A plain line for each stage, and one every tenth of the frames or EVERY seconds.

    Before the plan is printed, a stage gets a line only if it takes PATIENCE seconds.
    say : takes a line; clock : [s].
    """

    def __init__(
        self, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._clock = say, clock
        self._stage = ""
        self._now: Activity | None = None
        self._at, self._done, self._wait = clock(), 0, EVERY
        self._compiled = False

    def __call__(self, now: Activity) -> None:
        """The bake is at this."""
        from gf_usd.pipeline.cost.forecast import COMPILING, FILLING, READING

        if now.stage == COMPILING:
            if not self._compiled:
                self._compiled = True
                self._say(f"{COMPILING}{COMPILES}")
            return
        stage = f"{now.stage} {now.what}".rstrip()
        whole = now.total > 0 and now.done == now.total
        far = now.done - self._done >= STEP * max(1, now.total)
        new = stage != self._stage
        before, self._now, self._stage = self._now, now, stage
        if new and now.stage in (READING, FILLING):
            if before is None or before.stage != now.stage:  # not at another step of it
                self._at, self._wait = self._clock(), PATIENCE
        elif new or (now.done > self._done and (far or whole)):
            self._tell(now)

    def tick(self) -> None:
        """Called regularly: repeats the message of a long stage."""
        if self._now is not None and self._clock() - self._at >= self._wait:
            self._tell(self._now)

    def _tell(self, now: Activity) -> None:
        self._at, self._done, self._wait = self._clock(), now.done, EVERY
        self._say(self._stage + _frames(now))


def _frames(now: Activity) -> str:
    """The progress as text."""
    from gf_usd.pipeline.cost.forecast import SIMULATING

    if now.stage != SIMULATING or not now.done:
        return ""
    return f": {_counted(now)}{_left(now.left, ends_early=now.ends_early)}"


def _counted(now: Activity) -> str:
    if now.ends_early:
        return f"frame {now.done} of at most {now.total}"
    return f"frame {now.done}/{now.total}"


def _left(seconds: float | None, *, ends_early: bool) -> str:
    from gf_usd.pipeline.cost.budget import rough_duration

    if seconds is None:
        return ""
    return f", {'at most' if ends_early else 'about'} {rough_duration(seconds)} left"


@contextmanager
def _bar(*, stays: bool) -> Iterator[Callable[[Activity], None]]:
    """A bar of the time that a bake takes, which moves between frames as well."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Left(ProgressColumn):
        """The time that is left, counted down since it was last known."""

        def render(self, task: Any) -> Text:
            ends = task.fields["ends"]
            if ends is None:
                return Text("")
            left = max(0.0, ends - time.monotonic())
            whole = left + (task.elapsed or 0.0)
            # It never runs backwards, however the estimate changes.
            share = max(task.fields["share"], (task.elapsed or 0.0) / max(whole, 1e-9))
            task.fields["share"] = share
            task.total, task.completed = 1.0, share
            early = task.fields["ends_early"]
            return Text(_left(left, ends_early=early).removeprefix(", "))

    columns = (
        TextColumn("{task.description}"), Left(), BarColumn(), TextColumn("{task.fields[frames]}"),
        TimeElapsedColumn(),
    )  # fmt: skip
    bar = Progress(
        *columns, console=Console(stderr=True), redirect_stdout=False, refresh_per_second=4,
        transient=not stays,
    )  # fmt: skip
    with bar:
        task = bar.add_task("", total=None, frames="", ends=None, share=0.0, ends_early=False)

        def show(now: Activity) -> None:
            from gf_usd.pipeline.cost.forecast import COMPILING

            ends = None if now.left is None else time.monotonic() + now.left
            frames = _counted(now) if now.total else ""
            what = "(once)" if now.stage == COMPILING else now.what
            description = f"{now.stage} {what}".rstrip()
            bar.update(
                task, description=description, ends=ends, frames=frames, ends_early=now.ends_early
            )

        yield show


def summarize(result: BakeResult, plan: Plan, spent: str) -> None:
    """Print the files, their sizes, the measured values, and notes of the run.

    spent : the seconds of its stages, as text.
    """
    clips = [clip for bake in result.bakes for clip in bake.clips]
    files = [path for path in result.outputs if path.exists() and path not in clips]
    lines = [f"{path}  {bytes_text(path.stat().st_size)}" for path in files]
    for folder in dict.fromkeys(clip.parent for clip in clips):
        sizes = [clip.stat().st_size for clip in clips if clip.parent == folder]
        lines.append(f"{folder}/  {counted(len(sizes), 'file')}, {bytes_text(sum(sizes))}")
    lines.append(f"{result.particles} particles, {spent}")
    lines += [f"note: {note}" for note in result.notes if note not in plan.notes]
    for bake in result.bakes:
        lines.append(_measured(bake))
        if bake.certificate is not None:
            lines += [f"{bake.variant}: {line}" for line in bake.certificate.lines()]
        lines += [
            f"warning: {bake.variant}: {c.message} [{c.about}]\n  hint: {c.hint}"
            for c in bake.warnings
            if c.message not in plan.notes  # shown as warnings before the bake
            and not (c.about == COARSE and _is_noted(bake.health["outside_meshes"], plan))
        ]
    lines += [
        f"check: {f['rule']} <{f['prim']}>: {f['message']}\n  fix: {f['fix']}"
        for f in result.findings
    ]
    typer.echo("\n".join(lines))


def _is_noted(meshes: Sequence[str] | None, plan: Plan) -> bool:
    """Whether the plan has a note on all meshes of a warning on coarse ones, which then repeats it.

    The warning counts cages as well, which have a note of another kind, and is not of meshes that
    begin to flow.
    """
    return bool(meshes) and set(plan.coarse).issuperset(meshes)


def _measured(bake: VariantResult) -> str:
    from gf_usd.pipeline.measures.rest import at_rest

    h = bake.health
    rebound = "no rebound" if h["restitution"] is None else f"restitution {h['restitution']:.2f}"
    overlap = h["deepest_overlap_spacings"]
    met = f", deepest overlap {overlap:.2f} spacings" if overlap else ""
    redone = f", {counted(h['rollbacks'], 'frame')} recomputed" if h["rollbacks"] else ""
    rested = at_rest(bake.at_rest, h) if bake.at_rest else ""
    rest = f", {rested}" if rested else ""
    return (
        f"{bake.variant}: {counted(bake.frames, 'frame')}{rest},"
        f" {counted(h['substeps'], 'substep')}{redone}, {rebound},"
        f" deepest penetration {h['deepest_penetration_spacings']:.2f} spacings"
        f" ({length_text(h['deepest_penetration_m'])}){met}, volume ratio J {h['min_J']:.2f} to"
        f" {h['max_J']:.2f}"
    )
