"""Write docs/api.md, the reference of `import gf_usd`, from docstrings and the table of options.

python tools/generate_api.py            write the page
python tools/generate_api.py --check    write nothing; exit 1 if the page is out of date
"""

from __future__ import annotations

import argparse
import ast
import difflib
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import gf_usd  # noqa: E402
from gf_usd.api.call import BAKE  # noqa: E402
from gf_usd.prepare.options.table import OPTIONS  # noqa: E402

PAGE = ROOT / "docs" / "api.md"
GROUPS = {
    "Bake": ("bake", "BakeResult", "VariantResult", "HealthWarning", "Material", "materials"),
    "Inspect and check": ("inspect", "Inspection", "check", "CheckResult", "Finding"),
    "Read a bake": ("read", "Bake", "BakeFrame", "Health", "Settings"),
    "Pictures and reports": ("preview", "Preview", "report"),
    "Compare": ("compare", "Comparison"),
    "Deliver": ("deliver", "Delivered", "DeliveredBody", "DeliveredSplats", "retime", "Retimed"),
    "Fit a material": ("fit", "FitResult", "Estimate", "Reproduced"),
    "Simulate without a file": ("Scene", "simulate", "Simulation", "SimulationFrame"),
    "Errors": ("GfUsdError", "UsageError", "InputError", "BakeError", "SolverError", "Unfinished",
               "UnhealthyError"),
}  # fmt: skip
OF_ASSET = ("bake", "inspect")  # their keywords are the table of options
# Defaults that differ from those of the command line, and what Python raises where a command exits.
DEFAULTS = {"limits": "none: this process reads the file"}
RAISED = {"(status 4)": "(raises UnhealthyError)", "(status 5)": "(raises Unfinished)"}
HEAD = """<!-- Written by tools/generate_api.py from the docstrings: do not edit. -->

# Python reference

Everything here is available after `import gf_usd`. Lengths, masses and times are in SI
unless stage units are stated. The [guide](guide/python.md) introduces the functions and lists
the values that keywords take; the examples below run as tests.
"""
SECTION = re.compile(r"\n([A-Z]\w+)\n-{3,}\n")
ENTRY = re.compile(r"^(\S.*?) : ", re.MULTILINE)
EXAMPLE = re.compile(r"(?:^>>> .*\n(?:.+\n)*)+", re.MULTILINE)


def page() -> str:
    """The whole page."""
    parts = [HEAD, *(f"- [{group}](#{anchor(group)})" for group in GROUPS)]
    for group, names in GROUPS.items():
        parts += [f"\n## {group}"]
        for name in names:
            parts += ["", *described(name)]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)).rstrip() + "\n"


def anchor(heading: str) -> str:
    """What a heading is linked by."""
    return heading.lower().replace(" ", "-")


def described(name: str) -> Iterator[str]:
    """The lines of one public name."""
    made = getattr(gf_usd, name)
    if inspect.isclass(made):
        yield f"### class `{name}`"
        if name == "Scene":
            yield from ["", *code(f"{name}{signature(made)}")]
        yield from ["", *markdown(own_docstring(made))]
        yield from members(made)
        return
    yield f"### `{name}`"
    shown = "(path, *, ...)" if name in OF_ASSET else signature(made)
    yield from ["", *code(f"gf_usd.{name}{shown}"), "", *markdown(inspect.getdoc(made) or "")]
    if name == "bake":
        yield from ["", "All keywords; `inspect` takes them as well:", "", *option_table()]


def signature(made: Any) -> str:
    """Parameters with their defaults, without their types, folded."""
    known = inspect.signature(made)
    bare = [p.replace(annotation=p.empty) for p in known.parameters.values() if p.name != "self"]
    return str(known.replace(parameters=bare, return_annotation=known.empty))


def code(text: str) -> list[str]:
    """A block of Python."""
    folded = textwrap.fill(
        text, 96, subsequent_indent="    ", break_on_hyphens=False, break_long_words=False
    )
    return ["```python", folded, "```"]


def own_docstring(made: type) -> str:
    """Of a class, without what `dataclass` writes where there is none."""
    text = inspect.getdoc(made) or ""
    return "" if text.startswith(f"{made.__name__}(") else text


def markdown(text: str) -> Iterator[str]:
    """A docstring as Markdown: sections in bold, their entries as a list, examples as blocks."""
    pieces = SECTION.split(f"{text}\n")
    yield from prose(pieces[0])
    for title, body in zip(pieces[1::2], pieces[2::2]):
        yield from ["", f"**{title}**", "", *entries(body)]


def prose(text: str) -> Iterator[str]:
    """Paragraphs and examples."""
    at = 0
    for found in EXAMPLE.finditer(text):
        yield from paragraphs(text[at : found.start()])
        yield from ["```python", found[0].rstrip(), "```", ""]
        at = found.end()
    yield from paragraphs(text[at:], last=True)


def paragraphs(text: str, *, last: bool = False) -> Iterator[str]:
    """Text in lines as they are; entries among it become a list."""
    blocks = [block for block in text.strip().split("\n\n") if block.strip()]
    for number, block in enumerate(blocks):
        lines = list(entries(block)) if ENTRY.match(block) else [plain(block)]
        yield from lines
        if not (last and number == len(blocks) - 1):
            yield ""


def entries(text: str) -> Iterator[str]:
    """`name : text` as a list."""
    for block in re.split(r"\n(?=\S|\n)", text.strip()):
        if block.startswith("\n"):
            yield ""
        joined = " ".join(line.strip() for line in block.splitlines())
        found = ENTRY.match(joined)
        if found is None:
            yield plain(joined)
            continue
        names = ", ".join(f"`{name}`" for name in found[1].split(", "))
        yield f"- {names}: {plain(joined[found.end() :])}"


def plain(text: str) -> str:
    """Double backticks are code as single ones are; names within an entry are code as well."""
    return re.sub(r"; (\w+) : ", r"; `\1`: ", text.strip().replace("``", "`"))


def members(made: type) -> Iterator[str]:
    """Fields, properties and methods of a class."""
    rows = [*field_rows(made), *property_rows(made)]
    if rows:
        yield from ["", "| attribute | meaning |", "|---|---|"]
        yield from (f"| `{name}` | {cell(text)} |" for name, text in rows)
    for name, method in vars(made).items():
        if name.startswith("_") or not inspect.isfunction(method):
            continue
        if not inspect.getdoc(method):
            continue
        yield from ["", f"#### `{made.__name__}.{name}`", ""]
        yield from [*code(f"{name}{signature(method)}"), ""]
        yield from markdown(inspect.getdoc(method) or "")


def cell(text: str) -> str:
    """The text of a cell of a table."""
    return plain(text).replace("\n", " ").replace("|", "\\|")


def field_rows(made: type) -> Iterator[tuple[str, str]]:
    """Fields of a dataclass with the comments next to them; attributes set by `__init__`."""
    comments = commented(made)
    if is_dataclass(made):
        for one in fields(made):
            yield one.name, ". ".join(t for t in (comments.get(one.name, ""), default(one)) if t)
        return
    for name, text in comments.items():
        if text and not name.startswith("_"):
            yield name, text


def default(one: Field[Any]) -> str:
    """What holds where nothing is given."""
    return "" if one.default is MISSING else f"Default `{one.default!r}`"


def commented(made: type) -> dict[str, str]:
    """The comments next to the fields of a class, or next to what `__init__` sets."""
    lines = textwrap.dedent(inspect.getsource(made)).splitlines()
    (tree,) = ast.parse("\n".join(lines)).body
    found = {}
    for node in ast.walk(tree):
        if not isinstance(node, ast.AnnAssign):
            continue
        target = node.target
        if isinstance(target, ast.Name):
            name = target.id
        elif isinstance(target, ast.Attribute):
            name = target.attr
        else:
            continue
        _, _, comment = lines[(node.end_lineno or 0) - 1].partition("  # ")
        above = lines[node.lineno - 2].strip()
        if not comment and above.startswith("# "):
            comment = above.removeprefix("# ")
        found[name] = "" if comment.startswith("pyright") else comment.strip()
    return found


def property_rows(made: type) -> Iterator[tuple[str, str]]:
    """Public properties with their docstrings."""
    for name, value in vars(made).items():
        text = inspect.getdoc(value) if not isinstance(value, staticmethod) else None
        is_property = isinstance(value, property) or type(value).__name__ == "cached_property"
        if is_property and text and not name.startswith("_"):
            yield name, text


def option_table() -> Iterator[str]:
    """The keywords of a bake."""
    yield from ("| keyword | default | meaning |", "|---|---|---|")
    for name, option in OPTIONS.items():
        shown = cell(BAKE.text(DEFAULTS.get(name, option.shown)))
        shown = shown or f"`{option.default!r}`".replace("`None`", "none")
        meaning = cell(BAKE.text(option.help))
        for status, raised in RAISED.items():
            meaning = meaning.replace(status, raised)
        yield f"| `{name}` | {shown} | {meaning} |"
    yield "| `progress` | none | Called after each frame with (frames done, total frames). |"


def main() -> int:
    """Write or check."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing, exit 1 on a difference"
    )
    check = parser.parse_args().check
    old = PAGE.read_text("utf-8") if PAGE.exists() else ""
    new = page()
    if check:
        sys.stdout.writelines(
            difflib.unified_diff(old.splitlines(True), new.splitlines(True), "api.md", "new")
        )
        return int(old != new)
    PAGE.write_text(new, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
