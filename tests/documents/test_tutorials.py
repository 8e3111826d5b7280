"""The commands of each tutorial run in order, as they are written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pasted import paste
from slow_parameters import longest_but

from tools.documents import ROOT, blocks

TUTORIALS = ROOT / "docs" / "tutorials"
MADE = {
    "duck": ("slow.png", "duck.html", "duck.jelly-clay.usda"),
    "character": ("walk.png", "loose.png", "firm.png"),
    "splats": ("capture.png", "head.png", "frames/duck_capture.jelly.0012.ply"),
    "shot": ("shot.png", "slippery.png"),
    "looks-wrong": ("ball.png", "sound.png", "sound.html"),
}


def script(name: str) -> str:
    """Its blocks of commands and of Python, as one script."""
    parts = []
    for block in blocks(TUTORIALS / f"{name}.md"):
        if block.language == "bash":
            parts.append(block.text)
        elif block.language == "python":
            parts.append(f"python - <<'END'\n{block.text}\nEND")
    return "\n".join(parts)


def fewer(text: str) -> str:
    """The same with fewer particles and frames than a reader would like to see."""
    for many, few in (
        ("--particles 2000", "--particles 200"), ("--particles 1500", "--particles 200"),
        ("--particles 500", "--particles 200"), ("--frames 60", "--frames 12"),
        ("--frames 48", "--frames 22"), ("--sheet 6", "--sheet 2"), ("--sheet 8", "--sheet 2"),
    ):  # fmt: skip
        text = text.replace(many, few)
    return text


def test_every_tutorial_is_known_and_listed() -> None:
    pages = {path.stem for path in TUTORIALS.glob("*.md")}
    assert pages == {"index", *MADE}
    listed = (TUTORIALS / "index.md").read_text("utf-8")
    assert all(f"({name}.md)" in listed for name in MADE)


def test_the_parts_of_the_shot_are_those_of_the_sample() -> None:
    shot = (ROOT / "samples" / "shot.usda").read_text("utf-8")
    shown = [b.text for b in blocks(TUTORIALS / "shot.md") if b.language == "usda"]
    assert len(shown) == 2
    assert all(f"{text}\n" in shot for text in shown)


@pytest.mark.slow
@pytest.mark.parametrize("name", longest_but(MADE, "shot"))
def test_the_commands_of_a_tutorial_run_in_order(name: str, tmp_path: Path) -> None:
    paste(fewer(script(name)), tmp_path, particles=200, frames=8)
    for made in MADE[name]:
        assert (tmp_path / made).stat().st_size > 1000, made


FIRST_BAKE = (  # what pages say of its last frame
    ("guide.md", r"note: rubber: at rest at frame (\d+)"),
    ("guide.md", r"rubber: (\d+) frames, at rest"),
    ("guide.md", r"`(\d+) frames, at rest at frame"),
    ("tutorials/duck.md", r"is at rest, after (\d+) frames"),
    ("guide/frames.md", r"\| rubber duck \| (\d+) frames"),
)


def test_every_page_says_the_same_of_the_first_bake() -> None:
    found = [
        (page, re.findall(pattern, (ROOT / "docs" / page).read_text("utf-8")))
        for page, pattern in FIRST_BAKE
    ]
    assert len({tuple(numbers) for _, numbers in found}) == 1, found
    assert len(found[0][1]) == 1
