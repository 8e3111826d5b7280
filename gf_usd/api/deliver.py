"""`gf_usd.deliver` and `gf_usd.retime`: write a bake as a small file, or at another speed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options import values

if TYPE_CHECKING:
    from gf_usd.delivery.deliver import Delivered
    from gf_usd.delivery.retime import Retimed

Kind = Literal["auto", "shapes", "joints"]
Splats = Literal["captured", "all", "only", "none"]
Binding = Literal["skin", "nodes"]
KINDS, SPLATS, BINDINGS = map(get_args, (Kind, Splats, Binding))


def deliver(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    error: float | str = 0.005,
    variant: str | None = None,
    kind: Kind = "auto",
    max_joints: int = 400,
    max_shapes: int = 64,
    splats: Splats = "captured",
    bind_splats: Binding = "skin",
) -> Delivered:
    """Write a bake as joints or blend shapes, for game engines, web pages and phones.

    >>> delivered = gf_usd.deliver(result.root, "duck.glb", error=0.02)
    >>> delivered.error <= 0.02
    True

    Parameters
    ----------
    path : root layer of a bake, or a flattened bake.
    output : .usdz, .usda, .usdc or .glb; a file of that name is replaced.
    error : the largest distance from the bake over points and frames, as a fraction of the radius
        of each body, which is that of a sphere of its volume: 0.02, or "2%".
    variant : write only this variant; None: all of them in a USD file, the selected one in a .glb.
    kind : "joints" (linear blend skinning), "shapes" (blend shapes), or "auto": the smaller file.
    max_joints : of a body.
    max_shapes : blend shapes of a body.
    splats : which Gaussians to write: "captured"; "all", also those of the bake; "only", without
        the meshes; or "none".  "all" and "only" require a .glb.
    bind_splats : how Gaussians follow joints in a .glb: "skin", with weights like vertices, or
        "nodes", each parented to one joint, which more viewers support but `error` does not bound.

    Returns
    -------
    Delivered : path, bytes, error as read back from the file, the joints and shapes of each body,
        and the errors of the Gaussians of each set, in position and covariance.

    Raises
    ------
    UsageError : an option makes no sense, or the output is an input.
    InputError : the file cannot be read, or nothing in it moves.
    BakeError : the limits do not allow the error, or a file cannot be written.
    """
    with keywords(
        "error", "max_joints", "max_shapes", "splats", "bind_splats", "variant", **{"as": "kind"}
    ) as names:
        arguments: dict[str, Any] = {
            "bake": asset_path(path),
            "target": Path(values.path("output", output)),
            "error": _share("error", error),
            "variant": values.variant("variant", variant),
            "kind": values.choice("kind", kind, KINDS),
            "most_joints": values.positive("max_joints", max_joints),
            "most_shapes": values.positive("max_shapes", max_shapes),
            "splats": values.choice("splats", splats, SPLATS),
            "bind_splats": values.choice("bind_splats", bind_splats, BINDINGS),
        }
        done, _ = run_here_or_separately("gf_usd.delivery.deliver:deliver", arguments)
        return names.in_notes(done)


def retime(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    speed: float | None = None,
    keys: Sequence[tuple[float, float]] | str | None = None,
) -> Retimed:
    """Write a bake at another speed, without simulating again.

    >>> slow = gf_usd.retime(result.root, "slow.usda", speed=0.5)
    >>> slow.frames
    7

    Positions between two frames of the bake follow the cubic through their positions and
    velocities; rotations and everything else are interpolated linearly.  Velocities are those of
    the retimed motion.

    Parameters
    ----------
    path : root layer of a bake.
    output : the root layer to write (.usda, .usdc, .usd); its cache is written next to
        it.  Existing files are replaced.
    speed : speed relative to the bake; 0.5 is slow motion.  The animation of the source plays at
        the same speed.
    keys : pairs (time code of the result, time code of the bake), for a varying speed: equal time
        codes of the bake hold a pose, decreasing ones play backwards.  The animation of the source
        follows them.  Or a string: "1:1,48:24".

    Returns
    -------
    Retimed : the root layer, its caches, the number of frames and the time codes.

    Raises
    ------
    UsageError : not exactly one of speed and keys was given, or the values make no sense.
    InputError : the file cannot be read or is not a root layer with caches, or keys were given and
        one of its variants is animated in the root layer itself.
    BakeError : a file cannot be written.
    """
    with keywords("speed", "keys") as names:
        arguments: dict[str, Any] = {
            "bake": asset_path(path),
            "target": Path(values.path("output", output)),
            "speed": None if speed is None else values.real("speed", speed),
            "keys": None if keys is None else _pairs(keys),
        }
        done, _ = run_here_or_separately("gf_usd.delivery.retime:retime", arguments)
        return names.in_notes(done)


PAIRS = "pairs (time code of the result, time code of the bake)"


def _pairs(keys: object) -> list[tuple[float, float]]:
    if isinstance(keys, str):
        return read_keys(keys)
    found = []
    for pair in values.items("keys", keys, PAIRS):
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise values.refuse("keys", keys, PAIRS)
        found.append((values.real("keys", pair[0], PAIRS), values.real("keys", pair[1], PAIRS)))
    return found


def read_keys(text: str) -> list[tuple[float, float]]:
    """((1, 1), (48, 24)) from "1:1,48:24". Raises UsageError for an invalid text."""
    found = []
    for pair in text.split(","):
        try:
            new, old = (float(number) for number in pair.split(":"))
        except ValueError:
            raise UsageError(
                f"--keys is {text!r}, but {pair!r} is not a pair of time codes",
                "give NEW:OLD pairs, such as 1:1,48:24,60:48",
            ) from None
        found.append((new, old))
    return found


def _share(name: str, value: object) -> float:
    if isinstance(value, str):
        return read_share(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise values.refuse(name, value, "a share of the radius, such as 0.005 or '0.5%'")
    return float(value)


def read_share(text: str) -> float:
    """0.005 from "0.5%" or "0.005". Raises UsageError for an invalid text."""
    number = text.strip()
    try:
        return float(number[:-1]) / 100.0 if number.endswith("%") else float(number)
    except ValueError:
        raise UsageError(
            f"--error is {text!r}", "give a share of the radius, such as 0.5% or 0.005"
        ) from None
