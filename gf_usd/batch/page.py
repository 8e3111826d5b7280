"""The HTML page of a batch: every job with its picture, health and time, failures first.

Its pictures of results are drawn in separate processes and stored next to the results.
"""

from __future__ import annotations

import base64
import io
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path
from typing import Any

from PIL import Image

from gf_usd.batch.board import by_urgency
from gf_usd.batch.job import NOT_FAILED, STATES, Job, Outcome
from gf_usd.batch.plan import BatchPlan
from gf_usd.core import __version__
from gf_usd.core.errors import counted
from gf_usd.pipeline.cost.budget import duration
from gf_usd.system.atomic_files import publish_text
from gf_usd.system.file_locks import locked
from gf_usd.system.processes import Children
from gf_usd.system.resources import cores
from gf_usd.view.report.html import Html, join, policy, script, tag
from gf_usd.view.report.record import variant_of

# heading, whether it is a number, its meaning
COLUMNS = (
    ("", False, ""),
    ("job", False, "name under the batch's folder, and messages"),
    ("state", False, "how it ended"),
    ("warn\u00adings", True, "warnings of the bake"),
    ("redone", True, "frames recomputed with half the step"),
    ("inside out", True, "particles with J <= 0, summed over frames"),
    ("depth [spac\u00adings]", True, "deepest penetration of the floor, in spacings of particles"),
    (
        "energy gain",
        True,
        "largest unexplained energy gain in a frame, relative to the energy scale",
    ),
    ("par\u00adticles", True, "number of particles"),
    ("frames", True, "total of all variants"),
    ("frames /s", True, "between the first and the last frame"),
    ("time [s]", True, "total of all attempts"),
    ("CPU [s]", True, "total of all attempts"),
    ("mem. [MB]", True, "peak memory of the last attempt"),
    ("tries", True, "attempts"),
)


def write_page(path: Path, plan: BatchPlan, entry: Mapping[str, Any], *, pictures: bool) -> None:
    """Publish the page of a summary.  Raises BakeError where the file cannot be written.

    pictures : draw missing pictures first.
    """
    outcomes = [Outcome.of(row) for row in entry["jobs"]]
    roots = [Path(o.root) for o in outcomes if o.root and Path(o.root).is_file()]
    undrawn = draw(roots, at_once=cores()) if pictures else {}
    text = build_page(plan, outcomes, entry, undrawn)
    with locked(path):
        publish_text(path, text)


def build_page(
    plan: BatchPlan,
    outcomes: Sequence[Outcome],
    entry: Mapping[str, Any],
    undrawn: Mapping[Path, str],
) -> str:
    """The page as text, which loads no other file."""
    jobs = {job.name: job for job in plan.jobs}
    known = {outcome.job for outcome in outcomes}
    rows = by_urgency(outcomes)
    bad = [row for row in rows if row.state not in NOT_FAILED]
    unknown = [name for name in jobs if name not in known]
    folder = files("gf_usd.batch") / "page_parts"
    style = (folder / "page.css").read_text(encoding="utf-8")
    code = '(() => {\n"use strict";\n' + (folder / "page.js").read_text("utf-8") + "})();\n"
    head = join(
        [
            tag("meta", charset="utf-8"),
            tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
            tag("meta", http_equiv="Content-Security-Policy", content=policy([code])),
            tag("link", rel="icon", href="data:,"),
            tag("title", f"{plan.title}: {counted(len(outcomes), 'job')}"),
            Html(f"<style>{style}</style>"),
        ]
    )
    table = tag(
        "table",
        tag("thead", tag("tr", *(_head(*column) for column in COLUMNS))),
        tag("tbody", *(_row(row, jobs.get(row.job), undrawn) for row in rows)),
    )
    body = [
        _header(plan, rows, bad, unknown, entry),
        tag("main", _controls(rows), tag("div", table, class_="card")),
        tag(
            "footer",
            f"gf-usd {__version__}, {entry.get('finished', '')}. Results in {plan.out}.",
        ),
        script(code),
    ]
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{join(body)}</body></html>\n'


def _header(
    plan: BatchPlan,
    rows: Sequence[Outcome],
    bad: Sequence[Outcome],
    unknown: Sequence[str],
    entry: Mapping[str, Any],
) -> Html:
    cpu = sum(row.cpu_seconds for row in rows)
    good = [row for row in rows if row.good]
    begun = len(rows) - len(good) - len(bad)
    line = f"{counted(len(rows), 'job')}, {len(good)} good, {duration(cpu)} of CPU time"
    if entry.get("seconds"):
        line += f", {duration(float(entry['seconds']))} for the last run"
    parts = [tag("h1", plan.title), tag("div", line, class_="soft")]
    if bad or begun:
        texts = [_many(len(bad), "needs", "need", "attention")] if bad else []
        texts += [_many(begun, "has", "have", "remaining frames")] if begun else []
        lines = [tag("div", f"{'; '.join(texts)}. To repeat only these:")]
        lines.append(tag("code", str(entry.get("repeat") or "the same command"), class_="command"))
        parts.append(tag("div", *lines, class_="banner"))
    if unknown:
        names = ", ".join(unknown[:5]) + (", ..." if len(unknown) > 5 else "")
        have = f"{counted(len(unknown), 'job has', 'jobs have')} not been run yet: {names}"
        parts.append(tag("div", have, class_="banner"))
    return tag("header", *parts)


def _many(count: int, one: str, several: str, rest: str) -> str:
    return f"One job {one} {rest}" if count == 1 else f"{count} jobs {several} {rest}"


def _kind(outcome: Outcome) -> str:
    """The filter button to which an outcome belongs."""
    if not outcome.good:
        return "begun" if outcome.state in NOT_FAILED else "bad"
    return "warned" if outcome.warnings else "good"


def _controls(rows: Sequence[Outcome]) -> Html:
    found = Counter(map(_kind, rows))
    kinds = [
        ("all", f"all {len(rows)}"),
        ("bad", f"need attention {found['bad']}"),
        ("warned", f"with warnings {found['warned']}"),
        ("good", f"good {found['good']}"),
    ]
    if found["begun"]:
        kinds.insert(2, ("begun", f"with remaining frames {found['begun']}"))
    buttons = (
        tag("button", text, type="button", data_filter=kind, aria_pressed="false")
        for kind, text in kinds
    )
    search = tag("input", type="search", placeholder="name or message", aria_label="search")
    return tag("div", *buttons, search, tag("span", id="shown", class_="soft"), class_="bar")


def _head(text: str, number: bool, meaning: str) -> Html:
    inside = tag("button", text, type="button") if text else ""
    return tag("th", inside, scope="col", title=meaning, class_="number" if number else "text")


def _row(outcome: Outcome, job: Job | None, undrawn: Mapping[Path, str]) -> Html:
    health = outcome.health
    asset = job.asset.name if job else ""
    picture = data_uri(picture_of(Path(outcome.root))) if outcome.root else ""
    shown = tag("img", src=picture, alt=outcome.job, loading="lazy") if picture else None
    cells = [
        tag("td", shown or tag("div", class_="none")),
        tag(
            "td",
            outcome.job, tag("small", asset), tag("div", *_why(outcome, undrawn), class_="why"),
            class_="name", data_value=outcome.job,
        ),
        tag(
            "td",
            tag(
                "span", outcome.state, title=STATES.get(outcome.state, ""),
                class_=f"state {_kind(outcome)}",
            ),
            # failures come first where the column is sorted
            data_value=f"{len(STATES) - list(STATES).index(outcome.state):02d}",
        ),
        _number(len(outcome.warnings) if health else None, "{:d}"),
        _number(health.get("rollbacks"), "{:d}"),
        _number(health.get("inverted_particle_frames"), "{:d}"),
        _number(health.get("deepest_penetration_spacings"), "{:.2f}"),
        _number(health.get("energy_gain_max_share"), "{:.1e}"),
        _number(outcome.particles or None, "{:d}"),
        _number(outcome.frames or None, "{:d}"),
        _number(outcome.frames_per_second or None, "{:.3g}"),
        _number(outcome.seconds or None, "{:.1f}"),
        _number(outcome.cpu_seconds or None, "{:.1f}"),
        _number(outcome.peak_memory / 1e6 or None, "{:.0f}"),
        _number(outcome.attempts or None, "{:d}"),
    ]  # fmt: skip
    texts = [*(str(w.get("message", "")) for w in outcome.warnings), *outcome.bake_notes]
    searched = (outcome.job, asset, outcome.state, outcome.message, outcome.command, *texts)
    text = " ".join(searched).lower()
    return tag("tr", *cells, data_kind=_kind(outcome), data_text=text)


def _number(value: Any, form: str) -> Html:
    if value is None:
        return tag("td", "", class_="number", data_value="")
    text = form.format(value) if value else "0"  # 0.0e+00 says no more
    return tag("td", text, class_="number", data_value=repr(value))


def _why(outcome: Outcome, undrawn: Mapping[Path, str]) -> list[str]:
    parts: list[str] = []
    if outcome.message:
        parts.append(tag("p", outcome.message))
    if outcome.hint:
        parts.append(tag("p", outcome.hint, class_="hint"))
    for w in outcome.warnings:
        texts = f"{w.get('level', 'warning')}: {variant_of(w)}: {w.get('message', '')}"
        parts.append(tag("p", texts, class_="warning"))
        if w.get("hint"):
            parts.append(tag("p", w["hint"], class_="hint"))
    parts += [tag("p", note, class_="hint") for note in outcome.notes]
    shown, more = outcome.bake_notes[:SHOWN_NOTES], outcome.bake_notes[SHOWN_NOTES:]
    parts += [tag("p", f"note: {note}", class_="note") for note in shown]
    if more:
        rest = [tag("p", f"note: {note}", class_="note") for note in more]
        summary = tag("summary", counted(len(more), "more note", "more notes"))
        parts.append(tag("details", summary, *rest, class_="notes"))
    if (reason := undrawn.get(Path(outcome.root))) is not None:
        parts.append(tag("p", f"no image: {reason}", class_="hint"))
    inside = [tag("code", outcome.command, class_="command")]
    if outcome.log:
        inside.append(tag("pre", outcome.log))
    parts.append(tag("details", tag("summary", "command and log"), *inside))
    return parts


SHOWN_NOTES = 3  # of a bake; the others can be opened
AT_ONCE = 50  # pictures of one process: starting it takes as long as drawing ten
PATIENCE = 60.0  # [s] for one picture
QUALITY = 80  # of a JPEG on the page: a few kilobytes a job


def picture_of(root: Path) -> Path:
    """``duck.rubber.usda`` -> ``duck.rubber.png``."""
    return root.with_suffix(".png")


def draw(roots: Sequence[Path], *, at_once: int) -> dict[Path, str]:
    """Draw results that have no current picture; returns the reasons of those that failed."""
    todo = [root for root in roots if not _is_new(root)]
    share = max(1, min(AT_ONCE, -(-len(todo) // at_once)))
    groups = [todo[i : i + share] for i in range(0, len(todo), share)]
    failed: dict[Path, str] = {}
    children = Children()
    with ThreadPoolExecutor(max_workers=at_once) as pool:
        try:
            for found in pool.map(lambda group: _draw_some(children, group), groups):
                failed.update(found)
        finally:
            # an interrupt does not wait for the rest
            children.stop()
    return failed


def _is_new(root: Path) -> bool:
    try:
        return picture_of(root).stat().st_mtime_ns >= root.stat().st_mtime_ns
    except OSError:
        return False


def _draw_some(children: Children, roots: Sequence[Path]) -> dict[Path, str]:
    failed, left = dict[Path, str](), list(roots)
    while left:
        command = [sys.executable, "-m", "gf_usd", "thumbnails", *map(str, left)]
        ended = children.run(command, lambda line: None, timeout=PATIENCE + len(left))
        if ended is None or ended.stopped:
            break
        for line in ended.out[: ended.out.rfind("\n") + 1].splitlines():
            row = json.loads(line)
            root = Path(row["root"])
            left.remove(root)
            if "error" in row:
                failed[root] = row["error"]
        if left:
            # the result that it crashed on; another process draws the others
            failed[left.pop(0)] = f"rendering ended with status {ended.status}"
    return failed


def data_uri(picture: Path) -> str:
    """A picture as a JPEG data URI; "" where there is none that can be read."""
    out = io.BytesIO()
    try:
        with Image.open(picture) as image:
            image.convert("RGB").save(out, "JPEG", quality=QUALITY)
    except (OSError, ValueError, SyntaxError):
        return ""
    return "data:image/jpeg;base64," + base64.b64encode(out.getvalue()).decode("ascii")
