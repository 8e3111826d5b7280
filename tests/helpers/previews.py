"""`gf-usd preview` in this process, and a stage that it can draw."""

from __future__ import annotations

import typer
from click.testing import Result
from typer.testing import CliRunner

from gf_usd.cli.preview import preview as command

FALLING_BOX = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
    startTimeCode = 1
    endTimeCode = 3
)
def Cube "box" {
    double size = 2
    color3f[] primvars:displayColor = [(0.8, 0.05, 0.05)]
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 4), 3: (0, 0, 1) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def preview(*arguments: object) -> Result:
    """How the command ended, and what it printed."""
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])
