"""The site of the documents: its hooks, and that the built pages load nothing of other hosts."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tools import site_hooks
from tools.documents import PAGES, ROOT
from tools.site_hooks import adapted

# Attributes by which a page loads something at once; a link to follow (a href) loads nothing.
LOADS = {"src", "srcset", "poster", "data"}
LINKS_THAT_LOAD = {"stylesheet", "preload", "prefetch", "preconnect", "dns-prefetch", "icon"}
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)


def test_links_of_the_repository_become_links_of_the_site() -> None:
    assert adapted("[a](docs/guide.md#b)", "index.md") == "[a](guide.md#b)"
    assert adapted("[docs/guide.md](docs/guide.md)", "index.md") == "[guide.md](guide.md)"
    assert adapted("![a](docs/images/a.png)", "index.md") == "![a](images/a.png)"
    assert adapted("[a](../BENCHMARKS.md)", "guide.md") == "[a](BENCHMARKS.md)"
    assert adapted("[a](../../README.md)", "tutorials/duck.md") == "[a](../index.md)"
    assert adapted("[a](../guide.md)", "tutorials/duck.md") == "[a](../guide.md)"
    assert adapted("[a](../../README.md)", "guide/output.md") == "[a](../index.md)"
    assert adapted("[a](report.md#b)", "guide/output.md") == "[a](../guide/report.md#b)"
    assert adapted("[`a`](#b) and [c](https://d.e)", "guide.md") == "[`a`](#b) and [c](https://d.e)"


def test_links_to_files_that_the_site_lacks_become_names() -> None:
    assert adapted("see [samples/python](../samples/python).", "guide.md") == "see samples/python."
    assert adapted("[Apache-2.0](LICENSE)", "index.md") == "Apache-2.0"


def test_code_stays_as_it_is() -> None:
    code = "a\n\n    x[i](../j.py)\n\n```python\ny[i](../j.py)\n```\n"
    assert adapted(code, "guide.md") == code


def test_code_has_no_line_break_inside_an_option() -> None:
    page = '<p>gf-usd</p><pre><code>gf-usd <span class="m">-o</span> a --time-scale</code></pre>'
    kept = '<span class="unbroken">'
    assert site_hooks.unbroken(page) == (
        f'<p>gf-usd</p><pre><code>{kept}gf-usd</span> <span class="m">{kept}-o</span></span> a'
        f" {kept}--time-scale</span></code></pre>"
    )
    long = f"<code>a-{'b' * site_hooks.LONGEST}</code>"
    assert site_hooks.unbroken(long) == long  # it would not fit on a narrow page


def test_the_contents_that_open_a_page_go() -> None:
    page = "# A\n\nText.\n\n- [B](#b)\n- [C](#c): a text\n  of two lines\n\n## B\n\n- [C](#c)\n\n"
    assert adapted(page, "guide.md") == "# A\n\nText.\n\n## B\n\n- [C](#c)\n\n"


def test_every_diagram_was_drawn() -> None:
    """After a change of one: python tools/site_hooks.py MERMAID."""
    drawn = {path.name for path in (ROOT / "docs" / "images").glob("diagram-*.svg")}
    assert drawn == set(site_hooks.diagrams())
    assert drawn
    assert "```" not in adapted("```mermaid\na --> b\n```\n", "guide.md")


def test_every_page_has_its_place_in_the_site() -> None:
    """A new page needs a line in mkdocs.yml."""
    text = (ROOT / "mkdocs.yml").read_text("utf-8")
    listed = re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", text[text.index("\nnav:") :], re.M)
    docs = ROOT / "docs"
    pages = {page.relative_to(docs).as_posix() for page in docs.rglob("*.md")}
    assert sorted(listed) == sorted(pages | set(site_hooks.ROOT_PAGES.values()))


def test_no_row_of_a_table_continues_in_the_next_line() -> None:
    """It would end there, and the rest would stand below the table."""
    cut = [
        f"{page.relative_to(ROOT)}:{number}"
        for page in PAGES
        for number, line in enumerate(page.read_text("utf-8").splitlines(), start=1)
        if line.startswith("|") and not line.rstrip().endswith("|")
    ]
    assert cut == []


class Loads(HTMLParser):
    """What a page loads when it is opened."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.found += [values[name] for name in LOADS & values.keys()]
        if tag == "link" and LINKS_THAT_LOAD & set(values.get("rel", "").split()):
            self.found.append(values["href"])
        self.found += re.findall(r"url\(([^)]*)\)", values.get("style", ""))


def loads(html: str) -> list[str]:
    parser = Loads()
    parser.feed(html)
    return parser.found


def foreign(address: str) -> bool:
    return bool(re.match(r"['\"]?(?:[a-z]+:)?//", address.strip()))


def test_a_page_that_loads_from_another_host_is_found() -> None:
    pages = {
        '<script src="https://a.b/c.js"></script>': True,
        '<link rel="stylesheet" href="//a.b/c.css">': True,
        '<link href="https://a.b" rel="preconnect">': True,
        "<p style=\"background: url('http://a.b/c.png')\">": True,
        '<img src="images/a.png"><a href="https://a.b">c</a>': False,
        '<link rel="canonical" href="https://a.b/c.html">': False,
    }
    for html, expected in pages.items():
        assert any(map(foreign, loads(html))) is expected, html


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a link that leads nowhere fails the build."""
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, check=False, capture_output=True, text=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_no_page_loads_anything_of_another_host(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        requested = loads(page.read_text("utf-8"))
        assert requested
        assert [address for address in requested if foreign(address)] == [], page.name
        missing = [
            address
            for address in requested
            if not address.startswith(("data:", "/"))
            and not (page.parent / re.split("[?#]", address)[0]).is_file()
        ]
        assert missing == [], page.name
    for style in site.rglob("*.css"):
        addresses = re.findall(r"(?:url\(|@import )([^)]*)", style.read_text("utf-8"))
        assert not any(map(foreign, addresses)), style.name


def opened(pages: Iterator[Path]) -> set[str]:
    """Addresses that Chromium requests while it shows the pages."""
    from playwright.sync_api import sync_playwright

    requested: set[str] = set()
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page()
        tab.on("request", lambda request: requested.add(request.url))
        for page in pages:
            tab.goto(page.as_uri())
            tab.wait_for_timeout(100)
        browser.close()
    return requested


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium")
def test_a_browser_asks_no_other_host(site: Path) -> None:
    names = ("index", "architecture", "guide", "guide/options", "gallery", "tutorials/duck")
    requested = opened(site / f"{name}.html" for name in names)
    assert len(requested) > 10
    assert {address for address in requested if not address.startswith(("file:", "data:"))} == set()
