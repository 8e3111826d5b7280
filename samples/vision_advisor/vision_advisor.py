"""A material advisor for gf-usd that asks a vision-language model.

It speaks the common chat-completions protocol: POST URL/chat/completions with a text and a picture,
answered by a text with JSON in it.  Which server is asked is said by the environment:

VISION_ADVISOR_URL    e.g. http://127.0.0.1:8080/v1
VISION_ADVISOR_MODEL  name of the model there; "default" where it is not set
VISION_ADVISOR_KEY    sent as a bearer token; nothing is sent where it is not set
"""

from __future__ import annotations

import base64
import json
import os
import urllib.error
import urllib.request
from typing import Any

from gf_usd.core.errors import BakeError
from gf_usd.core.stage import Advice
from gf_usd.prepare.advice import Question

SECONDS = 90.0  # less than gf-usd waits, so that the words below are what a person sees

ROLE = (
    "You choose simulation materials. The picture shows the whole asset. For each prim answer with"
    " one preset, a confidence from 0 to 1 and a short reason, as JSON alone:"
    ' {"PRIM PATH": {"material": "...", "confidence": 0.0, "reason": "..."}}'
)


def advise(question: Question) -> list[Advice]:
    """The model's answer for every subject.  Raises BakeError where there is none."""
    url = os.environ.get("VISION_ADVISOR_URL", "").rstrip("/")
    if not url:
        raise BakeError("no server is named", "set VISION_ADVISOR_URL, e.g. to its .../v1")
    reply = _post(f"{url}/chat/completions", request_of(question))
    try:
        text = reply["choices"][0]["message"]["content"]
        said = json.loads(_unfenced(text))
        return [
            Advice(
                path=path,
                material=one["material"],
                confidence=float(one["confidence"]),
                reason=str(one["reason"]),
            )
            for path, one in said.items()
        ]
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        shown = json.dumps(reply)[:300]
        raise BakeError(
            f"the model's reply is not the JSON that was asked for: {shown}",
            "try another model with VISION_ADVISOR_MODEL",
        ) from error


def request_of(question: Question) -> dict[str, Any]:
    """The body of the request."""
    presets = "\n".join(f"- {name}: {what}" for name, what in question.presets.items())
    prims = "\n".join(
        f"- {s.path} (materials: {', '.join(s.looks) or 'none'};"
        f" labels: {', '.join((*s.labels, *s.labels_above)) or 'none'})"
        for s in question.subjects
    )
    text = f"File: {question.file.name}\n\nPresets:\n{presets}\n\nPrims:\n{prims}"
    picture = "data:image/png;base64," + base64.b64encode(question.picture).decode("ascii")
    content = [
        {"type": "text", "text": text},
        {"type": "image_url", "image_url": {"url": picture}},
    ]
    return {
        "model": os.environ.get("VISION_ADVISOR_MODEL", "default"),
        "temperature": 0,
        "messages": [
            {"role": "system", "content": ROLE},
            {"role": "user", "content": content},
        ],
    }


def _post(url: str, body: dict[str, Any]) -> Any:
    headers = {"Content-Type": "application/json"}
    key = os.environ.get("VISION_ADVISOR_KEY")
    if key:
        headers["Authorization"] = f"Bearer {key}"
    request = urllib.request.Request(url, json.dumps(body).encode("utf-8"), headers)
    try:
        with urllib.request.urlopen(request, timeout=SECONDS) as reply:
            return json.load(reply)
    except urllib.error.HTTPError as error:
        shown = error.read(300).decode("utf-8", "replace")
        raise BakeError(
            f"{url} answered with status {error.code}: {shown}",
            "check VISION_ADVISOR_URL, _MODEL and _KEY",
        ) from error
    except (OSError, ValueError) as error:
        raise BakeError(
            f"{url} gave no answer that can be read: {error}",
            "start the server, or check VISION_ADVISOR_URL",
        ) from error


def _unfenced(text: str) -> str:
    """A text without the fence that models like to put around JSON."""
    text = text.strip()
    if text.startswith("```"):
        text = text.split("\n", 1)[1].rsplit("```", 1)[0]
    return text
