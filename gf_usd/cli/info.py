"""gf-usd materials: the presets.

gf-usd inputs: every file that an asset depends on.

gf-usd schema-path: the folder of the schema library.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gf_usd.cli.options import LimitsOf
from gf_usd.core.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table


def materials(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
) -> None:
    """List the material presets.

    Dimensionless presets deform alike at any size: moduli are in units of rho g0 r and times in
    T = sqrt(r / g0), with r the radius of a ball of the body's volume and g0 = 9.81 m/s^2.
    """
    from gf_usd.core.materials.dimensionless import DIMENSIONLESS
    from gf_usd.core.materials.laws import LAWS
    from gf_usd.core.materials.physical import PHYSICAL

    if as_json:
        presets = [asdict(preset) for preset in DIMENSIONLESS.values()]
        physical = [asdict(p) for p in PHYSICAL.values()]
        out = {"looks": presets, "physical": physical, "laws": list(LAWS)}
        typer.echo(json.dumps(out, indent=1))
        return
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    dimensionless = (
        (m.name, m.mu, m.lam, m.density, m.damping, m.friction, m.restitution)
        for m in DIMENSIONLESS.values()
    )
    console.print(
        _table(
            "preset", "mu\n[rho g0 r]", "lambda\n[rho g0 r]", "density\n[kg/m^3]", "damping\n[T]",
            "friction", "restitution", rows=dimensionless,
        )
    )  # fmt: skip
    console.print()
    for m in DIMENSIONLESS.values():
        console.print(f"{m.name}: {m.note}{_own(m.law, m.parameters)}")
    console.print()
    physical = (
        (m.name, m.youngs_modulus, m.poissons_ratio, m.density, m.damping_time, m.friction,
         m.restitution)
        for m in PHYSICAL.values()
    )  # fmt: skip
    console.print(
        _table(
            "physical", "E\n[Pa]", "nu", "density\n[kg/m^3]", "damping\n[s]", "friction",
            "restitution", rows=physical,
        )
    )  # fmt: skip
    console.print()
    for p in PHYSICAL.values():
        console.print(f"{p.name}: {p.source}{_own(p.law, p.parameters)}")
    console.print()
    console.print(
        "restitution: of one contact sample on its spring. A body rebounds according to its damping"
        " time and its law: by 0.87 (rubber) and 0.97 (metal) of its speed for a ball that falls by"
        " three radii. The last line of a bake has the measured value."
    )
    console.print()
    console.print(f"laws: {', '.join(LAWS)} (--law)")


def _own(law: str, parameters: Mapping[str, float]) -> str:
    """A law's own parameters, in the units of the table above."""
    if not parameters:
        return ""
    return f" ({law}: {', '.join(f'{name} {value:g}' for name, value in parameters.items())})"


def _table(*heads: str, rows: Iterable[tuple[str | float, ...]]) -> Table:
    """A table of a name and numbers, narrow enough for a terminal of 80 columns."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    for head in heads:
        # As Text: rich takes a unit in brackets for a style, and leaves it out.
        table.add_column(Text(head), no_wrap=True, justify="left" if head == heads[0] else "right")
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.4g}" for value in row))
    return table


def inputs(
    assets: Annotated[list[Path], typer.Argument(help="Assets, or USD files with a material.")],
    limits: LimitsOf = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per line for each asset.")
    ] = False,
) -> None:
    """List every file of an asset with its SHA-256, for example to send them to a farm.

    The exit status is 3 if an asset cannot be read.
    """
    from gf_usd.system.sandbox import parse_limits, run_isolated

    most = parse_limits(limits)
    refused: InputError | None = None
    for path in assets:
        out: dict[str, Any] = {"asset": str(path)}
        try:
            found = run_isolated(path, "gf_usd.readers.inputs:read_inputs", most, path)
        except InputError as error:
            refused = error
            out |= {"error": error.message, "hint": error.hint}
            if not as_json:
                typer.echo(f"error: {error}", err=True)
        else:
            out |= {"files": [list(row) for row in found.files], "missing": list(found.missing)}
            if not as_json:
                typer.echo(f"{path}")
                for name, content in found.files:
                    typer.echo(f"  {content[:16]}  {name}")
                for name in found.missing:
                    typer.echo(f"  missing           {name}")
        if as_json:
            # flushed, so that the output shows at which asset a crash occurred
            typer.echo(json.dumps(out))
    if refused is not None:
        raise typer.Exit(refused.exit_status)


def schema_path() -> None:
    """Print the folder of the gaussianFlesh schema, for PXR_PLUGINPATH_NAME of other programs."""
    from gf_usd.system.usd_schema import schema_path as locate

    typer.echo(str(locate()))
