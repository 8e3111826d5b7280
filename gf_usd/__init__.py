"""gf-usd: make any USD or mesh asset soft.

>>> import gf_usd
>>> result = gf_usd.bake("duck.usda", material="rubber")  # doctest: +SKIP
>>> result.root, result.health["restitution"]  # doctest: +SKIP

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from gf_usd.baking import bake
    from gf_usd.errors import (
        BakeError,
        GfUsdError,
        InputError,
        SolverError,
        UnhealthyError,
        UsageError,
    )
    from gf_usd.model import Material, Settings
    from gf_usd.plan import BakeResult

_HOMES = {
    "bake": "gf_usd.baking",
    "BakeResult": "gf_usd.plan",
    "Material": "gf_usd.model",
    "Settings": "gf_usd.model",
    "GfUsdError": "gf_usd.errors",
    "UsageError": "gf_usd.errors",
    "InputError": "gf_usd.errors",
    "BakeError": "gf_usd.errors",
    "SolverError": "gf_usd.errors",
    "UnhealthyError": "gf_usd.errors",
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
