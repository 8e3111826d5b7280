"""gf-usd fit: estimates material values from observations."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gf_usd.cli.quiet import QuietExceptJson
from gf_usd.core.errors import counted
from gf_usd.core.units import length_unit

if TYPE_CHECKING:
    from gf_usd.fitting.result import Estimate, FitResult, Reproduced

EVERY = 10  # simulations between two lines where stderr is no terminal


def fit(
    asset: Annotated[Path, typer.Argument(help="The asset file; it is never modified.")],
    *,
    target: Annotated[
        list[str] | None,
        typer.Option(
            "--target",
            "-t",
            metavar="FILE|NAME=VALUE",
            help="Observed motion or measurement; repeatable. A USD file with the motion of the"
            " asset's meshes or of tracked points, or a number: rebound=0.6, height=0.15@12 (at a"
            " time code), deflection=0.02:at=1,0,0 (of a point [stage units]). +-0.01 or +-2% after"
            " a value or a file gives its standard deviation.",
        ),
    ] = None,
    unknowns: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Values to find, separated by commas: E, nu, damping_time, density, friction,"
            " restitution, yield_stress, hardening.",
            show_default="E,nu,damping_time, and yield_stress for laws with plastic flow",
        ),
    ] = None,
    bounds: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="Search for a value between these bounds [SI]; repeatable.",
            show_default="for a modulus, 1.5 decades on either side of the material's value",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Layer with the material, for bake --material.",
            show_default="NAME.fit.usda in this folder",
        ),
    ] = None,
    picture: Annotated[
        str | None,
        typer.Option(
            metavar="PATH|none",
            help="Picture (.png) of the targets and the fit.",
            show_default="NAME.fit.png next to the layer",
        ),
    ] = None,
    evaluations: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|none",
            help="Folder that keeps the simulations, so that a repeated fit can reuse them.",
            show_default="NAME.fit.runs next to the layer",
        ),
    ] = None,
    max_minutes: Annotated[
        float, typer.Option(min=0.0, help="Stop the search after this time [min].")
    ] = 10.0,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            show_default="one for each core, 1 on a GPU",
            help="Number of simulations to run in parallel.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing layer and picture.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    quiet: QuietExceptJson = False,
    **options: Any,
) -> None:
    """Find the material values with which an asset reproduces observations.

    Varies the values until the simulated motion fits the targets, by least squares, and writes the
    values with their intervals as a layer. The output names values that the targets do not
    determine.
    """
    from gf_usd.api.materials import names_of, prepared_fit
    from gf_usd.fitting.fit import fit as run
    from gf_usd.system.sandbox import parse_limits

    options["limits"] = parse_limits(options["limits"])
    layer = output or Path(f"{asset.stem}.fit.usda")
    wanted = prepared_fit(
        asset,
        target or [],
        unknowns=names_of(unknowns),
        bounds=bounds or [],
        output=layer,
        picture=sibling(layer, picture, ".png"),
        evaluations=sibling(layer, evaluations, ".runs"),
        max_minutes=max_minutes,
        jobs=jobs,
        overwrite=overwrite,
        options=options,
    )
    with progress(shown=not quiet) as show:
        result = run(wanted, show)
    if as_json:
        typer.echo(json.dumps(result.as_json(), indent=1))
    if quiet:
        return
    for note in result.notes:
        typer.echo(f"note: {note}", err=True)
    if not as_json:
        show_result(result)


def sibling(layer: Path, option: str | None, suffix: str) -> Path | None:
    """The given path, None for "none", or that of the layer with another suffix."""
    if option is None:
        return layer.with_suffix(suffix)
    return None if option == "none" else Path(option)


@contextmanager
def progress(*, shown: bool) -> Iterator[Callable[[int, float], None]]:
    """Shows how many simulations there were and how good the best is, on stderr."""
    if not shown:
        yield lambda count, best: None
        return
    if not sys.stderr.isatty():
        last = 0

        def plain(count: int, best: float) -> None:
            nonlocal last
            if count >= last + EVERY:
                last = count
                typer.echo(described(count, best), err=True)

        yield plain
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading the asset", total=None)
        yield lambda count, best: bar.update(task, description=described(count, best))


def described(count: int, best: float) -> str:
    """The progress of a fit as text."""
    return f"{counted(count, 'simulation')}, best misfit {best:.3g} standard deviations"


def show_result(result: FitResult) -> None:
    """Tables of the values, of the targets and of sensitivities."""
    from rich.console import Console

    # rich leaves colors out of a pipe; without a width it would also fold the rows there.
    console = Console(markup=False, highlight=False, width=None if sys.stdout.isatty() else 200)
    console.print(_table(("value", "unit", "found", "95 %", "started at"), _values(result)))
    console.print()
    console.print(_table(("target", "unit", "observed", "fitted", "started at"), _targets(result)))
    console.print()
    names = [one.name for one in result.estimates]
    head = ("change of", "unit", *(f"{name} {change(name)}" for name in names))
    console.print(_table(head, [_sensitivity(one, names) for one in result.targets]))
    console.print()
    for sentence in result.not_identifiable:
        console.print(sentence, style="yellow")
    console.print(
        f"{counted(result.simulations, 'simulation')} of {result.particles} particles and"
        f" {counted(result.frames, 'frame')} ({result.read} more were kept)"
        f" in {result.seconds:.0f} s"
    )
    for path in (result.layer, result.picture):
        if path is not None:
            console.print(str(path))


def change(name: str) -> str:
    """The change that a sensitivity is given for."""
    from gf_usd.fitting.unknowns import RATIO_CHANGE

    ratio = name in ("poissons_ratio", "friction", "restitution")
    return f"+{RATIO_CHANGE:g}" if ratio else "+10 %"


def _values(result: FitResult) -> list[list[str]]:
    return [_value(one) for one in result.estimates]


def _value(one: Estimate) -> list[str]:
    interval = f"{one.low:.4g} to {one.high:.4g}" if one.identifiable else "not identifiable"
    return [one.name, one.unit, f"{one.value:.4g}", interval, f"{one.start:.4g}"]


def _targets(result: FitResult) -> list[list[str]]:
    return [
        [one.name, *_in_one_unit(one.unit, (one.target, one.fitted, one.start), 4)]
        for one in result.targets
    ]


def _sensitivity(one: Reproduced, names: Sequence[str]) -> list[str]:
    return [one.name, *_in_one_unit(one.unit, [one.sensitivity[name] for name in names], 3)]


def _in_one_unit(unit: str, values: Sequence[float], digits: int) -> list[str]:
    """The unit and the values in it; lengths are in the one that fits the largest."""
    scale = 1.0
    if unit == "m":
        scale, unit = length_unit(max(map(abs, values), default=0.0))
    return [unit, *(f"{scale * value:.{digits}g}" for value in values)]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for k, name in enumerate(head):
        table.add_column(name, no_wrap=True, justify="left" if k < 2 else "right")
    for row in rows:
        table.add_row(*row)
    return table
