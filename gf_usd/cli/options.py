"""Options that bake and inspect have alike: one spelling, one help."""

from __future__ import annotations

from typing import Annotated

import typer

Particles = Annotated[
    int | None, typer.Option(help="About how many particles.", show_default="8000")
]
Spacing = Annotated[float | None, typer.Option(help="Distance of particles [stage units].")]
Frames = Annotated[
    int | None, typer.Option(help="How many frames.", show_default="13.6 T of the body")
]
Fps = Annotated[
    float | None,
    typer.Option(help="Frames per second.", show_default="the asset's, else 24"),
]
Start = Annotated[
    float | None,
    typer.Option(help="First time code.", show_default="the asset's start, else 1"),
]
Prims = Annotated[
    list[str] | None,
    typer.Option(help="Prim path to bake, repeatable.", show_default="the default prim"),
]
Seed = Annotated[
    int | None, typer.Option(help="Of the random sampling.", show_default="the stage's, else 0")
]
Combine = Annotated[
    bool, typer.Option("--combine", help="All meshes are one body, also where they lie apart.")
]
MaterialBoxes = Annotated[
    list[str] | None,
    typer.Option(
        "--material-box",
        help="A preset for what rests in a box, PRESET:x0,y0,z0,x1,y1,z1 [stage units];"
        " repeatable, the later one goes first.",
        show_default="nothing",
    ),
]
MaterialLabels = Annotated[
    list[str] | None,
    typer.Option(
        "--material-label",
        help="A preset for captured Gaussians of a label, NAME=VALUE:PRESET; repeatable.",
        show_default="nothing",
    ),
]
LimitsOf = Annotated[
    str | None,
    typer.Option(
        "--limits",
        help="Of the process that tries an untrusted file first: time [s], memory [B], output [B]"
        " as time=600,memory=32G; none reads it at once.",
        show_default="time=300,memory=16G,output=1G",
    ),
]
