"""Output of ``batch`` while it runs: a table, lines, JSON, or Open Job Description messages."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import typer

from gf_usd.batch.board import Board, Row
from gf_usd.batch.job import NOT_FAILED
from gf_usd.core.errors import counted
from gf_usd.pipeline.cost.budget import duration, rough_duration

SHOWN = 12  # rows of a kind on the table
COLORS = {"done": "green", "kept": "dim", "running": "cyan", "waiting": "dim"}


class Voice(Protocol):
    """Receives every event, and None at intervals."""

    def __call__(self, event: dict[str, Any] | None) -> None: ...


@contextmanager
def voice(board: Board, *, as_json: bool, openjd: bool, quiet: bool) -> Iterator[Voice]:
    """The output for the events of a batch, which update the board first."""

    def handle(event: dict[str, Any] | None) -> None:
        row = None if event is None else board.handle(event)
        if event is None:
            return
        if as_json:
            typer.echo(json.dumps(event))
        if openjd:
            for line in openjd_lines(board, event, row):
                typer.echo(line)
        if not quiet:
            for line in plain_lines(board, event, row):
                typer.echo(line, err=True)

    if quiet or as_json or openjd or not sys.stderr.isatty():
        yield handle
        return
    from rich.console import Console
    from rich.live import Live

    with Live(
        table(board), console=Console(stderr=True), refresh_per_second=4, transient=True
    ) as live:

        def drawn(event: dict[str, Any] | None) -> None:
            row = None if event is None else board.handle(event)
            if event is not None and (
                event["event"] == "note"
                or (event["event"] == "finished" and event["state"] not in NOT_FAILED)
            ):
                for line in plain_lines(board, event, row):
                    live.console.print(line, markup=False, highlight=False)
            live.update(table(board))

        yield drawn


def plain_lines(board: Board, event: dict[str, Any], row: Row | None) -> list[str]:
    """Lines for a log: the end of every job, and every attempt but the first."""
    kind = event["event"]
    if kind == "note":
        return [f"note: {event['message']}"]
    if kind == "retry":
        return [f"{event['job']}: trying again: {event['why']}"]
    if kind != "finished" or row is None:
        return []
    at = f"[{len(board.ended)}/{len(board.rows)}]"
    left = board.left
    eta = (
        f", about {rough_duration(left)} left"
        if left and len(board.ended) < len(board.rows)
        else ""
    )
    if row.state == "kept":
        return [f"{at} {row.name}: kept"]
    if row.state == "done":
        speed = f", {row.frames_per_second:.3g} frames/s" if row.frames_per_second else ""
        return [f"{at} {row.name}: done in {row.seconds:.1f} s{speed}{eta}"]
    return [f"{at} {row.name}: {row.state}: {row.message.splitlines()[0]}{eta}"]


def openjd_lines(board: Board, event: dict[str, Any], row: Row | None) -> list[str]:
    """Progress and status as Open Job Description reads them from stdout."""
    if row is None or event["event"] not in ("started", "frame", "finished"):
        return []
    many = f"{len(board.ended)} of {len(board.rows)} done"
    text = row.state if event["event"] != "frame" else f"frame {row.done} of {row.total}"
    return [
        f"openjd_progress: {100.0 * board.share:.1f}",
        f"openjd_status: {many}; {row.name}: {text}",
    ]


def table(board: Board) -> Any:
    """The running and failed jobs, and the remaining time."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    rows = Table(box=None, pad_edge=False)
    rows.add_column("job", overflow="ellipsis", no_wrap=True, ratio=3)
    rows.add_column("state")
    for head in ("frames", "frames/s", "time", "left"):
        rows.add_column(head, justify="right")
    shown = [*board.failed[-SHOWN:], *board.of("done")[-3:], *board.of("running")[:SHOWN]]
    for row in shown:
        seconds = board.running_for(row) if row.state == "running" else row.seconds
        again = f" ({row.attempt})" if row.attempt > 1 else ""
        rows.add_row(
            Text(row.name),
            Text(row.state + again, style=COLORS.get(row.state, "bold red")),
            f"{row.done}/{row.total}" if row.total else "",
            f"{row.frames_per_second:.3g}" if row.frames_per_second else "",
            duration(seconds),
            rough_duration(row.left) if row.state == "running" and row.left is not None else "",
        )
    left = board.left
    line = (
        f"{len(board.ended)} of {counted(len(board.rows), 'job')}"
        + (f", {len(board.failed)} of them failed" if board.failed else "")
        + f", {len(board.of('running'))} running, {duration(board.seconds)}"
        + (f", about {rough_duration(left)} left" if left is not None else "")
    )
    return Group(rows, Text(line, style="bold"))
