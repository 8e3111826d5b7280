"""HTML of the report: elements with escaped text, and the header, controls and tables of a page."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from gf_usd.view.report.labels import (
    FACTS,
    SETTINGS,
    Line,
    health_rows,
    material_labels,
    named_rows,
)
from gf_usd.view.report.record import Record

VOID = {"input", "img", "meta", "link"}  # elements without an end tag


class Html(str):
    """Text that is HTML and must not be escaped."""

    __slots__ = ()


def tag(name_: str, /, *children: str, **attributes: str | bool) -> Html:
    """``<name_ attributes>children</name_>``; plain strings are escaped.

    A trailing underscore is dropped and others become dashes: ``class_``, ``data_variant``.
    True gives an attribute without a value, False omits it.
    """
    parts = [name_]
    for key, value in attributes.items():
        key = key.rstrip("_").replace("_", "-")
        if value is True:
            parts.append(key)
        elif value is not False:
            parts.append(f'{key}="{escape(str(value), quote=True)}"')
    end = "" if name_ in VOID else f"{join(children)}</{name_}>"
    return Html(f"<{' '.join(parts)}>{end}")


def join(parts: Iterable[str]) -> Html:
    """Concatenate HTML and plain strings, which are escaped."""
    return Html("".join(p if isinstance(p, Html) else escape(p, quote=True) for p in parts))


def script(text: str) -> Html:
    """A script element; its text must be in the `policy` of the page."""
    return Html(f"<script>{text}</script>")


def data_script(name: str, text: str) -> Html:
    """A script element with data, JSON or base64, which browsers do not run."""
    # "</script>" in the text would end the element, and "<!--" would hide its end
    return Html(
        f'<script type="text/plain" id="{escape(name, quote=True)}">'
        + text.replace("<", "\\u003c")
        + "</script>"
    )


def json_text(value: Any) -> str:
    """Compact standard JSON.  Raises ValueError for NaN and infinity."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def policy(scripts: Iterable[str]) -> str:
    """A content security policy that allows these scripts only, and no network access."""
    hashes = (
        "'sha256-" + base64.b64encode(hashlib.sha256(s.encode("utf-8")).digest()).decode() + "'"
        for s in scripts
    )
    return (
        f"default-src 'none'; script-src {' '.join(hashes)}; style-src 'unsafe-inline';"
        " img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


ICONS = {
    "start": "M4 2.5v11l9-5.5z",
    "stop": "M4 3h3v10H4zM9 3h3v10H9z",
    "back": "M12 3v10L6 8zM3.5 3h2v10h-2z",
    "next": "M4 3v10l6-5zM10.5 3h2v10h-2z",
}
SPEEDS = ("0.1", "0.25", "0.5", "1", "2")
SHORT = 2.0  # [s] shorter motions play at half speed at first
MODES = {
    "color": "own color",
    "strain": "strain",
    "speed": "speed",
    "elastic": "elastic strain",
    "plastic": "plastic strain",
    "stress": "stress",
}


def header(name: str, variants: Sequence[str], records: Sequence[Record]) -> Html:
    """The header: asset name, tabs of variants, and per variant the command and missing data."""
    title = tag("h1", name)
    if len(variants) > 1:
        tabs = join(
            tag(
                "button",
                variant,
                type="button",
                role="tab",
                data_open=str(i),
                aria_selected="false",
            )
            for i, variant in enumerate(variants)
        )
        title = join([title, tag("div", tabs, class_="group", role="tablist")])
    elif variants and variants[0]:
        title = join([title, tag("span", variants[0], class_="soft")])
    parts = [tag("div", title, class_="title")]
    for i, record in enumerate(records):
        content: list[str] = []
        if record.command:
            content.append(_command(record.command))
        if record.failure:
            text = tag("p", f"The bake ended early: {record.failure}")
            content.append(tag("div", text, class_="banner"))
        if record.missing:
            text = join(tag("p", f"Missing: {line}.") for line in record.missing)
            content.append(tag("div", text, class_="banner"))
        parts.append(_for_variant(i, *content))
    return tag("header", *parts)


def _command(command: str) -> Html:
    """A command whose lines do not break inside the name of an option."""
    words = re.split(r"(?<=\s)(--?[a-z][\w-]*)", command)  # every other one is an option
    parts = (tag("span", word) if i % 2 else word for i, word in enumerate(words))
    return tag("code", *parts, class_="command")


def viewer(pictures: Sequence[Sequence[tuple[int, str, str]]], seconds: float, cell: str) -> Html:
    """Canvas and controls.

    pictures : (frame, label, data URI) of each key frame, for each variant.
    """
    speed = "0.5" if seconds < SHORT else "1"
    screen = tag(
        "div",
        tag("canvas", id="canvas", aria_label="the moving body in 3D"),
        tag("div", id="trouble", hidden=True),
        tag("div", id="clock", class_="over"),
        tag("div", f"grid {cell}", id="cell", class_="over") if cell else "",
        tag(
            "div",
            tag("div", id="legend-title"),
            tag("div", id="legend-bar"),
            tag(
                "div",
                *(tag("span", id=f"legend-{end}") for end in ("low", "middle", "high")),
                class_="ends",
            ),
            id="legend",
            class_="over",
            hidden=True,
        ),
        class_="screen",
    )
    return tag(
        "section",
        screen,
        _controls(speed),
        *(_for_variant(i, _picture_strip(rows)) for i, rows in enumerate(pictures)),
        class_="card viewer",
    )


def _controls(speed: str) -> Html:
    kinds = (("mesh", "mesh"), ("gaussians", "Gaussians"), ("both", "both"))
    return tag(
        "div",
        scrub_bar(),
        tag(
            "div",
            *(
                tag("button", text, type="button", data_show=kind, aria_pressed="false")
                for kind, text in kinds
            ),
            class_="group",
            id="kinds",
        ),
        tag("label", "color ", choice("mode", list(MODES.items()), "color")),
        tag("label", "speed ", choice("speed", [(s, f"{s}×") for s in SPEEDS], speed)),
        tag(
            "label",
            "size ",
            tag("input", type="range", id="size", min="0.3", max="2", step="0.05", value="1"),
            id="sizes",
            hidden=True,
        ),
        tag("span", class_="grow"),
        tag("button", "reset view", type="button", id="reset"),
        class_="controls",
    )


def tables(i: int, record: Record, shown: Sequence[str], notes: Sequence[str]) -> Html:
    """The tables of variant i: health, settings, materials, notes and findings."""
    material = [row for m in record.materials for row in _material_rows(m)]
    columns = (
        [_health_card(record), _card("Certainty", _two_column_table(_certified_rows(record)))],
        [_card("Settings", _two_column_table(named_rows(record.settings, SETTINGS)))],
        [
            _card("Material", _two_column_table(material)),
            _card("Body", _two_column_table(named_rows(record.facts, FACTS))),
            _card("Shown on this page", _list(shown)),
            _card("Notes", _list([*record.notes, *notes])),
            _card("Findings of the check", _list([_format_finding(f) for f in record.findings])),
        ],
    )
    return _for_variant(
        i, tag("div", *(tag("div", *c) for c in columns if any(c)), class_="tables")
    )


def _certified_rows(record: Record) -> list[tuple[str, str]]:
    """The measured quantities with their intervals."""
    certificate = record.certificate
    rows = [
        (entry["words"].capitalize(), entry["told"])
        for entry in certificate.get("figures", {}).values()
    ]
    if "center" in certificate:
        rows.append(("Path", certificate["center"]["told"].removeprefix("path of the ")))
    if rows:
        rows.append(
            ("From", f"bakes with {', '.join(map(str, certificate['particles']))} particles")
        )
    return rows


def _card(title: str, content: Html) -> Html:
    """A box with a title; empty HTML for empty content."""
    return tag("section", tag("h2", title), content, class_="card") if content else Html("")


def _list(lines: Sequence[str]) -> Html:
    return tag("ul", *(tag("li", line) for line in lines)) if lines else Html("")


def _health_card(record: Record) -> Html:
    rows = health_rows(record.health, {warning.about for warning in record.warnings})
    if not rows:
        return Html("")
    count = len(record.warnings)
    verdict = tag("p", "No warnings.", class_="verdict")
    if count:
        text = "One warning:" if count == 1 else f"{count} warnings:"
        items = (
            tag("li", w.message, tag("span", f" {w.hint}") if w.hint else "")
            for w in record.warnings
        )
        verdict = tag("div", tag("p", text), tag("ul", *items), class_="banner")
    parts = [verdict, _health_table([row for row in rows if row.first])]
    if rest := [row for row in rows if not row.first]:
        parts.append(tag("details", tag("summary", "more numbers"), _health_table(rest)))
    return tag("section", tag("h2", "Health"), *parts, class_="card")


def _health_table(rows: Sequence[Line]) -> Html:
    body = (
        tag(
            "tr",
            tag("th", row.label, scope="row"),
            tag("td", row.value, class_="value"),
            tag("td", row.meaning, class_="meaning"),
            class_="warning" if row.marked else "fine",
        )
        for row in rows
    )
    return tag("table", tag("tbody", *body))


def _material_rows(material: Any) -> list[tuple[str, str]]:
    name = str(material.get("name", ""))
    rest = {key: value for key, value in material.items() if key != "name"}
    return [("Name", name), *named_rows(rest, material_labels())]


def _format_finding(finding: Any) -> str:
    where = f"{finding.get('rule', '')} <{finding.get('prim', '')}>"
    return f"{where}: {finding.get('message', '')} Fix: {finding.get('fix', '')}"


def _two_column_table(rows: Sequence[tuple[str, str]]) -> Html:
    if not rows:
        return Html("")
    lines = (
        tag("tr", tag("th", label, scope="row"), tag("td", value, class_="value"))
        for label, value in rows
    )
    return tag("table", tag("tbody", join(lines)))


def _picture_strip(pictures: Sequence[tuple[int, str, str]]) -> Html:
    return tag(
        "div",
        *(
            tag(
                "button",
                tag("img", src=uri, alt=text),
                tag("span", text),
                type="button",
                data_frame=str(frame),
                title=text,
            )
            for frame, text, uri in pictures
        ),
        class_="pictures",
    )


def _button(name: str, text: str, *icons: str) -> Html:
    """A button with one of ICONS, or with two that alternate by its state."""
    svgs = join(
        tag("svg", tag("path", d=ICONS[icon]), viewBox="0 0 16 16", class_=icon, aria_hidden="true")
        for icon in icons
    )
    return tag("button", svgs, type="button", id=name, class_="icon", aria_label=text)


def scrub_bar() -> Html:
    """The playback controls of transport.js: play, single steps, slider and counter."""
    return tag(
        "div",
        _button("play", "play", "start", "stop"),
        _button("back", "one frame back", "back"),
        _button("next", "one frame forward", "next"),
        tag("input", type="range", id="slider", min="0", max="0", value="0", aria_label="frame"),
        tag("span", id="counter"),
        class_="scrub",
    )


def choice(name: str, options: Sequence[tuple[str, str]], chosen: str) -> Html:
    """A select element of options (value, text)."""
    return tag(
        "select",
        *(tag("option", text, value=value, selected=value == chosen) for value, text in options),
        id=name,
    )


def _for_variant(number: int, *parts: str) -> Html:
    """A block that is visible only while variant `number` is selected."""
    return tag("div", *parts, data_variant=str(number), hidden=number != 0)


def document(
    title: str,
    body: Sequence[Html],
    page: str,
    blobs: Sequence[Html],
    scripts: Sequence[str],
    libraries: Sequence[str] = (),
) -> str:
    """A whole page.

    page : JSON for the scripts.  blobs : data scripts.  scripts : file names of our scripts, which
    share one scope.  libraries : texts of scripts that run before.
    """
    folder = files("gf_usd.view.report") / "page"
    text = "\n".join((folder / name).read_text(encoding="utf-8") for name in scripts)
    text = f'(() => {{\n"use strict";\n{text}\n}})();'
    style = (folder / "page.css").read_text(encoding="utf-8")
    head = join(
        [
            tag("meta", charset="utf-8"),
            tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
            tag("meta", http_equiv="Content-Security-Policy", content=policy([*libraries, text])),
            tag("link", rel="icon", href="data:,"),
            tag("title", title),
            Html(f"<style>{style}</style>"),
        ]
    )
    elements = [script(source) for source in (*libraries, text)]
    rest = join([*body, data_script("page", page), *blobs, *elements])
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{rest}</body></html>\n'
