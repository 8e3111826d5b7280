"""gf-usd help: a page on what several commands have in common.

`main.execute` answers the name of a command by that command's own help."""

from __future__ import annotations

import difflib
from typing import Annotated

import typer

from gf_usd.core.errors import UsageError

TOPICS: dict[str, tuple[str, str]] = {
    "start": ("the first bake, in order", """\
gf-usd inspect duck.usda                     what would be baked, what is wrong, what it costs
gf-usd bake duck.usda --material rubber      writes duck.rubber.usda: open this one
gf-usd preview duck.rubber.usda -o duck.mp4  a film, without a window
gf-usd report duck.rubber.usda               a page with the motion and its curves
gf-usd check duck.rubber.usda                faults in the files, and how to fix each

The asset is never written to. The variant set gaussianFlesh has the variant none, which is
the asset as it was."""),
    "units": ("lengths, times and where they come from", """\
Lengths on the command line are in units of the asset, unless the help says [m]; 3r is three
radii of the body. USD files state their unit (metersPerUnit); the default of USD is
centimeters. OBJ, PLY, STL and OFF files have no unit: meters are assumed, or centimeters or
millimeters if only that makes the body a plausible size. --meters-per-unit overrides all of
these. A warning tells you when a body is implausibly large or small in an assumed unit.

Times are in frames (--frames, --clip-frames, --handles) or in time codes of the stage
(--start, --range, and preview's --frame and --time-codes). --fps is frames per second."""),
    "materials": ("what a body is made of", """\
gf-usd materials lists the presets. rubber, metal and jelly look alike at any size; presets
such as hard-rubber or mild-steel have moduli in pascals and behave as that size would.
--material takes a preset, a USD file with a material, several with commas between (each
becomes a variant), or auto. --friction, --restitution and --damping-time change one value.
A material that is too soft to carry its weight sinks into itself: take a stiffer one."""),
    "motion": ("what makes a body move", """\
It falls from --drop onto a floor (--floor) under --gravity. Where the stage has colliders,
they replace the floor, and the body falls only if --drop says so. --pin holds a region, or moves
it with the animation of the asset; --flesh makes a character soft around its skeleton. Initial
velocities come from --velocity and --spin, or from UsdPhysics in the stage. Without --frames the
bake ends when everything is at rest."""),
    "slow": ("a bake that takes too long", """\
Time grows with particles to the power 4/3, with the root of the stiffness, and with the
simulated time. In this order: --dry-run for the estimate, fewer --particles, a softer
--material, fewer --frames, --mass-scaling for stiff materials that flow. Pins with a large
--damping-time take many substeps: lower it. --max-hours is the limit above which a bake is
refused."""),
    "trouble": ("a result that looks wrong", """\
nothing moves or touches the floor     read the warning; check --drop, the unit, --frames
it falls in slow motion                the body is large: check --meters-per-unit
parts hang in the air                  they are open sheets: --repair, see gf-usd inspect
it sinks into the floor                more --particles, or a lower --drop
fingers or legs stick together         thinner than two spacings: more --particles
it looks faceted or jittery            read the report's warnings; more --particles
it does not move in the viewer         the file is usd with payloads: load them"""),
    "exit": ("exit statuses", """\
0 done; 1 failed while baking; 2 wrong usage; 3 the input was refused; 4 the result is wrong, or
warnings under --strict; 5 a slice is done; 130 and 143 interrupted."""),
    "config": ("gf-usd.toml: options of a folder", """\
gf-usd bake and gf-usd inspect read the nearest gf-usd.toml from the current folder upwards:

    [bake]
    material = "rubber"
    particles = 4000
    drop = 2.5

Names are those of the options, with underscores. The command line has priority, a note says
what was read, and a name that is no option is refused. Batch jobs and bakes with --events
do not read it."""),
}  # fmt: skip


OF_COMMANDS = "gf-usd help COMMAND is the same as gf-usd COMMAND --help"


def topic(
    about: Annotated[
        str | None, typer.Argument(metavar="TOPIC|COMMAND", help="What to explain.")
    ] = None,
) -> None:
    """Explain a topic, or a command; without one, list the topics."""
    if about is None:
        width = max(map(len, TOPICS))
        listed = [f"  {name:{width}}  {title}" for name, (title, _) in TOPICS.items()]
        typer.echo(
            "\n".join(["gf-usd help TOPIC explains one of these:", "", *listed, "", OF_COMMANDS])
        )
        return
    if about not in TOPICS:
        close = difflib.get_close_matches(about, TOPICS, n=1)
        guess = f"did you mean {close[0]}? " if close else ""
        raise UsageError(
            f"there is no topic {about!r}", f"{guess}topics are {', '.join(TOPICS)}; {OF_COMMANDS}"
        )
    title, text = TOPICS[about]
    typer.echo(f"{about}: {title}\n\n{text}")
