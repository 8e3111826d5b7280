"""Advisors: plug-ins that choose materials, used only by name (`auto:NAME`).

An advisor is a callable in the entry point group `GROUP` of an installed distribution.  It takes a
`Question` and returns a list of `Advice`, one for each subject, with presets of the question.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from types import TracebackType

from gf_usd.core.errors import BakeError, GfUsdError, UsageError
from gf_usd.core.stage import Advice
from gf_usd.prepare.advice import AUTO, Question, answer_errors, with_fallback

GROUP = "gf_usd.material_advisors"
TIMEOUT = 120.0  # [s] for an answer: a large model on a small machine


def find_advisor(name: str) -> EntryPoint:
    """The advisor of that name, not yet imported; UsageError where there is none, or several."""
    known = entry_points(group=GROUP)
    found = [point for point in known if point.name == name]
    if not found:
        names = sorted({point.name for point in known})
        there = f"give one of {', '.join(names)}" if names else "no advisor is installed"
        another = "install another" if names else "install one"
        raise UsageError(
            f"there is no material advisor {name!r}",
            f"{there}; {another} (docs/materials.md), or use --material {AUTO}",
        )
    if len({point.value for point in found}) > 1:
        raise UsageError(
            f"{len(found)} advisors are named {name!r}: {', '.join(p.value for p in found)}",
            "uninstall all but one",
        )
    return found[0]


def ask_advisor(name: str, question: Question) -> tuple[Advice, ...]:
    """An advisor's answer, in the order of the subjects; rubber where its confidence is low.

    Raises
    ------
    UsageError : there is no such advisor.
    BakeError : it failed, gave no answer within TIMEOUT seconds, or an invalid one.
    """
    call = _Call(find_advisor(name), question)
    call.start()
    call.join(TIMEOUT)
    hint = f"fix the advisor or what it calls, or use --material {AUTO} without it"
    where = f"{question.file}: the material advisor {name!r}"
    if call.is_alive():
        raise BakeError(f"{where} gave no answer in {TIMEOUT:g} s", hint)
    if isinstance(call.error, GfUsdError):
        raise BakeError(f"{where} failed: {call.error.message}", call.error.hint) from call.error
    if call.error is not None:
        kind = type(call.error).__name__
        raise BakeError(f"{where} failed: {kind}: {call.error}", hint) from call.error
    wrong = answer_errors(call.answer, [s.path for s in question.subjects], list(question.presets))
    if wrong:
        raise BakeError(f"{where} gave a wrong answer: {wrong}", hint)
    by_path = {one.path: one for one in call.answer}
    return tuple(with_fallback(replace(by_path[s.path], by=name)) for s in question.subjects)


class _Call(threading.Thread):
    """A call whose exception is stored too, since the exceptions of a plug-in cannot be listed.

    It is a daemon thread, so that a plug-in that hangs does not prevent the program from ending.
    """

    def __init__(self, point: EntryPoint, question: Question) -> None:
        super().__init__(daemon=True)
        self._point, self._question = point, question
        self.answer: list[Advice] = []
        self.error: BaseException | None = None

    def run(self) -> None:
        with self:
            self.answer = self._point.load()(self._question)

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> bool:
        self.error = error
        return True
