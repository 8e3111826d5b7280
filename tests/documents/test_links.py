"""Links between the documents lead to files and headings that exist; the guide is complete."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from gf_usd.cli.main import COMMANDS
from tools.documents import PAGES, ROOT
from tools.site_hooks import LINK, code_apart

GUIDE = ROOT / "docs" / "guide.md"
TOPICS = sorted((ROOT / "docs" / "guide").glob("*.md"))
NAMED = re.compile(r"docs/[\w/-]+\.md(?:#[\w-]+)?")  # a page in a comment, a docstring, an error


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return "".join(part for part, is_code in code_apart(page.read_text("utf-8")) if not is_code)


def anchors(page: Path) -> list[str]:
    """The anchors of its headings, as GitHub and the site name them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.M)
    shown = [LINK.sub(r"\2", heading).strip().lower() for heading in headings]
    return [re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in shown]


def broken(page: Path) -> Iterator[str]:
    """Links of a page that lead to no file or to no heading."""
    for _, _, target in LINK.findall(prose(page)):
        path, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        place = (page.parent / path).resolve() if path else page
        if not place.exists() or (anchor and anchor not in anchors(place)):
            yield f"{page.name}: {target}"


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    assert [link for page in PAGES for link in broken(page)] == []


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "a.md"
    page.write_text(
        "# A `--b`: c\n[1](#a---b-c) [2](#d) [3](a.md#a---b-c) [4](no.md) [5](https://a.b/c)\n"
        "\n    [6](code.md)\n"
    )
    assert list(broken(page)) == ["a.md: #d", "a.md: no.md"]


def test_every_picture_is_shown_on_a_page() -> None:
    images = ROOT / "docs" / "images"
    shown = "".join(page.read_text("utf-8") for page in PAGES)
    files = [path for path in images.rglob("*") if path.is_file()]
    # the site has a picture in the place of each diagram in text
    kept = [path for path in files if not path.name.startswith("diagram-")]
    assert [path.name for path in kept if path.name not in shown] == []


def test_no_page_has_two_headings_of_one_anchor() -> None:
    for page in TOPICS:
        assert len(set(anchors(page))) == len(anchors(page)), page.name


def test_every_page_that_the_code_names_exists() -> None:
    sources = [*(ROOT / "gf_usd").rglob("*.py"), *(ROOT / "tools").rglob("*.py")]
    named = {name for path in sources for name in NAMED.findall(path.read_text("utf-8"))}
    assert len(named) > 10
    for name in named:
        path, _, anchor = name.partition("#")
        assert (ROOT / path).is_file(), name
        assert not anchor or anchor in anchors(ROOT / path), name


def test_the_guide_leads_to_each_of_its_pages() -> None:
    text = GUIDE.read_text("utf-8")
    assert len(TOPICS) > 10
    assert [page.name for page in TOPICS if f"(guide/{page.name})" not in text] == []


@pytest.mark.parametrize("page", [GUIDE, *TOPICS], ids=lambda page: page.name)
def test_a_page_of_the_guide_stays_short(page: Path) -> None:
    assert page.read_text("utf-8").count("\n") <= (200 if page == GUIDE else 400)


@pytest.mark.parametrize("page", [GUIDE, *TOPICS], ids=lambda page: page.name)
def test_no_block_of_code_follows_a_list(page: Path) -> None:
    """Markdown would show it as a paragraph of the last item."""
    assert re.findall(r"^- .*\n(?:  \S.*\n)*\n {4}.*", page.read_text("utf-8"), re.M) == []


def test_the_guide_lists_every_command() -> None:
    text = (ROOT / "docs/guide/commands.md").read_text("utf-8")
    shown = [name for name, (_, settings) in COMMANDS.items() if not settings.get("hidden")]
    assert len(shown) > 10
    assert [name for name in shown if f"\n| `{name}` |" not in text] == []
