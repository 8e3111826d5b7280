"""Options that say what of a bake is written, and in which form."""

from __future__ import annotations

from typing import Annotated

import typer

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
