"""What a reader assumed, repaired or left alone, said once each."""

from __future__ import annotations


class Notes:
    """Remarks in the order of their first appearance; the same words at many places are one."""

    def __init__(self) -> None:
        self._places: dict[str, list[str]] = {}

    def add(self, text: str, where: str = "") -> None:
        """Record `text`, true at the prim path `where` (empty: of the whole file)."""
        places = self._places.setdefault(text, [])
        if where and where not in places:
            places.append(where)

    def lines(self) -> tuple[str, ...]:
        """One sentence a remark: ``PATH: text`` or ``PATH and 3 more: text``."""
        return tuple(
            f"{_some(places)}: {text}" if places else text for text, places in self._places.items()
        )


def _some(places: list[str]) -> str:
    if len(places) <= 2:
        return " and ".join(places)
    return f"{places[0]} and {len(places) - 1} more"
