"""Collects USD's warnings as counted notes, instead of lines on the terminal."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pxr import Ar, UsdShade, UsdUtils

from gf_usd.core.errors import listed

SHOWN = 2  # kinds of warnings that a note quotes
# parts of a warning that differ between stages with the same fault
PLACE = re.compile(
    r"\s*\((re)?(composing|instantiating|getting)[^()]*( stage on stage [^()]*)?\)\s*$"
)

# Files that USD cannot find, and what its validator of missing files makes of their paths.
MISSING = re.compile(
    r"Failed to resolve reference @(.+?)@ with computed asset path @(.+?)@ found"
    r"|Could not open asset @(.+?)@ for "
)
FILE_AS_PRIM = "Ill-formed SdfPath <{}>"
# USD looks for a file of the name of a UDIM pattern, which is none, and for one tile in a package,
# which it does not recognize.
TILES = "<UDIM>"
PATTERN = re.compile(
    r"Failed to resolve reference @.+?@ with computed asset path @(.+?)@ found in layer @(.+?)@"
)
FIRST_TILE = "Resolution of first udim tile gave"  # printed only where a tile was found


class Warned:
    """The warnings of USD so far."""

    def __init__(self) -> None:
        self._delegate: UsdUtils.CoalescingDiagnosticDelegate | None = (
            UsdUtils.CoalescingDiagnosticDelegate()
        )
        self._counts: Counter[str] = Counter()

    @property
    def counts(self) -> Counter[str]:
        """Number of occurrences of each warning."""
        for one in self._delegate.TakeUncoalescedDiagnostics() if self._delegate else ():
            self._counts[_kind(one.commentary)] += 1
        return self._counts

    def end(self) -> None:
        """Stop collecting; USD prints warnings again."""
        _ = self.counts
        self._delegate = None

    def lines(self, reported: Collection[str] = (), stated: Iterable[str] = ()) -> tuple[str, ...]:
        """A note on the warnings that are not in `reported`; none where there are none.

        stated : notes and findings; warnings of files that they name as missing are left out, and
        so are those of UDIM textures that have tiles.
        """
        counts = self.counts
        known = {*reported, *_repeated(counts, "\n".join(stated)), *filter(_of_tiles, counts)}
        kinds = sorted(text for text in counts if text not in known)
        if not kinds:
            return ()
        count = sum(counts[text] for text in kinds)
        times = "once" if count == 1 else f"{count} times"
        return (f"USD warned {times}: {listed(kinds, SHOWN, '; ')}",)


def _repeated(warnings: Collection[str], stated: str) -> Iterator[str]:
    """Warnings of missing files that another warning, or the text `stated`, reports."""
    missing: set[str] = set()
    for text in warnings:
        if found := MISSING.search(text):
            names = [name for name in found.groups() if name]
            missing.update(names)
            if any(name in stated for name in names):
                yield text
    faults = tuple(FILE_AS_PRIM.format(name) for name in missing)
    yield from (text for text in warnings if text.startswith(faults))


def _of_tiles(text: str) -> bool:
    """Whether a warning is of a UDIM texture that has tiles."""
    if text.startswith(FIRST_TILE):
        return True
    found = PATTERN.match(text)
    if not found:
        return False
    path, layer = found.groups()
    if not Path(Ar.SplitPackageRelativePathOuter(path)[0]).is_absolute():
        package = Ar.SplitPackageRelativePathInner(layer)[0] or layer
        path = Ar.JoinPackageRelativePath(package, path)
    return has_tiles(path)


def has_tiles(path: str) -> bool:
    """Whether a path is that of a UDIM texture, absolute or in a package, for which tiles exist."""
    return TILES in path and bool(UsdShade.UdimUtils.ResolveUdimTilePaths(path, None))


@contextmanager
def gathered() -> Iterator[Warned]:
    """Collect USD's warnings within the block, instead of printing them."""
    found = Warned()
    try:
        yield found
    finally:
        found.end()


def _kind(text: str) -> str:
    return PLACE.sub("", " ".join(text.split()))
