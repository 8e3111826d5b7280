"""gf-usd: make any USD or mesh asset soft.

>>> import gf_usd
>>> result = gf_usd.bake("duck.usda", material="rubber")  # doctest: +SKIP
>>> result.root, result.health["restitution"]  # doctest: +SKIP

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gf_usd.core import __version__

if TYPE_CHECKING:
    from gf_usd.api.bake import bake
    from gf_usd.core.errors import (
        BakeError,
        GfUsdError,
        InputError,
        SolverError,
        UnhealthyError,
        UsageError,
    )
    from gf_usd.core.frames import Settings
    from gf_usd.core.materials import Material
    from gf_usd.pipeline.result import BakeResult

_HOMES = {
    "bake": "gf_usd.api.bake",
    "BakeResult": "gf_usd.pipeline.result",
    "Material": "gf_usd.core.materials",
    "Settings": "gf_usd.core.frames",
    "GfUsdError": "gf_usd.core.errors",
    "UsageError": "gf_usd.core.errors",
    "InputError": "gf_usd.core.errors",
    "BakeError": "gf_usd.core.errors",
    "SolverError": "gf_usd.core.errors",
    "UnhealthyError": "gf_usd.core.errors",
}

__all__ = [
    "BakeError",
    "BakeResult",
    "GfUsdError",
    "InputError",
    "Material",
    "Settings",
    "SolverError",
    "UnhealthyError",
    "UsageError",
    "__version__",
    "bake",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gf_usd' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
