"""Bake the selected meshes with gf-usd, from the sidebar of Blender's 3D view.

gf-usd runs in a process of its own, since Blender includes another OpenUSD.  What it writes comes
back as a mesh cache on a copy of each object; the original is hidden.
"""

from __future__ import annotations

from . import operators, panel, preferences, settings

MODULES = (preferences, settings, operators, panel)


def register() -> None:
    """Make the panel, its operators and its settings known to Blender."""
    for module in MODULES:
        module.register()


def unregister() -> None:
    """Take them away again."""
    for module in reversed(MODULES):
        module.unregister()
