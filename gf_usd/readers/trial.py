"""Read an asset in a child process first, so that a file that crashes a library harms nothing."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from gf_usd.system.sandbox import Limits, _isolates, attempt


def try_asset(path: Path, limits: Limits | None, **options: Any) -> None:
    """Read an asset in a child, as a bake will; options are those of `read_untrusted`.

    Raises InputError as `attempt` does.  What the reader refuses is left for the parent to say.
    """
    if _isolates(path, limits):
        _import_readers(path)
    attempt(path, lambda: read_untrusted(path, **options), limits)


def _import_readers(path: Path) -> None:
    """What a child would import, and the parent again after it, at the price of the whole trial."""
    from gf_usd.readers import READERS, USD

    suffix = path.suffix.lower()
    if suffix in READERS:
        import_module(READERS[suffix].split(":")[0])
    if suffix in USD:
        for name in ("usd_bake.settings", "usd_physics.scene"):
            import_module(f"gf_usd.readers.{name}")


def read_untrusted(
    path: Path,
    *,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    time_code: float | None = None,
    elastic: bool = True,
) -> None:
    """All that a bake reads of a file before it fills it.

    The options are those of `read_asset` and `read_words`.  Raises InputError as these do.
    """
    from gf_usd.readers import convert, read_asset
    from gf_usd.readers.usd_bake.spec import read_words

    converted = convert(path, meters_per_unit=meters_per_unit, up_axis=up_axis)
    if converted is not None:
        converted.asset(prims=tuple(prims), time_code=time_code)
        return
    asset = read_asset(
        path, prims=prims, meters_per_unit=meters_per_unit, up_axis=up_axis, time_code=time_code
    )
    if asset.surfaces:
        read_words(asset, path, prims, rest=time_code, elastic=elastic)
