"""gf-usd verify: compares the solver with known solutions."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from gf_usd.core.errors import counted

if TYPE_CHECKING:
    from gf_usd.verify.case import Case, Result


def verify(
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Run only this case; repeatable.", show_default="all"),
    ] = None,
    full: Annotated[
        bool,
        typer.Option("--full", help="Run at higher resolution: half an hour instead of a minute."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
    device: Annotated[
        str, typer.Option(metavar="cpu|cuda", help="Compute on the CPU, or on a GPU with CUDA.")
    ] = "cpu",
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            show_default="one for each core, 1 on a GPU",
            help="Number of cases to run in parallel.",
        ),
    ] = None,
    show: Annotated[
        bool, typer.Option("--list", help="List the cases without running them.")
    ] = False,
) -> None:
    """Compare the solver with closed forms and published results.

    The exit status is 1 if any result is farther from its target than its bound.  The JSON and
    docs/verification.md give the reason for each bound.
    """
    from gf_usd.system.resources import cores
    from gf_usd.verify.case import rows
    from gf_usd.verify.registry import select
    from gf_usd.verify.registry import verify as run

    cases = select(case or ())
    if show:
        _list(cases, as_json)
        return
    processes = jobs or (cores() if device == "cpu" else 1)
    done = run(cases, full=full, device=device, processes=processes)
    results = list(_announced(done, len(cases)))
    table = [row for result in results for row in rows(result)]
    if as_json:
        typer.echo(json.dumps({"cases": table}, indent=1))
    else:
        _show(results)
    failed = sum(not row["pass"] for row in table)
    if failed:
        names = ", ".join(row["name"] for row in table if not row["pass"])
        typer.echo(f"{failed} of {counted(len(table), 'figure')} failed: {names}", err=True)
        raise typer.Exit(1)


def _announced(results: Iterable[Result], total: int) -> Iterator[Result]:
    """The results, with a line on stderr for each."""
    for done, result in enumerate(results, 1):
        verdict = "passed" if result.passed else "FAILED"
        typer.echo(f"{done}/{total} {result.case.name}: {verdict}", err=True)
        yield result


def _list(cases: Sequence[Case], as_json: bool) -> None:
    if as_json:
        out = [
            {"name": c.name, "what": c.what, "source": c.source, "full": c.full is not None}
            for c in cases
        ]
        typer.echo(json.dumps({"cases": out}, indent=1))
        return
    for c in cases:
        typer.echo(f"{c.name}: {c.what}\n  source: {c.source}")


def _show(results: Sequence[Result]) -> None:
    """One row a figure; wide, so that a pipe gets whole lines."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for head in ("case", "our figure", "target", "error", "bound", "verdict", "source"):
        number = head in ("our figure", "target", "error", "bound")
        table.add_column(head, no_wrap=head != "source", justify="right" if number else "left")
    for result in results:
        for m in result.measures:
            percent = m.kind == "relative"
            table.add_row(
                f"{result.case.name}.{m.name}",
                f"{m.value:.6g} {m.unit}".rstrip(),
                f"{'>= ' if m.kind == 'at least' else ''}{m.target:.6g}",
                f"{100.0 * m.error:.3g} %" if percent else f"{m.error:.3g}",
                f"{100.0 * m.bound:.3g} %" if percent else f"{m.bound:.3g}",
                "pass" if m.passed else "FAIL",
                result.case.source,
                style=None if m.passed else "red",
            )
    # rich leaves colors out of a pipe; without a width it would also fold the rows there.
    console = Console(markup=False, highlight=False, width=None if sys.stdout.isatty() else 200)
    console.print(table)
    seconds = sum(result.seconds for result in results)
    count = sum(len(result.measures) for result in results)
    console.print(
        f"{counted(count, 'figure')} of {counted(len(results), 'case')} in {seconds:.0f} s"
    )
