"""gf-usd check: is this file sound?"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli.options import LimitsOf


def check(
    file: Annotated[Path, typer.Argument(help="Any USD file.")],
    limits: LimitsOf = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
) -> None:
    """Validate a USD file with UsdValidation and additional rules; each finding has a fix.

    The exit status is 1 if there is an error, else 0. Warnings do not count, and neither do errors
    in the source of a bake, which are listed separately.
    """
    from gf_usd.system.sandbox import parse_limits, run_isolated

    result = run_isolated(file, "gf_usd.layers.check.run:check_file", parse_limits(limits), file)
    if as_json:
        out = {
            "file": str(file),
            "ok": result.ok,
            "rules": result.rules,
            "prims": result.prims,
            "layers": result.layers,
            "findings": [asdict(f) for f in result.findings],
            "inherited": [asdict(f) for f in result.inherited],
            "usd_warnings": list(result.warned),
            "skipped": [asdict(s) for s in result.skipped],
        }
        typer.echo(json.dumps(out, indent=1))
    else:
        for finding in result.findings:
            typer.echo(f"{finding.severity}: {finding.rule} <{finding.prim_path}>")
            typer.echo(f"  {finding.message}\n  fix: {finding.fix}")
        for finding in result.inherited:
            typer.echo(f"also in the source: {finding.rule} <{finding.prim_path}>")
            typer.echo(f"  {finding.message}\n  fix: {finding.fix}")
        for skip in result.skipped:
            typer.echo(f"not checked: {skip.rule} <{skip.prim_path}>: {skip.reason}")
        for line in result.warned:
            typer.echo(f"note: {line}")
        theirs = f", {len(result.inherited)} errors in the source" if result.inherited else ""
        typer.echo(
            f"{file}: {result.errors} errors, {result.warnings} warnings{theirs}"
            f" ({result.rules} rules, {result.prims} prims, {result.layers} layers)"
        )
    if not result.ok:
        raise typer.Exit(1)
