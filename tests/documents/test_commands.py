"""Commands of the documents are commands of the program, and those of the README run in order."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import typer.main
from pasted import paste

from gf_usd.cli.main import program
from gf_usd.cli.misuse import WrongUsage, usage_message
from tools.documents import PAGES, ROOT, Block, blocks, command_lines, gf_usd_commands

# what a recipe adds to the program before it uses it
ADDED = {"extending.md": "--opacity"}
BAKE = re.compile(r"<!-- bake -->\n```\n(.*)\n```\n")
INSTALLS = re.compile(r"pip install (?:-\S+ )*'?gf[-_]usd")


def parse(group: Any, command: list[str]) -> str:
    """What is wrong with the arguments of `gf-usd`; empty where nothing is."""
    name, *arguments = command[: command.index(">")] if ">" in command else command
    if name not in group.commands:
        return f"there is no command {name}"
    try:
        group.commands[name].make_context(name, arguments)
    except typer.Exit:
        return ""  # --help
    except WrongUsage as error:
        return usage_message(error)
    return ""


def test_every_command_of_the_documents_can_be_parsed() -> None:
    group = typer.main.get_command(program())
    checked = 0
    for page in PAGES:
        for block, arguments in gf_usd_commands(page):
            if ADDED.get(page.name) not in arguments:
                place = f"{page.relative_to(ROOT)}:{block.line}: gf-usd {' '.join(arguments)}"
                assert parse(group, arguments) == "", place
                checked += 1
    assert checked > 50


def test_a_wrong_command_of_a_document_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "Text\n\n    gf-usd bake a.usda --partikles 4  # few\n\n"
        "```bash\nx; gf-usd bale \\\n  b\n```\n"
    )
    commands = [arguments for _, arguments in gf_usd_commands(page)]
    assert commands == [["bake", "a.usda", "--partikles", "4"], ["bale", "b"]]
    group = typer.main.get_command(program())
    assert [parse(group, arguments).partition("\n")[0] for arguments in commands] == [
        "bake has no option --partikles",
        "there is no command bale",
    ]


def test_every_block_of_code_is_closed() -> None:
    for page in PAGES:
        fences = [line for line in page.read_text("utf-8").splitlines() if line[:3] == "```"]
        assert len(fences) % 2 == 0, page
        assert set(fences[1::2]) <= {"```"}, page


def test_nothing_is_installed_by_a_name_that_is_not_published() -> None:
    sources = [*PAGES, *(ROOT / "gf_usd").rglob("*.py")]
    assert [path for path in sources if INSTALLS.search(path.read_text("utf-8"))] == []
    assert INSTALLS.search("pip install 'gf-usd[open3d]'")


def of_the_readme() -> list[Block]:
    """Its blocks, in order, up to the tests."""
    text = (ROOT / "README.md").read_text("utf-8")
    tests = text[: text.index("<!-- test -->")].count("\n") + 1
    return [block for block in blocks(ROOT / "README.md") if block.line < tests]


def test_the_readme_installs_and_activates_before_it_uses() -> None:
    shell = [
        line for block in of_the_readme() if block.language == "" for line in command_lines(block)
    ]
    commands = [word.strip() for line in shell for word in line.split("&&")]
    assert commands[:3] == ["python3 -m venv .venv", ". .venv/bin/activate", "pip install ."]
    # one line, from a fresh clone to the baked duck
    assert [shell[0]] == BAKE.findall((ROOT / "README.md").read_text("utf-8"))
    assert shell[0].split("pip install . && ")[1].startswith("gf-usd bake samples/duck.usda")
    assert len(commands) > 8
    assert all(word.startswith("gf-usd ") for word in commands[3:])


@pytest.mark.slow
def test_the_commands_of_the_readme_run_in_order(tmp_path: Path) -> None:
    """All of them but the installation, with fewer particles and frames than a user has."""
    script = []
    for block in of_the_readme():
        if block.language == "python":
            few = block.text.replace("particles=2000", "particles=300, frames=8")
            script.append(f"python - <<'END'\n{few}\nEND")
        else:
            script += [line.rpartition("pip install . && ")[2] for line in command_lines(block)]
    paste("\n".join(script), tmp_path, particles=300, frames=8)
    for name in ("duck.rubber.usda", "duck.png", "duck.mp4", "duck.html", "jelly.png"):
        assert (tmp_path / name).stat().st_size > 1000
    assert (tmp_path / "duck.jelly.usda").exists()


@pytest.mark.slow
def test_the_python_of_the_guide_runs_in_order(tmp_path: Path) -> None:
    page = ROOT / "docs" / "guide" / "python.md"
    text = "\n".join(block.text for block in blocks(page) if block.language == "python")
    for many, few in (
        ("particles=4000", "particles=300, frames=6"),
        ("soft], drop=3.0", "soft], particles=300, frames=6, drop=3.0"),
        ("particles=2000", "particles=200"),
        ("frames=48", "frames=12"),
    ):
        assert many in text
        text = text.replace(many, few)
    paste(f"python - <<'END'\n{text}\nEND", tmp_path, particles=300, frames=6)
    assert (tmp_path / "out" / "duck.rubber-jelly.usda").exists()
