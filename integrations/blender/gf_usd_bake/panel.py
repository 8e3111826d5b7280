"""The panel in the sidebar of the 3D view."""

from __future__ import annotations

import textwrap

import bpy

from . import objects
from .operators import GFUSD_OT_bake
from .state import state

WIDTH = 40  # letters of a line in a sidebar as wide as Blender opens it


class GFUSD_PT_bake(bpy.types.Panel):
    """What to bake with, and how it went."""

    bl_label = "gf-usd"
    bl_idname = "GFUSD_PT_bake"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "gf-usd"

    def draw(self, context: bpy.types.Context) -> None:
        """Called by Blender."""
        settings = context.scene.gf_usd
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(settings, "material")
        layout.prop(settings, "particles")
        layout.prop(settings, "scene_range")
        if not settings.scene_range:
            layout.prop(settings, "frames")
        layout.prop(settings, "has_floor")
        if settings.has_floor:
            layout.prop(settings, "floor")
            layout.prop(settings, "as_placed")
            if not settings.as_placed:
                layout.prop(settings, "drop")
        layout.prop(settings, "obstacles")
        layout.prop(settings, "pin_group")
        layout.prop(settings, "extra")
        layout.prop(settings, "folder")
        if settings.folder.startswith("//") and not bpy.data.filepath:
            layout.label(text="File not saved: the cache is temporary", icon="ERROR")
        if state.job is not None:
            layout.progress(factor=state.job.share, text="Esc stops it")
        else:
            count = len(objects.selected(context))
            label = "Select a mesh" if count == 0 else f"Bake {count} object{'s'[: count > 1]}"
            layout.operator(GFUSD_OT_bake.bl_idname, text=label, icon="PHYSICS")
        for text, icon in ((state.message, "INFO"), (state.hint, "QUESTION")):
            for number, line in enumerate(textwrap.wrap(text, WIDTH)):
                layout.label(text=line, icon="BLANK1" if number else icon)


def register() -> None:
    """Called by the add-on."""
    bpy.utils.register_class(GFUSD_PT_bake)


def unregister() -> None:
    """Called by the add-on."""
    bpy.utils.unregister_class(GFUSD_PT_bake)
