"""What the panel asks for; saved with the scene."""

# pyright: reportInvalidTypeForm=false

import shlex
from collections.abc import Iterator

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from .preferences import materials
from .program import ProgramError


def _suggest(
    settings: "GFUSD_Settings", context: bpy.types.Context, typed: str
) -> Iterator[tuple[str, str]]:
    return (row for row in materials(context) if typed.lower() in row[0])


def _suggest_groups(
    settings: "GFUSD_Settings", context: bpy.types.Context, typed: str
) -> list[str]:
    names = {g.name for o in context.selected_objects for g in getattr(o, "vertex_groups", ())}
    return sorted(name for name in names if typed.lower() in name.lower())


class GFUSD_Settings(bpy.types.PropertyGroup):
    """The options of a bake."""

    material: StringProperty(
        name="Material",
        default="rubber",
        description="A preset of gf-usd, or a USD file with a material",
        search=_suggest,
        search_options={"SUGGESTION"},
    )
    particles: IntProperty(
        name="Particles", default=0, min=0, soft_max=200_000,
        description="About how many fill the meshes; 0: chosen by gf-usd from their thickness",
    )  # fmt: skip
    scene_range: BoolProperty(
        name="Scene Range", default=True, description="Bake the frame range of the scene"
    )
    frames: IntProperty(
        name="Frames", default=48, min=2, description="How many, from the scene's first frame on"
    )
    as_placed: BoolProperty(
        name="From Where It Is",
        default=True,
        description="Let it fall from its place above the floor; off: from a given height",
    )
    drop: StringProperty(
        name="Drop",
        default="3r",
        description="Height above the floor [Blender units], or in radii of the body: 3r",
    )
    has_floor: BoolProperty(name="Floor", default=True, description="A floor to land on")
    floor: FloatProperty(
        name="Height", default=0.0, unit="LENGTH", description="Of the floor, along Z"
    )
    obstacles: PointerProperty(
        name="Obstacles",
        type=bpy.types.Collection,
        description="Meshes that the body collides with; they follow their animation",
    )
    pin_group: StringProperty(
        name="Pin Group",
        description="Vertex group that follows the animation of its object instead of falling: "
        "the faces whose vertices all weigh more than a half",
        search=_suggest_groups,
        search_options={"SUGGESTION"},
    )
    extra: StringProperty(
        name="More",
        description="More options of gf-usd bake, as on its command line, e.g. --friction 0.2",
    )
    folder: StringProperty(
        name="Folder",
        default="//gf-usd/",
        subtype="DIR_PATH",
        description="Where the caches go, each bake into a folder of its own; they must stay there",
    )


def options(settings: GFUSD_Settings, scene: bpy.types.Scene, lowest: float) -> list[str]:
    """The settings as words of `gf-usd bake`.

    lowest : z of the lowest vertex [Blender units].

    Raises ProgramError where the body reaches below the floor, or the extra options do not parse.
    """
    words = ["--material", settings.material]
    if settings.particles:
        words += ["--particles", str(settings.particles)]
    frames = frame_range(settings, scene)
    words += ["--start", str(frames.start), "--frames", str(len(frames))]
    # --gravity of a vector of zeros has no direction, and says so
    gravity = scene.gravity if scene.use_gravity else (0.0, 0.0, 0.0)
    words += ["--gravity", ",".join(f"{g:.6g}" for g in gravity) if any(gravity) else "0"]
    if scene.unit_settings.scale_length != 1.0:
        # Blender's exporter takes every unit for a meter
        words += ["--meters-per-unit", repr(round(scene.unit_settings.scale_length, 9))]
    if settings.has_floor:
        words += ["--floor", repr(settings.floor)]
        words += ["--drop", _height(settings, lowest) if settings.as_placed else settings.drop]
    else:
        words += ["--floor", "none"]
    try:
        return words + shlex.split(settings.extra)
    except ValueError as error:
        raise ProgramError(f"More: {settings.extra!r}: {error}", "close the quotes") from error


def frame_range(settings: GFUSD_Settings, scene: bpy.types.Scene) -> range:
    """The frames of the scene that are baked."""
    first = scene.frame_start
    return range(first, scene.frame_end + 1 if settings.scene_range else first + settings.frames)


def _height(settings: GFUSD_Settings, lowest: float) -> str:
    height = lowest - settings.floor
    # what stands on the floor in single precision may reach a hair below it
    if height < -1e-4 * max(1.0, abs(lowest)):
        raise ProgramError(
            f"the lowest vertex is at {lowest:.4g}, below the floor at {settings.floor:.4g}",
            "raise the object, lower the floor, or turn From Where It Is off",
        )
    return repr(max(height, 0.0))


def register() -> None:
    """Called by the add-on."""
    bpy.utils.register_class(GFUSD_Settings)
    bpy.types.Scene.gf_usd = PointerProperty(type=GFUSD_Settings)


def unregister() -> None:
    """Called by the add-on."""
    del bpy.types.Scene.gf_usd
    bpy.utils.unregister_class(GFUSD_Settings)
