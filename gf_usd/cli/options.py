"""Options that bake and inspect have alike: one spelling, one help.

Options that say what of a bake is written, and in which form.
"""

from __future__ import annotations

from typing import Annotated

import typer

Material = Annotated[
    str | None,
    typer.Option(
        "--material",
        "-m",
        help="A preset (see gf-usd materials) or a USD file with a material; several with commas"
        " become variants. auto: by names and labels; auto:NAME asks an advisor.",
        show_default="what the stage says, else rubber",
    ),
]
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
Drop = Annotated[
    str | None,
    typer.Option(
        help="Height of the fall [stage units], or in radii of the body: 3r.",
        show_default="3r; 0 where the stage holds physics; as it is with --pin or no floor",
    ),
]
MetersPerUnit = Annotated[
    float | None,
    typer.Option(
        help="Size of the file's unit [m], e.g. 0.01.",
        show_default="what the file says; 1 for obj, ply, stl, off and splat files",
    ),
]
UpAxis = Annotated[
    str | None,
    typer.Option(
        help="Y or Z; -Y or -Z for splat files that hang.",
        show_default="what the file says; Y for obj, ply, off and splat files, Z for stl",
    ),
]
Solver = Annotated[
    str | None,
    typer.Option(
        help="tl (Total Lagrangian), or ul (Updated Lagrangian MLS-MPM, to compare with).",
        show_default="tl",
    ),
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


Only = Annotated[
    str | None,
    typer.Option(
        help="What is written: mesh, gaussians, points, or several with commas.",
        show_default="all three",
    ),
]
Flatten = Annotated[
    bool,
    typer.Option("--flatten", help="Write one file with the asset in it, instead of layers."),
]
SamplesPerFrame = Annotated[
    int | None,
    typer.Option(help="Simulated states written a frame, for motion blur.", show_default="1"),
]
Range = Annotated[
    str | None,
    typer.Option(
        help="FIRST:LAST, the time codes that are written; either may be left out.",
        show_default="all",
    ),
]
Handles = Annotated[
    int | None,
    typer.Option(
        help="Frames written before and after besides; before the start the rest pose is held.",
        show_default="0",
    ),
]
ClipFrames = Annotated[
    int | None,
    typer.Option(
        help="Split the cache into value clips of so many frames; 0: never.",
        show_default="one file up to 2 GB",
    ),
]
Resume = Annotated[
    bool,
    typer.Option("--resume", help="Go on from the last full clip of this bake, if it ended early."),
]
Slice = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="End after so many full clips (status 5), to go on with --resume.",
        show_default="never",
    ),
]
Half = Annotated[
    bool, typer.Option("--half", help="Half precision for what of the Gaussians it is safe for.")
]
