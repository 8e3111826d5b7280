"""The documents, and the commands in them."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
SHELL = ("", "bash", "sh")  # languages of fences that hold commands
BETWEEN = {"&&", "||", ";", "|", "&"}  # commands of one line
SYNTAX = re.compile(r"(?:^|\s)[\[<]|\.\.\.|[A-Z]\|[A-Z]|\]$")  # a line that only shows the syntax


@dataclass(frozen=True)
class Block:
    """A block of code: its language ("" where none is given), its text, and its first line."""

    page: Path
    line: int
    language: str
    text: str


def blocks(page: Path) -> Iterator[Block]:
    """The fenced and indented blocks of a page."""
    fence, began, held = None, 0, list[str]()
    lines = page.read_text("utf-8").splitlines()
    previous = ""
    for number, line in enumerate([*lines, ""], start=1):
        if fence is not None:
            if line.strip() == "```":
                yield Block(page, began, fence, "\n".join(held))
                fence, held = None, []
            else:
                held.append(line)
        elif line.startswith("    ") and (held or not previous.strip()):
            began = began if held else number
            held.append(line)
        else:
            if held and not line.strip() and number <= len(lines):
                held.append("")
                previous = line
                continue
            if held:
                yield Block(page, began, "", textwrap.dedent("\n".join(held)).strip("\n"))
                held = []
            if line.startswith("```"):
                fence, began = line[3:].strip(), number + 1
        previous = line


def command_lines(block: Block) -> list[str]:
    """Its lines as a shell takes them: without comments, continued lines joined."""
    joined = block.text.replace("\\\n", " ")
    lines = (re.sub(r"(^|\s)#\s.*", "", line).strip() for line in joined.splitlines())
    return [line.removeprefix("$ ") for line in lines if line]


def gf_usd_commands(page: Path) -> Iterator[tuple[Block, list[str]]]:
    """Arguments of every complete `gf-usd` command in the blocks of a page."""
    for block in blocks(page):
        if block.language not in SHELL:
            continue
        for line in command_lines(block):
            if "gf-usd " not in line or SYNTAX.search(line):
                continue
            arguments: list[str] = []
            scan = shlex.shlex(line, posix=True, punctuation_chars=";&|")
            scan.whitespace_split = True
            scan.commenters = ""
            for word in [*scan, ";"]:
                if word in BETWEEN:
                    if arguments and arguments[0] == "gf-usd":
                        yield block, arguments[1:]
                    arguments = []
                else:
                    arguments.append(word)
