"""Notes on poorly filled parts, of a bake and of an inspection."""

from __future__ import annotations

from collections.abc import Sequence

from gf_usd.core.errors import agreed, counted
from gf_usd.core.frames.particles import times_as_long
from gf_usd.core.units import length_text
from gf_usd.geometry.thin.parts import WHOLE, Part, suggestion


def poor_note(parts: Sequence[Part], particles: int) -> str:
    """A note on the poorly filled parts, the largest of which is the first; "" without any.

    Specks have a note of their own, `specks_note`.

    particles : of the bake.
    """
    thin = [part for part in parts if not part.speck]
    if not thin:
        return ""
    one, more = thin[0], len(thin) > 1
    place = f"shell {one.shell}" if one.kind in WHOLE else "a region"
    where = f"{place} of <{one.path}>, {length_text(one.size)} large and {_thick(one)}"
    contain, them = (agreed(len(thin), text) for text in ("[contains/contain]", "[it/them]"))
    what = f"{contain} {poor_text(thin, particles, them)}"
    return (
        f"{counted(len(thin), 'part')} {what}"
        f" ({'the largest: ' if more else ''}{where}; gf-usd inspect shows where)"
    )


def poor_text(parts: Sequence[Part], particles: int, them: str = "them") -> str:
    """What is wrong with poorly filled parts, and the number of particles that fills `them`, with
    its cost.

    particles : of the bake.
    """
    needed = suggestion(tuple(parts))
    which = "all but the thinnest" if any(p.suggested is None for p in parts) else them
    more = ""
    if needed and needed > particles:
        longer = times_as_long(needed, particles)
        more = f"; --particles {needed} would fill {which}" + (f" and take {longer}" * bool(longer))
    return f"few particles or none, and may be too stiff{more}"


def specks_note(parts: Sequence[Part]) -> str:
    """A note on the specks of these parts, the largest of which is the first; "" without any."""
    specks = [part for part in parts if part.speck]
    if not specks:
        return ""
    count, one = len(specks), specks[0]
    size = f"{'up to ' if count > 1 else ''}{length_text(one.size)} large"
    where = f"shell {one.shell} of <{one.path}>" + (f" and {count - 1} more" if count > 1 else "")
    return (
        f"{counted(count, 'speck')}, {size}, {'is' if count == 1 else 'are'} apart from the rest"
        f" and too small for the spacing ({where}): delete {'it' if count == 1 else 'them'} from"
        f" the mesh if {'it is' if count == 1 else 'they are'} noise of a scan"
    )


def _thick(part: Part) -> str:
    return "of loose faces" if part.loose else f"{length_text(part.thickness)} thick"
