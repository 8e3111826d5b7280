"""gf-usd help: pages on topics that several commands have in common.

`main.execute` shows a command's own help for the name of a command.
"""

from __future__ import annotations

from typing import Annotated

import typer

from gf_usd.core.errors import UsageError, did_you_mean

TOPICS: dict[str, tuple[str, str]] = {
    "start": ("the first bake, in order", """\
gf-usd inspect duck.usda                     what a bake would do, problems, cost
gf-usd bake duck.usda --material rubber      writes duck.rubber.usda: open this one
gf-usd preview duck.rubber.usda -o duck.mp4  a film, without a window
gf-usd report duck.rubber.usda               a page with the motion and its curves
gf-usd check duck.rubber.usda                problems in the files, and how to fix them

The asset file is never modified. The variant none of the variant set gaussianFlesh is the
unchanged asset."""),
    "units": ("units of lengths and times", """\
Lengths on the command line are in units of the asset, unless the help says [m]; 3r is three
radii of the body. USD files state their unit (metersPerUnit); the default of USD is
centimeters. OBJ, PLY, STL and OFF files have no unit: meters are assumed, or centimeters or
millimeters if only that makes the body a plausible size. --meters-per-unit overrides all of
these. There is a warning where a body is implausibly large or small in an assumed unit.

Times are in frames (--frames, --clip-frames, --handles) or in time codes of the stage
(--start, --range, and preview's --frame and --time-codes). --fps is frames per second."""),
    "materials": ("presets and other materials", """\
gf-usd materials lists the presets. rubber, metal and jelly deform alike at any size; presets
such as hard-rubber or mild-steel have moduli in pascals, so their stiffness depends on the size.
--material takes a preset, a USD file with a material, several of these separated by commas
(one variant each), or auto. --friction, --restitution and --damping-time change one value.
A body that is too soft to support its weight collapses: use a stiffer material. Slender parts, such
as the legs of a chair, may collapse even of metal: use hard-rubber or mild-steel."""),
    "motion": ("what makes a body move", """\
A body falls from the height --drop onto a floor (--floor) under --gravity. If the stage has
colliders, they replace the floor, and the body is lifted only if you give --drop. --pin fixes a
region, or moves it with the animation of the asset; --flesh makes a character soft around its
skeleton. Initial velocities come from --velocity and --spin, or from UsdPhysics in the stage.
Without --frames the bake ends when everything is at rest."""),
    "slow": ("a bake that takes too long", """\
Time grows with the number of particles to the power 4/3, with the square root of the stiffness,
and with the simulated time. Try in this order: --dry-run for an estimate, fewer --particles, a
softer --material, fewer --frames, --mass-scaling for stiff plastic materials. Pins with a large
--damping-time need many substeps: lower it. A bake estimated to take longer than --max-hours is
refused."""),
    "trouble": ("a result that looks wrong", """\
nothing moves or touches the floor     read the warning; check --drop, the unit, --frames
it falls in slow motion                the body is large: check --meters-per-unit
parts hang in the air                  they may be open sheets: --repair, see gf-usd inspect
it sinks into the floor                more --particles, or a lower --drop
fingers or legs stick together         too thin or too close: more --particles
it looks faceted or jittery            read the report's warnings; more --particles
it does not move in the viewer         load the payloads of the stage"""),
    "exit": ("exit statuses", """\
0 done; 1 failed while baking; 2 wrong usage; 3 the input was refused; 4 the result has an error,
or warnings under --strict; 5 a slice is done; 130 and 143 interrupted."""),
    "config": ("gf-usd.toml: default options for a folder", """\
gf-usd bake and gf-usd inspect read the nearest gf-usd.toml in the current folder or above:

    [bake]
    material = "rubber"
    particles = 4000
    drop = 2.5

Names are those of the options, with underscores. The command line takes precedence; the value
default removes an option: --drop default, --combine default. A note lists the options that
were read, and an unknown name is an error. Batch jobs and bakes with --events do not read this
file."""),
}  # fmt: skip


OF_COMMANDS = "gf-usd help COMMAND is the same as gf-usd COMMAND --help"


def topic(
    about: Annotated[
        str | None, typer.Argument(metavar="TOPIC|COMMAND", help="Topic or command to explain.")
    ] = None,
) -> None:
    """Explain a topic or a command; without an argument, list the topics."""
    if about is None:
        width = max(map(len, TOPICS))
        listed = [f"  {name:{width}}  {title}" for name, (title, _) in TOPICS.items()]
        typer.echo(
            "\n".join(["gf-usd help TOPIC explains one of these:", "", *listed, "", OF_COMMANDS])
        )
        return
    if about not in TOPICS:
        guess = did_you_mean(about, TOPICS)
        raise UsageError(
            f"unknown topic {about!r}", f"{guess}topics are {', '.join(TOPICS)}; {OF_COMMANDS}"
        )
    title, text = TOPICS[about]
    typer.echo(f"{about}: {title}\n\n{text}")
