"""gf-usd check: checks a USD file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gf_usd.cli.options import LimitsOf
from gf_usd.core.errors import counted, listed_paths

if TYPE_CHECKING:
    from gf_usd.layers.check.base import Skip


def check(
    file: Annotated[Path, typer.Argument(help="Any USD file.")],
    limits: LimitsOf = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
) -> None:
    """Validate a USD file with UsdValidation and additional rules; each finding has a fix.

    The exit status is 1 if there is an error, else 0. Warnings do not count, and neither do
    findings in the source of a bake, which are listed separately.
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
            severity = "" if finding.severity == "error" else f"{finding.severity}: "
            typer.echo(f"also in the source: {severity}{finding.rule} <{finding.prim_path}>")
            typer.echo(f"  {finding.message}\n  fix: {finding.fix}")
        for line in unchecked(result.skipped):
            typer.echo(line)
        for line in result.warned:
            typer.echo(f"note: {line}")
        theirs = ""
        for severity in ("error", "warning"):
            if count := sum(one.severity == severity for one in result.inherited):
                theirs += f", {counted(count, severity)} in the source"
        typer.echo(
            f"{file}: {counted(result.errors, 'error')}, {counted(result.warnings, 'warning')}"
            f"{theirs} ({counted(result.rules, 'rule')}, {counted(result.prims, 'prim')},"
            f" {counted(result.layers, 'layer')})"
        )
    if not result.ok:
        raise typer.Exit(1)


SHOWN = 3  # prims that a line names


def unchecked(skipped: Sequence[Skip]) -> list[str]:
    """A line for each rule that could not be applied, with its prims and the first one's reason."""
    lines = []
    for rule in dict.fromkeys(skip.rule for skip in skipped):
        mine = [skip for skip in skipped if skip.rule == rule]
        paths = list(dict.fromkeys(skip.prim_path for skip in mine))
        where = listed_paths(paths, SHOWN)
        if len(paths) > 1:
            where = f"of {len(paths)} prims, {where}"
        reasons = dict.fromkeys(skip.reason for skip in mine)
        others = len(reasons) - 1
        more = f" ({counted(others, 'other reason')}: --json lists all)" if others else ""
        lines.append(f"not checked: {rule} {where}: {next(iter(reasons))}{more}")
    return lines
