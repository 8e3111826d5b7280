"""Errors that a user can act on: what is wrong, with the numbers, and what to do."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SIMILAR = 0.6  # least similarity of a name that a hint gives, by difflib's ratio of equal letters

CHOICE = re.compile(r"\[([^/\]]*)/([^\]]*)\]")  # a singular and a plural

# As USD writes it: the rule of the grammar in C++, possibly a template with others as arguments.
PARSE_ERROR = re.compile(r"parse error matching (?:\w+::)*(\w+)(<.*?>)?(?= at '|$)")


def counted(count: int, one: str, many: str = "") -> str:
    """A number with its noun, "1 frame" or "2 frames"; many : a plural that is not one with s."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def agreed(count: int, text: str) -> str:
    """A text that agrees with a count: "[it is/they are] open" gives "it is open" for 1, else "they
    are open".
    """
    return CHOICE.sub(lambda found: found[1 if count == 1 else 2], text)


def listed(texts: Sequence[str], most: int = 4, join: str = ", ") -> str:
    """The first of some texts, and how many more there are: "a, b and 3 more"."""
    left = len(texts) - most
    before = "" if join == ", " else join.rstrip()
    return join.join(texts[:most]) + (f"{before} and {left} more" if left > 0 else "")


def listed_paths(paths: Sequence[str], most: int = 4) -> str:
    """`listed` for prim paths, in angle brackets."""
    return listed([f"<{path}>" for path in paths], most)


def similar(name: str, known: Iterable[str], *, most: int = 1) -> list[str]:
    """Up to `most` of the known names that are similar to one, nearest first, in upper or lower
    case.
    """
    by_lower = {one.lower(): one for one in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=most, cutoff=SIMILAR)
    return [by_lower[one] for one in close]


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The start of a hint, "did you mean NAME? ", or "" where no known name is similar."""
    return meant(similar(name, known))


def meant(names: Sequence[str]) -> str:
    """The start of a hint at names, "did you mean NAME or OTHER? "; "" for none."""
    return f"did you mean {' or '.join(names)}? " if names else ""


def plain_parse_error(text: str) -> str:
    """An error of USD's text parser, without the names of its source."""
    return PARSE_ERROR.sub(lambda m: "syntax error" if m[2] else f"{m[1]} is expected", text)


class GfUsdError(Exception):
    """An expected failure, reported without a traceback.

    Parameters
    ----------
    message : what is wrong; names the file, the prim path and the numbers.
    hint : what to do about it.
    """

    exit_status = 1

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message: str = message
        self.hint: str = hint

    def __str__(self) -> str:
        return f"{self.message}\n\nhint: {self.hint}"

    def __reduce__(self) -> tuple[Any, ...]:
        # Exception gives its `args`, the message alone, to the class: a pool of processes whose
        # worker raised this would never end.
        return _unpickled, (type(self), self.message), dict(self.__dict__)


def _unpickled(kind: type[GfUsdError], message: str) -> GfUsdError:
    error = kind.__new__(kind, message)
    error.args = (message,)
    return error


class UsageError(GfUsdError):
    """The options do not make sense (exit status 2); nothing was read or written."""

    exit_status = 2


class InputError(GfUsdError):
    """The input was refused (exit status 3); nothing was written."""

    exit_status = 3


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Context whose InputErrors name a file, where they do not yet."""
    try:
        yield
    except InputError as refused:
        if str(path) in refused.message:
            raise
        raise InputError(f"{path}: {refused.message}", refused.hint) from refused


class SchemaTooLate(GfUsdError):
    """USD read its schema definitions before those of gf-usd were registered."""


class BakeError(GfUsdError):
    """The bake failed while running (exit status 1); only ``*.partial.*`` files remain."""

    exit_status = 1


class Unfinished(GfUsdError):
    """A slice of a bake is done, and the rest can be resumed (exit status 5).

    variant : in which it ended; done : frames of it that are done, of `frames`.
    """

    exit_status = 5

    def __init__(self, message: str, hint: str, *, variant: str, done: int, frames: int) -> None:
        super().__init__(message, hint)
        self.variant: str = variant
        self.done: int = done
        self.frames: int = frames


class SolverError(BakeError):
    """The simulation failed: a BakeError.

    frame : the first frame that could not be computed; particle : the one where it went wrong, or
        -1.
    """

    def __init__(self, message: str, hint: str, *, frame: int, particle: int = -1) -> None:
        super().__init__(message, hint)
        self.frame: int = frame
        self.particle: int = particle


class OutOfResources(SolverError):
    """The disk or the memory is nearly full; finished frames are kept, and clips can be resumed."""


class UnhealthyError(GfUsdError):
    """The bake was written, but its result is wrong, or `strict` was set and it has warnings.

    The exit status of the command line is 4.

    warnings : the `HealthWarning`s; result : the `BakeResult`.
    """

    exit_status = 4

    def __init__(self, message: str, hint: str, *, warnings: tuple[Any, ...], result: Any) -> None:
        super().__init__(message, hint)
        self.warnings: tuple[Any, ...] = warnings
        self.result: Any = result
