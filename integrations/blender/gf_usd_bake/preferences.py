"""Where gf-usd is."""

# pyright: reportInvalidTypeForm=false

import bpy

from .program import ProgramError, find_program, list_materials


class GFUSD_Preferences(bpy.types.AddonPreferences):
    """Of this computer, not of a file."""

    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="gf-usd",
        subtype="FILE_PATH",
        description="The program gf-usd, or a Python that has it. Empty: gf-usd on PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """The path alone."""
        self.layout.prop(self, "program")


def program(context: bpy.types.Context) -> list[str]:
    """The words that start gf-usd; raises ProgramError where there is none."""
    addon = context.preferences.addons.get(__package__)
    named = addon.preferences.program if addon else ""
    return find_program(bpy.path.abspath(named))


_materials: dict[tuple[str, ...], list[tuple[str, str]]] = {}


def materials(context: bpy.types.Context) -> list[tuple[str, str]]:
    """The presets of gf-usd, asked for once; none where it cannot be run."""
    try:
        words = program(context)
        key = tuple(words)
        if key not in _materials:
            _materials[key] = list_materials(words)
        return _materials[key]
    except ProgramError:
        # a list of suggestions is no place for an error: Bake says it
        return []


def register() -> None:
    """Called by the add-on."""
    bpy.utils.register_class(GFUSD_Preferences)


def unregister() -> None:
    """Called by the add-on."""
    bpy.utils.unregister_class(GFUSD_Preferences)
