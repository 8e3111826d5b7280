"""gf-usd materials: the presets."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table


def materials(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
) -> None:
    """Show the material presets.

    Looks are scale-free: moduli are in units of rho g0 r and times in T = sqrt(r / g0), with r the
    radius of a ball of the body's volume and g0 = 9.81 m/s^2, so that every size squashes alike.
    """
    from gf_usd.materials import LAW_TOKENS, LOOKS, PHYSICAL

    if as_json:
        looks = [asdict(look) for look in LOOKS.values()]
        physical = [asdict(p) for p in PHYSICAL.values()]
        out = {"looks": looks, "physical": physical, "laws": list(LAW_TOKENS)}
        typer.echo(json.dumps(out, indent=1))
        return
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    looks = (
        (m.name, m.mu, m.lam, m.density, m.damping, m.friction, m.restitution)
        for m in LOOKS.values()
    )
    console.print(
        _table(
            "look", "mu\n[rho g0 r]", "lambda\n[rho g0 r]", "density\n[kg/m^3]", "damping\n[T]",
            "friction", "restitution", rows=looks,
        )
    )  # fmt: skip
    console.print()
    for look in LOOKS.values():
        console.print(f"{look.name}: {look.note}")
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
        console.print(f"{p.name}: {p.source}")
    console.print()
    console.print(f"laws: {', '.join(LAW_TOKENS)} (--law)")


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
