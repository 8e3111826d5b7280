"""HTML in which every text is escaped unless it was made here."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable
from html import escape
from typing import Any

VOID = {"input", "img", "meta", "link"}  # elements without an end


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def tag(name_: str, /, *children: str, **attributes: str | bool) -> Html:
    """``<name_ attributes>children</name_>``; plain strings are escaped.

    A trailing underscore is dropped and others become dashes: ``class_``, ``data_look``.
    True is an attribute without a value, False none at all.
    """
    words = [name_]
    for key, value in attributes.items():
        key = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(key)
        elif value is not False:
            words.append(f'{key}="{escape(str(value), quote=True)}"')
    end = "" if name_ in VOID else f"{join(children)}</{name_}>"
    return Html(f"<{' '.join(words)}>{end}")


def join(parts: Iterable[str]) -> Html:
    """The parts after each other, escaped where they are plain."""
    return Html("".join(p if isinstance(p, Html) else escape(p, quote=True) for p in parts))


def script(text: str) -> Html:
    """A script of ours; its hash goes into the page's policy."""
    return Html(f"<script>{text}</script>")


def data_script(name: str, text: str) -> Html:
    """Data that no browser runs: JSON, or base64."""
    # "</script>" within the text would end the element, "<!--" would hide its end
    return Html(
        f'<script type="text/plain" id="{escape(name, quote=True)}">'
        + text.replace("<", "\\u003c")
        + "</script>"
    )


def json_text(value: Any) -> str:
    """Compact JSON by the standard: no NaN."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def policy(scripts: Iterable[str]) -> str:
    """A content security policy: these scripts run and no other, and nothing is fetched."""
    hashes = (
        "'sha256-" + base64.b64encode(hashlib.sha256(s.encode("utf-8")).digest()).decode() + "'"
        for s in scripts
    )
    return (
        f"default-src 'none'; script-src {' '.join(hashes)}; style-src 'unsafe-inline';"
        " img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
