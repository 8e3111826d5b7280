"""gf-usd materials: the presets."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer


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
    from rich.table import Table

    table = Table("look", "mu [rho g0 r]", "lambda [rho g0 r]", "density [kg/m^3]",
                  "damping [T]", "friction", "restitution", "what it does")  # fmt: skip
    for look in LOOKS.values():
        table.add_row(
            look.name, f"{look.mu:g}", f"{look.lam:g}", f"{look.density:g}",
            f"{look.damping:g}", f"{look.friction:g}", f"{look.restitution:g}", look.note,
        )  # fmt: skip
    absolute = Table("physical", "E [Pa]", "nu", "density [kg/m^3]", "damping [s]", "source")
    for p in PHYSICAL.values():
        absolute.add_row(
            p.name, f"{p.youngs_modulus:.3g}", f"{p.poissons_ratio:g}", f"{p.density:g}",
            f"{p.damping_time:g}", p.source,
        )  # fmt: skip
    console = Console()
    console.print(table)
    console.print(absolute)
    console.print(f"laws: {', '.join(LAW_TOKENS)} (--law)")
