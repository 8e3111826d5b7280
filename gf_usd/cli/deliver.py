"""gf-usd deliver: a bake as joints or blend shapes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gf_usd.cli.quiet import QuietExceptJson
from gf_usd.core.errors import counted
from gf_usd.core.units import bytes_text, percent_text

if TYPE_CHECKING:
    from gf_usd.delivery.deliver import Delivered, DeliveredBody, DeliveredSplats


def deliver(
    bake: Annotated[Path, typer.Argument(help="Root layer of a bake, or a flattened bake.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .usdz, .usda, .usdc or .glb; an existing file is replaced.",
        ),
    ],
    error: Annotated[
        str,
        typer.Option(
            metavar="SHARE",
            help="Largest allowed distance from the bake over all points and frames, as a"
            " fraction of the radius of each body: 0.5% or 0.005.",
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
    max_joints: Annotated[
        int, typer.Option(metavar="N", help="Maximum number of joints per body.")
    ] = 400,
    max_shapes: Annotated[
        int, typer.Option(metavar="N", help="Maximum number of blend shapes per body.")
    ] = 64,
    splats: Annotated[
        str,
        typer.Option(
            metavar="WHICH",
            help="Gaussians to write: captured; all (in .glb), also those of the bake; only (in"
            " .glb), Gaussians without meshes; or none.",
        ),
    ] = "captured",
    bind_splats: Annotated[
        str,
        typer.Option(
            metavar="HOW",
            help="How Gaussians follow joints in .glb: skin, or nodes (one joint each), which"
            " more viewers support but which --error does not bound.",
        ),
    ] = "skin",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON on stdout.")] = False,
    quiet: QuietExceptJson = False,
) -> None:
    """Write a bake as joints or blend shapes, for game engines, web pages and phones.

    The error is measured on the written file.
    """
    # SciPy and pxr take a second to import, which --help must not wait for
    from gf_usd.api.deliver import read_share
    from gf_usd.delivery.deliver import deliver as write

    share = read_share(error)
    done = write(
        bake, output, error=share, variant=variant, kind=kind, most_joints=max_joints,
        most_shapes=max_shapes, splats=splats, bind_splats=bind_splats,
    )  # fmt: skip
    if as_json:
        typer.echo(json.dumps(_as_json(done), indent=1))
    if quiet:
        return
    for note in done.notes:
        typer.echo(f"note: {note}", err=True)
    if not as_json:
        _show(done)


def _show(done: Delivered) -> None:
    for body in (body for body in done.bodies if body.moves):
        name = f"{body.variant}: " if body.variant else ""
        typer.echo(f"{name}{_listed([*body.meshes, *body.splats])}: {described(body)}")
    if still := [mesh for body in done.bodies if not body.moves for mesh in body.meshes]:
        typer.echo(f"{_listed(still)}: {'do' if still[1:] else 'does'} not move")
    for cloud in done.splats:
        name = f"{cloud.variant}: " if cloud.variant else ""
        typer.echo(f"{name}<{cloud.path}>: {error_text(cloud)}")
    typer.echo(
        f"{done.path}: {bytes_text(done.bytes)}, {counted(done.frames, 'frame')}, largest error"
        f" {percent_text(done.error)} of the radius"
    )


def _listed(paths: Sequence[str]) -> str:
    return ", ".join(paths[:3]) + (", ..." if len(paths) > 3 else "")


def described(body: DeliveredBody) -> str:
    """Text on how a body is moved."""
    if body.joints:
        return f"{body.joints + 1} joints"
    if body.shapes:
        return f"{counted(body.shapes, 'blend shape')} on 1 joint"
    return "1 joint"


def error_text(cloud: DeliveredSplats) -> str:
    """Text on the error of the Gaussians."""
    middle, most, largest = (percent_text(share) for share in cloud.covariance)
    return (
        f"{cloud.count} Gaussians, position error at most {percent_text(cloud.position)} of the "
        f"radius; covariance error {middle} (median), {most} (99 in 100), {largest} (largest)"
    )


def _as_json(done: Delivered) -> dict[str, object]:
    return {**asdict(done), "path": str(done.path)}
