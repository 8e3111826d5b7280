"""`gf_usd.deliver`: a bake as a small file of joints or blend shapes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.host.guest import here_or_away
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options import values

if TYPE_CHECKING:
    from gf_usd.delivery.deliver import Delivered


def deliver(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    error: float = 0.005,
    variant: str | None = None,
    kind: str = "auto",
    max_joints: int = 400,
    max_shapes: int = 64,
) -> Delivered:
    """Write a bake as joints or blend shapes, for game engines, web pages and phones.

    >>> delivered = gf_usd.deliver(result.root, "duck.glb", error=0.02)
    >>> delivered.error <= 0.02
    True

    Parameters
    ----------
    path : root layer of a bake, or a flattened bake.
    output : .usdz, .usda, .usdc or .glb; a file of that name is replaced.
    error : the largest distance to the bake over points and frames, as a share of the radius of
        each body, that of a sphere of its volume.
    variant : only this one; None: all of them in a USD file, the selected one in a .glb.
    kind : "joints" (linear blend skinning), "shapes" (blend shapes), or "auto": the smaller file.
    max_joints : of a body.
    max_shapes : blend shapes of a body.

    Returns
    -------
    Delivered : path, bytes, error as read back from the file, and the joints and shapes of each
        body.

    Raises
    ------
    UsageError : an option makes no sense, or the output is an input.
    InputError : the file cannot be read, or nothing in it moves.
    BakeError : the limits do not allow the error, or the disk refuses.
    """
    with keywords("error", "max_joints", "max_shapes", "variant", **{"as": "kind"}):
        asked: dict[str, Any] = {
            "bake": asset_path(path),
            "target": Path(values.path("output", output)),
            "error": _share("error", error),
            "variant": variant,
            "kind": kind,
            "most_joints": values.whole("max_joints", max_joints),
            "most_shapes": values.whole("max_shapes", max_shapes),
        }
        return here_or_away("gf_usd.delivery.deliver:deliver", asked)[0]


def _share(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise values.refuse(name, value, "a share of the radius, such as 0.005")
    return float(value)


def read_share(text: str) -> float:
    """0.005 of "0.5%" or "0.005".  Raises UsageError for what is no number."""
    number = text.strip()
    try:
        return float(number[:-1]) / 100.0 if number.endswith("%") else float(number)
    except ValueError:
        raise UsageError(
            f"--error is {text!r}.", "give a share of the radius, such as 0.5% or 0.005"
        ) from None
