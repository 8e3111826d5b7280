"""A shot: the duck above a ramp, a wall that moves, the ground, a camera.  In centimeters, Y up."""

from __future__ import annotations

from pathlib import Path

SHOT = """\
#usda 1.0
(
    defaultPrim = "Shot"
    metersPerUnit = 0.01
    upAxis = "Y"
    startTimeCode = 1
    endTimeCode = 48
    timeCodesPerSecond = 24
)

def Xform "Shot"
{
    def "Duck" (
        references = @./duck.usda@
    )
    {
        double3 xformOp:translate = (0, 14, -14)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }

    def Cube "Ramp" (
        prepend apiSchemas = ["PhysicsCollisionAPI"]
    )
    {
        double size = 1
        double3 xformOp:translate = (0, 4, -10)
        float xformOp:rotateX = 25
        float3 xformOp:scale = (16, 1, 24)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX", "xformOp:scale"]
    }

    def Plane "Ground" (
        prepend apiSchemas = ["PhysicsCollisionAPI"]
    )
    {
        uniform token axis = "Y"
    }

    def Cube "Wall" (
        prepend apiSchemas = ["PhysicsCollisionAPI"]
    )
    {
        double size = 1
        double3 xformOp:translate.timeSamples = {
            24: (0, 4, 16),
            36: (0, 4, 6),
        }
        float3 xformOp:scale = (16, 8, 1)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }

    def Camera "Camera"
    {
        float focalLength = 50
        float horizontalAperture = 34
        float verticalAperture = 19.125
        float2 clippingRange = (1, 1000)
        double3 xformOp:translate = (70, 24, 14)
        float3 xformOp:rotateXYZ = (-14, 78, 0)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }
}
"""


def write_shot(path: Path) -> None:
    """Write the shot; the duck is referenced as a file next to it."""
    path.write_text(SHOT, "utf-8")
