"""gf-usd: make any USD or mesh asset soft.

>>> import gf_usd
>>> result = gf_usd.bake("duck.usda", material="rubber", particles=300, frames=4)
>>> result.root, result.frames
(PosixPath('duck.rubber.usda'), 4)

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gf_usd.core import __version__

if TYPE_CHECKING:
    from gf_usd.api.bake import bake
    from gf_usd.api.check import check
    from gf_usd.api.deliver import deliver, retime
    from gf_usd.api.drawing.compare import compare
    from gf_usd.api.drawing.preview import Preview, preview
    from gf_usd.api.inspect import inspect
    from gf_usd.api.materials import fit, materials
    from gf_usd.api.read import Bake, BakeFrame, read
    from gf_usd.api.report import report
    from gf_usd.api.scene import Scene
    from gf_usd.api.simulate import Simulation, SimulationFrame, simulate
    from gf_usd.core.errors import (
        BakeError,
        GfUsdError,
        InputError,
        SolverError,
        Unfinished,
        UnhealthyError,
        UsageError,
    )
    from gf_usd.core.frames.frame import Health
    from gf_usd.core.frames.settings import Settings
    from gf_usd.core.materials.material import Material
    from gf_usd.delivery.deliver import Delivered, DeliveredBody, DeliveredSplats
    from gf_usd.delivery.retime import Retimed
    from gf_usd.fitting.result import Estimate, FitResult, Reproduced
    from gf_usd.layers.check.base import Finding
    from gf_usd.layers.check.run import CheckResult
    from gf_usd.pipeline.health.warnings import HealthWarning
    from gf_usd.pipeline.inspect import Inspection
    from gf_usd.pipeline.result import BakeResult, VariantResult
    from gf_usd.view.compare import Comparison

_HOMES = {
    "bake": "gf_usd.api.bake",
    "check": "gf_usd.api.check",
    "compare": "gf_usd.api.drawing.compare",
    "deliver": "gf_usd.api.deliver",
    "fit": "gf_usd.api.materials",
    "inspect": "gf_usd.api.inspect",
    "materials": "gf_usd.api.materials",
    "preview": "gf_usd.api.drawing.preview",
    "read": "gf_usd.api.read",
    "report": "gf_usd.api.report",
    "retime": "gf_usd.api.deliver",
    "simulate": "gf_usd.api.simulate",
    "Bake": "gf_usd.api.read",
    "BakeFrame": "gf_usd.api.read",
    "BakeResult": "gf_usd.pipeline.result",
    "CheckResult": "gf_usd.layers.check.run",
    "Comparison": "gf_usd.view.compare",
    "Delivered": "gf_usd.delivery.deliver",
    "DeliveredBody": "gf_usd.delivery.deliver",
    "DeliveredSplats": "gf_usd.delivery.deliver",
    "Estimate": "gf_usd.fitting.result",
    "Finding": "gf_usd.layers.check.base",
    "FitResult": "gf_usd.fitting.result",
    "Health": "gf_usd.core.frames.frame",
    "HealthWarning": "gf_usd.pipeline.health.warnings",
    "Inspection": "gf_usd.pipeline.inspect",
    "Material": "gf_usd.core.materials.material",
    "Preview": "gf_usd.api.drawing.preview",
    "Reproduced": "gf_usd.fitting.result",
    "Retimed": "gf_usd.delivery.retime",
    "Scene": "gf_usd.api.scene",
    "Settings": "gf_usd.core.frames.settings",
    "Simulation": "gf_usd.api.simulate",
    "SimulationFrame": "gf_usd.api.simulate",
    "VariantResult": "gf_usd.pipeline.result",
    "GfUsdError": "gf_usd.core.errors",
    "UsageError": "gf_usd.core.errors",
    "InputError": "gf_usd.core.errors",
    "BakeError": "gf_usd.core.errors",
    "SolverError": "gf_usd.core.errors",
    "UnhealthyError": "gf_usd.core.errors",
    "Unfinished": "gf_usd.core.errors",
}

__all__ = [
    "Bake",
    "BakeError",
    "BakeFrame",
    "BakeResult",
    "CheckResult",
    "Comparison",
    "Delivered",
    "DeliveredBody",
    "DeliveredSplats",
    "Estimate",
    "Finding",
    "FitResult",
    "GfUsdError",
    "Health",
    "HealthWarning",
    "InputError",
    "Inspection",
    "Material",
    "Preview",
    "Reproduced",
    "Retimed",
    "Scene",
    "Settings",
    "Simulation",
    "SimulationFrame",
    "SolverError",
    "Unfinished",
    "UnhealthyError",
    "UsageError",
    "VariantResult",
    "__version__",
    "bake",
    "check",
    "compare",
    "deliver",
    "fit",
    "inspect",
    "materials",
    "preview",
    "read",
    "report",
    "retime",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gf_usd' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
