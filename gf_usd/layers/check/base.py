"""A rule of ``gf-usd check`` and its findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from pxr import Sdf, Tf, Usd

from gf_usd.core.errors import counted, plain_parse_error
from gf_usd.core.units import code_text

Severity = Literal["error", "warning"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fault in a file."""

    rule: str  # its name, such as "value-range"
    severity: Severity  # error | warning
    prim_path: str  # "/" for the stage itself
    message: str  # the fault, with its numbers
    fix: str  # how to fix it
    subject: str = ""  # the property of the prim, or the path of the file, that it is about


@dataclass(frozen=True, kw_only=True)
class Skip:
    """A check that a rule could not make, and why."""

    rule: str
    prim_path: str
    reason: str


Verdict = Finding | Skip
Judge = Callable[[Usd.Stage], Iterable[Verdict]]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """One row of the registry."""

    name: str
    holds: str  # the requirement, as text
    judge: Judge
    reads_samples: bool  # False: safe even with layers of 0 time codes per second

    def __call__(self, stage: Usd.Stage) -> Iterable[Verdict]:
        return self.judge(stage)


RULES: dict[str, Rule] = {}


def rule(name: str, holds: str, *, reads_samples: bool = True) -> Callable[[Judge], Judge]:
    """Register the decorated function as the rule ``name``."""

    def register(judge: Judge) -> Judge:
        if name in RULES:
            raise ValueError(f"two rules are named {name}")
        RULES[name] = Rule(name=name, holds=holds, judge=judge, reads_samples=reads_samples)
        return judge

    return register


@dataclass(frozen=True)
class Reporter:
    """Makes the findings of one rule about one prim, or about one of its properties."""

    rule: str
    prim_path: str
    subject: str = ""  # the property

    def error(self, message: str, fix: str) -> Finding:
        """A finding that makes the stage invalid; fix : what to do about it."""
        return self._finding("error", message, fix)

    def warning(self, message: str, fix: str) -> Finding:
        """A finding that leaves the stage valid; fix : what to do about it."""
        return self._finding("warning", message, fix)

    def skip(self, reason: str) -> Skip:
        """A record that the rule was not applied to the prim, and why."""
        return Skip(rule=self.rule, prim_path=self.prim_path, reason=reason)

    def _finding(self, severity: Severity, message: str, fix: str) -> Finding:
        return Finding(
            rule=self.rule,
            severity=severity,
            prim_path=self.prim_path,
            message=message,
            fix=fix,
            subject=self.subject,
        )


def about(rule_name: str, prim: Usd.Prim | Sdf.Path | str, name: str = "") -> Reporter:
    """The reporter of ``rule_name`` for a prim; name : of the property that it is about."""
    path = prim.GetPath() if isinstance(prim, Usd.Prim) else prim
    return Reporter(rule_name, str(path), name)


def first_problem(problems: Iterable[tuple[Usd.TimeCode, str]]) -> str:
    """The first problem with its time, and the number of other samples with one; "" where there is
    none.

    An array is usually wrong in every sample: that is one finding, not hundreds.
    """
    rest = iter(problems)
    first = next(rest, None)
    if first is None:
        return ""
    time, text = first
    more = sum(1 for _ in rest)
    when = "" if time.IsDefault() else f" at time {code_text(time.GetValue())}"
    return f"{text}{when}" + (f", and also in {counted(more, 'more sample')}" if more else "")


def reason(error: Tf.ErrorException) -> str:
    """The first error of USD, without its location in USD's source."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return "no reason given"
    return plain_parse_error(lines[0].partition(" : ")[2].strip("'"))


def unreadable(rule_name: str, error: Tf.ErrorException) -> Finding:
    """The finding that USD failed while a rule read the stage."""
    return about(rule_name, "/").error(
        f"USD cannot read the stage: {reason(error)}",
        "repair or re-export the named file: it is damaged, or was written for another USD version",
    )
