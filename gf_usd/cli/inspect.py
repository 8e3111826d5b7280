"""gf-usd inspect: reports what would be baked, and defects of the asset."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from gf_usd.cli.help import HelpAll
from gf_usd.core.errors import InputError


def inspect(
    asset: Annotated[Path, typer.Argument(help="The asset file; nothing is written.")],
    *,
    repair: Annotated[
        bool, typer.Option("--repair", help="Show what bake --repair would do.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
    help_all: HelpAll = False,
    **options: Any,
) -> None:
    """Report on an asset before a bake: meshes, holes, units, thin parts, time, memory and disk.

    It takes the options of bake, except for those on how the results are named and written.
    The exit status is 0 if the asset can be baked, 3 if bake would refuse it, with the
    same message.
    """
    from gf_usd.cli.console import progress
    from gf_usd.pipeline.inspect import inspect as inspect_asset
    from gf_usd.system.sandbox import parse_limits

    options["limits"] = parse_limits(options["limits"])
    shown = sys.stderr.isatty() and not as_json
    try:
        with progress(shown=shown, stays=False) as show:
            seen = inspect_asset(asset, repair=repair, watch=show, **options)
    except InputError as error:
        if as_json:
            out = {"file": str(asset), "bakeable": False}
            out["refusal"] = {"message": error.message, "hint": error.hint}
            typer.echo(json.dumps(out, indent=1))
        raise
    if as_json:
        typer.echo(json.dumps(seen.as_json(), indent=1))
    else:
        from gf_usd.cli.inspect_page import show

        show(seen)
    if seen.refusal is not None:
        raise seen.refusal
