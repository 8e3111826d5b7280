"""gf-usd inputs: every file that an asset reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from gf_usd.cli.options import LimitsOf
from gf_usd.errors import InputError


def inputs(
    assets: Annotated[list[Path], typer.Argument(help="Assets, or USD files with a material.")],
    limits: LimitsOf = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on a line for each asset.")
    ] = False,
) -> None:
    """List every file that an asset is made of, with its SHA-256: what a farm has to be sent.

    Exit status 3 if one of them cannot be read.
    """
    from gf_usd.assets.inputs import read_inputs
    from gf_usd.isolation import attempt, parse_limits

    most = parse_limits(limits)
    refused: InputError | None = None
    for path in assets:
        out: dict[str, Any] = {"asset": str(path)}
        try:
            attempt(path, lambda path=path: read_inputs(path), most)
            found = read_inputs(path)
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
            # at once, so that whoever reads knows which asset a crash was at
            typer.echo(json.dumps(out))
    if refused is not None:
        raise typer.Exit(refused.exit_status)
