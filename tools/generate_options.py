"""Write the tables of options in docs/guide from the commands themselves.

    python tools/generate_options.py            write the tables
    python tools/generate_options.py --check    write nothing; exit 1 if a table is out of date

Each table is below the heading of its group, or of its command.  The last column, `more`, is
written by hand in the page and kept.
"""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.main

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from gf_usd.cli.main import program  # noqa: E402
from gf_usd.prepare.options.table import OPTIONS, WRITE  # noqa: E402

BAKE, INSPECT = (ROOT / "docs/guide" / name for name in ("options.md", "inspect-and-check.md"))
HEAD = ["| option | default | meaning | more |", "|---|---|---|---|"]
COLUMNS = HEAD[0].count("|") - 1
CODE = re.compile(r"(?<![\w`-])(--[a-z][a-z-]*|[\w.-]+[:=,][\w.][\w.:=,-]*\w)(?![\w`])")


def parameters(command: str) -> dict[str, Any]:
    """The options of a command by their names, without its asset."""
    known: Any = typer.main.get_command(program([command]))
    found = known.commands[command] if hasattr(known, "commands") else known
    return {p.name: p for p in found.params if p.param_type_name == "option" and p.name != "help"}


def coded(text: str) -> str:
    """Options in a text set as code, and nothing that ends a cell."""
    return CODE.sub(r"`\1`", text).replace("|", "\\|")


def spelling(parameter: Any) -> str:
    """`--output`, `-o`"""
    return ", ".join(f"`{word}`" for word in (*parameter.opts, *parameter.secondary_opts))


def default(parameter: Any) -> str:
    """The value where the option is not given."""
    if isinstance(parameter.show_default, str):
        return coded(parameter.show_default)
    if parameter.default in (None, (), []):
        return "-"
    return "off" if parameter.default is False else f"`{parameter.default}`"


def line(*cells: str) -> str:
    """A line of a table."""
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


def row(parameter: Any, kept: dict[str, str]) -> str:
    """The line of an option; kept : what its last column says, by its spelling."""
    name = spelling(parameter)
    return line(name, default(parameter), coded(parameter.help), kept.get(name, ""))


def bake_table(group: str, kept: dict[str, str]) -> list[str]:
    """The table of one group; what only the command line has stands with the last one."""
    options = parameters("bake").items()
    mine = [
        p for name, p in options if (OPTIONS[name].group if name in OPTIONS else WRITE) == group
    ]
    return HEAD + [row(parameter, kept) for parameter in mine]


def inspect_table(kept: dict[str, str]) -> list[str]:
    """Options as in bake in one line, by those that are missing; then those of inspect alone."""
    bake, options = parameters("bake"), parameters("inspect")
    missing = [p for name, p in bake.items() if name not in options and name in OPTIONS]
    names = f"those of `bake` without {', '.join(spelling(p) for p in missing)}"
    others = [p for name, p in options.items() if name not in bake or p.help != bake[name].help]
    return [
        *HEAD,
        line(names, "as for `bake`", "as for `bake`", kept.get(names, "[options.md](options.md)")),
        *(row(parameter, kept) for parameter in others),
    ]


def headings(page: Path) -> list[str]:
    """The headings of a page that have a table."""
    return list(dict.fromkeys(o.group for o in OPTIONS.values())) if page == BAKE else ["inspect"]


def renewed(text: str, page: Path) -> str:
    """The text of a page with all its tables of options written anew."""
    return "\n".join(_lines(text.split("\n"), page))


def _lines(lines: list[str], page: Path) -> Iterator[str]:
    wanted = headings(page)
    heading, at = "", 0
    while at < len(lines):
        line = lines[at]
        if line.startswith("## "):
            heading = line.removeprefix("## ").removeprefix("gf-usd ")
        if not (line.startswith("| option |") and heading in wanted):
            yield line
            at += 1
            continue
        end = next(k for k in range(at, len(lines)) if not lines[k].startswith("|"))
        cells = [re.split(r"(?<!\\)\|", old)[1:-1] for old in lines[at + 2 : end]]
        kept = {old[0].strip(): old[3].strip() for old in cells if len(old) == COLUMNS}
        yield from inspect_table(kept) if heading == "inspect" else bake_table(heading, kept)
        wanted.remove(heading)
        at = end
    if wanted:
        raise SystemExit(f"{page.name}: there is no table of options for {', '.join(wanted)}")


def main() -> int:
    """Write or check."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing, exit 1 on a difference"
    )
    check = parser.parse_args().check
    outdated = False
    for page in (BAKE, INSPECT):
        old = page.read_text("utf-8")
        new = renewed(old, page)
        outdated |= old != new
        if check:
            lines = difflib.unified_diff(
                old.splitlines(True), new.splitlines(True), page.name, "new"
            )
            sys.stdout.writelines(lines)
        else:
            page.write_text(new, "utf-8")
    return int(check and outdated)


if __name__ == "__main__":
    sys.exit(main())
