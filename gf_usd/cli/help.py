"""Help of commands that have many options: examples, groups, and expert options on request."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from gf_usd.cli.renamed import present
from gf_usd.cli.reset_options import without_reset_options
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options.option import Option
from gf_usd.prepare.options.table import OPTIONS

EXPERT = "Expert"
# Groups of the options in `gf-usd bake --help`; an option in none of them is an expert option.
GROUPS: dict[str, tuple[str, ...]] = {
    "Input": ("asset", "prims", "meters_per_unit", "up_axis", "start", "repair", "combine"),
    "Material": (
        *("material", "material_boxes", "material_labels", "blend_width", "conversions"),
        *("friction", "restitution", "damping_time"),
    ),
    "Motion": (
        "drop",
        "velocity",
        "spin",
        "gravity",
        "frames",
        "fps",
        "time_scale",
        "pins",
        "flesh",
    ),
    "Contact": ("floor", "colliders", "self_contact"),
    "Output": (
        *("output", "overwrite", "only", "flatten", "range", "samples_per_frame", "stress"),
        *("export_ply", "export_spz", "resume", "max_edge_length"),
    ),
    "Performance": ("particles", "spacing", "threads", "device", "max_hours"),
    "Report": ("dry_run", "quiet", "verbose", "as_json", "strict", "help", "help_all"),
}
GROUP_OF = {name: group for group, names in GROUPS.items() for name in names}
EXAMPLES: dict[str, tuple[tuple[str, str], ...]] = {
    "bake": (
        ("gf-usd bake duck.usda --material rubber", "drop a rubber duck"),
        ("gf-usd bake duck.usda --material rubber,jelly", "bake both, as variants"),
        ("gf-usd bake duck.usda --dry-run", "estimate the cost"),
        ("gf-usd bake duck.usda --drop 5r -o out/", "drop it from higher up"),
        ("gf-usd bake scan.obj --meters-per-unit 0.01 --repair", "bake a scan in centimeters"),
    ),
    "fit": (
        ("gf-usd fit ball.usda --target rebound=0.6", "fit the height of a rebound"),
        ("gf-usd fit bar.usda --target film.usda --drop 0", "fit tracked points"),
        ("gf-usd bake ball.usda --material ball.fit.usda", "bake with the result"),
    ),
    "preview": (
        ("gf-usd preview duck.rubber.usda -o duck.mp4", "make a film"),
        ("gf-usd preview duck.rubber.usda --sheet 9 -o sheet.png", "draw nine frames"),
    ),
}
# Forms of values for which a type is not sufficient.
METAVARS = {
    "material": "PRESET|FILE|auto", "output": "PATH", "prims": "PRIM", "up_axis": "Y|Z",
    "law": "LAW", "time_scale": "FACTOR|auto", "drop": "HEIGHT|3r", "gravity": "G|X,Y,Z",
    "max_edge_length": "LENGTH|auto",
    "floor": "HEIGHT|none|X,Y,Z", "pins": "REGION", "velocity": "X,Y,Z", "spin": "X,Y,Z",
    "colliders": "FILE", "conversions": "[WHERE=]PRESET@LIMIT", "material_boxes": "PRESET:BOX",
    "material_labels": "NAME=VALUE:PRESET", "range": "FIRST:LAST", "only": "SHAPES",
    "loop": "[N|auto]", "frames": "N|rest|rest:N", "fields": "FIELD", "rigid": "REGION",
    "material_sweep": "NAME=LOW:HIGH:N", "precision": "SHARE|LENGTH", "until": "[NAMES:]SHARE",
    "clamp": "LOW:HIGH|none", "stress_cap": "STRESS|none", "export_ply": "FOLDER",
    "export_spz": "FOLDER", "limits": "LIMITS|none",
}  # fmt: skip


def metavar(name: str, kind: type, choices: tuple[str, ...]) -> str | None:
    """How the value of an option is shown; None for a flag."""
    if kind is bool:
        return None
    if choices:
        return "|".join(choices)
    return METAVARS.get(name) or ("N" if kind is int else "X" if kind is float else "TEXT")


# Forms of the values of other options, by the name of their type.
PLACEHOLDERS = {"path": "PATH", "int": "N", "float": "X", "str": "TEXT", "bool": None}


# Typer's form of a default that is given as text, and of a limit after it.
DEFAULT_IN_WORDS = re.compile(r"\[default: \((.*)\)((?:; [^()]*)?)\]$")


class HelpfulCommand(TyperCommand):
    """A command whose help has examples, and options in groups where it has those of a bake."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        for param in self.params:
            if param.metavar is None and param.param_type_name == "argument":
                many = "..." if param.nargs == -1 else ""
                param.metavar = f"{param.name}{many}".upper()
            elif param.metavar is None and not getattr(param, "is_flag", False):
                param.metavar = PLACEHOLDERS.get(param.type.name.split()[0])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take back what has the value `default`, and insert the value of an option that may be
        given without one.
        """
        known = {flag for param in self.get_params(ctx) for flag in param.opts}
        args, reset = without_reset_options(self.name or "", present(self.name or "", args))
        of_folder = ctx.default_map or {}
        ctx.default_map = {k: v for k, v in of_folder.items() if k not in reset}
        left = super().parse_args(ctx, with_bare_values(args, known))
        self._refuse_nan(ctx)
        return left

    def _refuse_nan(self, ctx: Any) -> None:
        """The parser takes nan for a number in any range: no comparison with it is true."""
        for param in self.params:
            value = ctx.params.get(param.name)
            if in_range(param) and isinstance(value, float) and math.isnan(value):
                raise typer.BadParameter("nan is not a number", ctx=ctx, param=param)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The usage line, without the braces that typer puts around arguments."""
        pieces = super().collect_usage_pieces(ctx)
        return [word.replace("{", "").replace("}", "") for word in pieces]

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """The examples are between the description of a command and its options."""
        super().format_help_text(ctx, formatter)
        if examples := EXAMPLES.get(self.name or ""):
            with formatter.section("Examples"):
                formatter.write_dl(examples, col_max=60)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Options by group; expert options are only listed by name, unless --help-all is given."""
        params = self.get_params(ctx)
        grouped = "help_all" in {param.name for param in params}
        for group, rows in self._grouped(ctx, params) if grouped else self._plain(ctx, params):
            if group != EXPERT or ctx.meta.get(EXPERT):
                with formatter.section(group):
                    formatter.write_dl(rows)
            else:
                flags = sorted(row[0].split()[0].split("/")[0].rstrip(",") for row in rows)
                with formatter.section(f"{EXPERT} (gf-usd {self.name} --help-all explains them)"):
                    formatter.write_text(", ".join(flags))

    @staticmethod
    def _plain(ctx: Any, params: Any) -> Iterator[tuple[str, list[tuple[str, str]]]]:
        for head, kind in (("Arguments", "argument"), ("Options", "option")):
            mine = [p for p in params if p.param_type_name == kind]
            rows = [row for p in mine if (row := _row(p, ctx)) is not None]
            if rows:
                yield head, rows

    @staticmethod
    def _grouped(ctx: Any, params: Any) -> Iterator[tuple[str, list[tuple[str, str]]]]:
        for group in (*GROUPS, EXPERT):
            mine = [p for p in params if GROUP_OF.get(p.name, EXPERT) == group]
            order = GROUPS.get(group, ())
            mine.sort(key=lambda p: order.index(p.name) if p.name in order else len(order))
            rows = [row for p in mine if (row := _row(p, ctx)) is not None]
            if rows:
                yield group, rows


def in_range(param: Any) -> bool:
    """Whether the parser itself judges how large a number is: other code judges the rest."""
    return param.type.name == "float range"


def _row(param: Any, ctx: Any) -> tuple[str, str] | None:
    """A flag with its value, and its help; brackets around a default that is text are removed."""
    record = param.get_help_record(ctx)
    if record is None:
        return None
    flag, text = record
    return flag, DEFAULT_IN_WORDS.sub(r"[default: \1\2]", text)


def with_bare_values(arguments: Sequence[str], known: Collection[str]) -> list[str]:
    """The arguments, with the value of each option that is given alone; see `Option.bare`.

    known : flags of the command.  What follows such an option is its value where it can be one.
    """
    bare = {row.flag: row for row in OPTIONS.values() if row.bare and row.flag in known}
    out: list[str] = []
    for k, argument in enumerate(arguments):
        if argument == "--":
            return [*out, *arguments[k:]]
        out.append(argument)
        if argument in bare and not _is_value(bare[argument], arguments[k + 1 : k + 2]):
            out.append(bare[argument].bare)
    return out


def _is_value(option: Option, following: Sequence[str]) -> bool:
    try:
        return any(option.value(text) is not None for text in following)
    except UsageError:
        return False


def show_all(ctx: typer.Context, wanted: bool) -> None:
    """The callback of --help-all."""
    if wanted and not ctx.resilient_parsing:
        ctx.meta[EXPERT] = True
        typer.echo(ctx.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool,
    typer.Option(
        "--help-all",
        is_eager=True,
        callback=show_all,
        help="Show this page with the expert options, and exit.",
    ),
]
