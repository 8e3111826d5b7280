"""gf-usd deliver: a bake as joints or blend shapes."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from gf_usd.delivery.deliver import Delivered


def deliver(
    bake: Annotated[Path, typer.Argument(help="Root layer of a bake, or a flattened bake.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .usdz, .usda, .usdc or .glb; one of that name is replaced.",
        ),
    ],
    error: Annotated[
        str,
        typer.Option(
            metavar="SHARE",
            help="Largest distance to the bake over points and frames, of the radius of each body:"
            " 0.5% or 0.005.",
        ),
    ] = "0.5%",
    variant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Variant of the bake to write.",
            show_default="all of them in USD, the selected one in glTF",
        ),
    ] = None,
    kind: Annotated[
        str,
        typer.Option(
            "--as", metavar="KIND", help="joints, shapes (blend shapes), or auto: the smaller file."
        ),
    ] = "auto",
    max_joints: Annotated[int, typer.Option(metavar="N", help="Joints of a body at most.")] = 400,
    max_shapes: Annotated[
        int, typer.Option(metavar="N", help="Blend shapes of a body at most.")
    ] = 64,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
) -> None:
    """Write a bake as joints or blend shapes, for game engines, web pages and phones.

    The error is measured on the file that was written.  Particles and captured splats are left out.
    """
    # SciPy and pxr take a second to import, which --help must not wait for
    from gf_usd.api.deliver import read_share
    from gf_usd.delivery.deliver import deliver as write

    share = read_share(error)
    done = write(
        bake, output, error=share, variant=variant, kind=kind, most_joints=max_joints,
        most_shapes=max_shapes,
    )  # fmt: skip
    for note in done.notes:
        typer.echo(f"note: {note}", err=True)
    if as_json:
        typer.echo(json.dumps(_as_json(done), indent=1))
        return
    for body in done.bodies:
        name = f"{body.variant}: " if body.variant else ""
        meshes = ", ".join(body.meshes[:3]) + (", ..." if len(body.meshes) > 3 else "")
        typer.echo(f"{name}{meshes}: {described(body.joints, body.shapes)}")
    typer.echo(
        f"{done.path}: {done.bytes / 1000:.0f} kB, {done.frames} frames, largest error"
        f" {100 * done.error:.2g} % of the radius"
    )


def described(joints: int, shapes: int) -> str:
    """In words, how a body is moved."""
    if joints:
        return f"{joints + 1} joints"
    return f"{shapes} blend shapes on 1 joint" if shapes else "1 joint"


def _as_json(done: Delivered) -> dict[str, object]:
    return {**asdict(done), "path": str(done.path)}
