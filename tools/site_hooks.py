"""The hooks of mkdocs.yml: what `mkdocs build` does to the documents besides rendering them.

The documents are written to be read in the repository as well.  For the site,

- README.md becomes the start page, and the other pages of the root folder join those of docs/;
- links to pages lead to their place in the site, and links to other files become plain names;
- the table of contents that opens a page goes, since the site has its own next to the text;
- diagrams in Mermaid become pictures, because a browser would fetch Mermaid from another host;
- lines of code do not break inside an option such as --time-scale.

`python tools/site_hooks.py MERMAID` draws those pictures with Chromium; MERMAID is the file
dist/mermaid.min.js of the npm package mermaid.
"""

from __future__ import annotations

import argparse
import hashlib
import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
ROOT_PAGES = {
    "README.md": "index.md",
    "BENCHMARKS.md": "BENCHMARKS.md",
    "CHANGELOG.md": "CHANGELOG.md",
    "CONTRIBUTING.md": "CONTRIBUTING.md",
}  # in the repository, and in the site
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s]+)\)")
CONTENTS = re.compile(r"(?:^- \[[^\n]*\]\(#[^\n]*\)[^\n]*\n(?:  [^\n]*\n)*)+\n", re.M)
DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```\n", re.M | re.S)
CODE = re.compile(r"<(pre|code)\b[^>]*>.*?</\1>", re.S)  # in HTML
HYPHENATED = re.compile(r"(?<![^\s>])[\w./=,:-]*-[\w./=,:-]*(?![^\s<])")  # a word with a hyphen
LONGEST = 32  # characters that stay on one line: as many as a phone shows


def on_files(files: Any, config: Any) -> Any:
    """Add the pages of the root folder.  `config` is MkDocs', `files` what it found in docs/."""
    from mkdocs.structure.files import File

    for name, place in ROOT_PAGES.items():
        files.append(File.generated(config, place, content=(ROOT / name).read_text("utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The text of a page as the site has it."""
    return adapted(markdown, page.file.src_uri)


def on_page_content(html: str, **_: Any) -> str:
    """The HTML of a page as the site has it."""
    return unbroken(html)


def unbroken(html: str) -> str:
    """HTML whose code has no line break after a hyphen: "--" and "gf-" mean nothing alone."""

    def word(found: re.Match[str]) -> str:
        return f'<span class="unbroken">{found[0]}</span>' if len(found[0]) <= LONGEST else found[0]

    return CODE.sub(lambda code: HYPHENATED.sub(word, code[0]), html)


def adapted(markdown: str, place: str) -> str:
    """The text of the page at `place` in the site, made of its text in the repository."""
    source = next((name for name, at in ROOT_PAGES.items() if at == place), f"docs/{place}")
    up = "../" * place.count("/")

    def picture(diagram: re.Match[str]) -> str:
        folder = posixpath.relpath("docs/images", posixpath.dirname(source) or ".")
        return f"![Diagram]({folder}/{diagram_name(diagram[1])})\n"

    def link(found: re.Match[str]) -> str:
        mark, text, target = found.groups()
        if re.match(r"[a-z]+:|#", target):
            return found[0]
        path, hash_sign, anchor = target.partition("#")
        name = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if name in ROOT_PAGES:
            inside = ROOT_PAGES[name]
        elif name.startswith("docs/"):
            inside = name.removeprefix("docs/")
        else:
            return text  # a file of the repository that the site does not have
        if source == "README.md" and text == name:
            text = inside  # the file names of its list of documents
        return f"{mark}[{text}]({up}{inside}{hash_sign}{anchor})"

    markdown = DIAGRAM.sub(picture, CONTENTS.sub("", markdown, count=1))
    return "".join(
        part if is_code else LINK.sub(link, part) for part, is_code in code_apart(markdown)
    )


def code_apart(markdown: str) -> list[tuple[str, bool]]:
    """Pieces of a text, and whether each is a fenced or indented block of code."""
    pieces: list[tuple[str, bool]] = []
    fence = ""
    for line in markdown.splitlines(keepends=True):
        bare = line.strip()
        opens = bare.startswith("```") and not fence
        is_code = bool(fence) or opens or (line.startswith("    ") and not bare.startswith("!"))
        if opens:
            fence = "```"
        elif fence and bare == fence:
            fence = ""
        if pieces and pieces[-1][1] == is_code:
            pieces[-1] = (pieces[-1][0] + line, is_code)
        else:
            pieces.append((line, is_code))
    return pieces


def diagram_name(source: str) -> str:
    """File of the picture of a diagram; it changes with the source, so that none is outdated."""
    return f"diagram-{hashlib.sha256(source.encode()).hexdigest()[:12]}.svg"


def diagrams() -> dict[str, str]:
    """Source by the name of its picture, of all diagrams of the documents."""
    pages = [*sorted(DOCS.rglob("*.md")), *(ROOT / name for name in ROOT_PAGES)]
    found = (source for page in pages for source in DIAGRAM.findall(page.read_text("utf-8")))
    return {diagram_name(source): source for source in found}


def draw(mermaid: Path) -> None:
    """Draw the diagrams into docs/images, and delete the pictures of earlier ones."""
    from playwright.sync_api import sync_playwright

    wanted = diagrams()
    for old in set(DOCS.glob("images/diagram-*.svg")):
        if old.name not in wanted:
            old.unlink()
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page()
        page.add_script_tag(path=mermaid)
        page.evaluate(
            "mermaid.initialize({startOnLoad: false, theme: 'neutral', htmlLabels: false,"
            " fontFamily: 'sans-serif', flowchart: {htmlLabels: false, nodeSpacing: 90}})"
        )
        for name, source in wanted.items():
            drawn = page.evaluate(
                "async text => (await mermaid.render('diagram', text)).svg", source
            )
            short = re.sub(r"(\d+\.\d)\d+", r"\1", drawn)  # a tenth of a pixel is enough
            (DOCS / "images" / name).write_text(
                short.replace("max-width", "background:white;max-width", 1), "utf-8"
            )
            print(DOCS / "images" / name)
        browser.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the diagrams of the documents for the site.")
    parser.add_argument("mermaid", type=Path, help="dist/mermaid.min.js of the npm package mermaid")
    draw(parser.parse_args().mermaid)
