"""`gf_usd.check`: finds problems in a USD file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.prepare.options import values

if TYPE_CHECKING:
    from gf_usd.layers.check.run import CheckResult
    from gf_usd.system.sandbox import Limits


def check(
    path: str | os.PathLike[str],
    *,
    limits: Limits | Mapping[str, float] | Literal[False] | str | None = None,
) -> CheckResult:
    """Check a file with UsdValidation and the rules of gf-usd; each finding says how to fix it.

    >>> gf_usd.check(result.root).ok
    True

    Parameters
    ----------
    path : any USD file, a bake or not.
    limits : of a process that reads it, {"time": [s], "memory": [B], "output": [B]}; None: this
        process reads it.

    Returns
    -------
    CheckResult : `ok`, and `findings` with severity, rule, prim_path, message and fix.

    Raises
    ------
    InputError : the file does not exist, or USD cannot open it.
    """
    with keywords("limits"):
        file = asset_path(path)
        most = None if limits is None else values.limits("limits", limits)
        return run_here_or_separately(
            "gf_usd.api.check:check_here", {"path": file, "limits": most}
        )[0]


def check_here(path: Path, limits: Limits | None) -> CheckResult:
    """See `check`; in this process."""
    from gf_usd.system.sandbox import run_isolated

    return run_isolated(path, "gf_usd.layers.check.run:check_file", limits, path)
