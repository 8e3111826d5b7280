"""Advice on materials: from the names and labels of a prim, or from an advisor.

Plain data; `names` has the rule, `advisors` the
plug-ins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gf_usd.core.stage import Advice, Subject

AUTO = "auto"  # of --material; its variant is called so, too
LEAST = 0.3  # confidence: what is less sure than this is rubber
FALLBACK = "rubber"


@dataclass(frozen=True, kw_only=True)
class Question:
    """The input of an advisor: assign a preset to every subject."""

    file: Path  # the asset, as the user named it
    subjects: tuple[Subject, ...]
    presets: Mapping[str, str]  # what each preset is, as text
    picture: bytes = field(repr=False)  # PNG of the whole asset at rest


@dataclass(frozen=True)
class Auto:
    """The preset of ``--material auto`` before the asset is read."""

    advisor: str = ""  # empty: names and labels

    @property
    def name(self) -> str:
        return AUTO


def with_fallback(advice: Advice) -> Advice:
    """The advice, or rubber where its confidence is below LEAST, with the reason as text."""
    if advice.confidence >= LEAST:
        return advice
    reason = (
        f"{advice.material} is too uncertain, {advice.confidence:.2f} < {LEAST}: {advice.reason};"
        f" {FALLBACK} is assumed"
    )
    return Advice(path=advice.path, material=FALLBACK, confidence=0.0, reason=reason, by=advice.by)


def answer_errors(answer: object, paths: Sequence[str], presets: Sequence[str]) -> str:
    """The errors in an advisor's answer, as text; "" where there are none."""
    if not isinstance(answer, (list, tuple)):
        return f"it answered with a {type(answer).__name__}, not a list of Advice"
    for one in answer:
        if not isinstance(one, Advice):
            return f"it answered with a {type(one).__name__} in the list, not an Advice"
        if one.path not in paths:
            return f"it answered for <{one.path}>, which was not in the question"
        if one.material not in presets:
            return f"it named {one.material!r} for <{one.path}>, which is not a preset"
        sure = one.confidence
        if isinstance(sure, bool) or not isinstance(sure, (int, float)) or not 0.0 <= sure <= 1.0:
            return f"its confidence for <{one.path}> is {sure!r}, not a number from 0 to 1"
        if not isinstance(one.reason, str) or not one.reason.strip():
            return f"it gave no reason for <{one.path}>"
    answered = [one.path for one in answer]
    twice = [path for path in answered if answered.count(path) > 1]
    if twice:
        return f"it answered {answered.count(twice[0])} times for <{twice[0]}>"
    missing = [path for path in paths if path not in answered]
    return f"it did not answer for <{missing[0]}>" if missing else ""
