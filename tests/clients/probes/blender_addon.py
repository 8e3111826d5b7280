"""In Blender: install the add-on as a user would, and drive it without a window.

    python blender_addon.py ADDON.zip GF_USD CASE OUT

CASE is one of the functions below.  OUT is a folder for the caches; the results of CASE go to
OUT.json, and the world vertices (frames, vertices, 3) of every result to OUT.npz.
"""

import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np

MODULE = "bl_ext.user_default.gf_usd_bake"
FIRST, LAST = 11, 15


def falls(out):
    """One sphere; the scene says the frames."""
    ball = sphere("My Ball", (1.0, 2.0, 0.7), (0.3, 0.2, 0.1), (1.0, 1.2, 1.0))
    result = {"poll": bpy.ops.gf_usd.bake.poll(), "ended": list(bpy.ops.gf_usd.bake())}
    return {**result, **scene_state(), "hidden": ball.hide_get(), "render": not ball.hide_render}


def in_centimeters(out):
    """Two objects of a scene in centimeters: a modifier, a parent, and a mirror."""
    scene().unit_settings.scale_length = 0.01
    carrier = bpy.data.objects.new("Carrier", None)
    scene().collection.objects.link(carrier)
    carrier.rotation_euler = (0.0, 0.5, 0.4)
    carrier.scale = (2.0, 1.0, 1.0)
    left = sphere("1. L\u00e4ufer", (3.0, 1.0, 30.0), (0.3, 0.0, 0.1), (8.0, -7.0, 6.0))
    right = sphere("Right", (-6.0, 0.0, 40.0), (0.0, 0.2, 0.1), (5.0, 5.0, 8.0))
    right.parent = carrier
    left.modifiers.new("Bend", "SIMPLE_DEFORM").deform_method = "TAPER"
    bpy.context.view_layer.update()
    left.select_set(True)
    ended = list(bpy.ops.gf_usd.bake())
    return {"ended": ended, **scene_state()}


def block(name, place, size):
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=place)
    made = bpy.context.object
    made.name, made.scale = name, size
    bpy.context.view_layer.update()
    return made


def onto_a_lift(out):
    """A ball above a slab that rises, in a collection of obstacles."""
    slab = block("Lift", (0.0, 0.0, 0.4), (3.0, 3.0, 0.2))
    for frame, height in ((FIRST, 0.4), (LAST, 0.6)):
        slab.location.z = height
        slab.keyframe_insert("location", frame=frame)
    for curve in slab.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    bars = bpy.data.collections.new("Obstacles")
    scene().collection.children.link(bars)
    bars.objects.link(slab)
    scene().gf_usd.obstacles = bars
    scene().gf_usd.has_floor = False
    sphere("Ball", (0.0, 0.0, 1.05))
    slab.select_set(True)  # an obstacle is not baked, even if selected
    ended = list(bpy.ops.gf_usd.bake())
    return {"ended": ended, **scene_state(), "lift": slab.hide_get()}


def hung(out):
    """A bar whose upper end is in a vertex group, and swings with its object."""
    bar = block("Bar", (0.0, 0.0, 2.0), (0.3, 0.3, 1.2))
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.subdivide(number_cuts=4)
    bpy.ops.object.mode_set(mode="OBJECT")
    group = bar.vertex_groups.new(name="hung up")
    top = [v.index for v in bar.data.vertices if v.co.z > 0.25]
    group.add(top, 1.0, "REPLACE")
    for frame, x in ((FIRST, 0.0), (LAST, 0.2)):
        bar.location.x = x
        bar.keyframe_insert("location", frame=frame)
    scene().frame_set(FIRST)
    scene().gf_usd.has_floor = False
    messages = []
    scene().gf_usd.pin_group = "nowhere"
    try:
        bpy.ops.gf_usd.bake()
    except RuntimeError as error:
        messages.append(str(error))
    scene().gf_usd.pin_group = "hung up"
    ended = list(bpy.ops.gf_usd.bake())
    return {"ended": ended, "messages": messages, "top": top, **scene_state()}


def gravity_of_the_scene(out):
    """A ball that falls sideways."""
    scene().gravity = (3.0, 0.0, 0.0)
    scene().gf_usd.has_floor = False
    scene().gf_usd.particles = 0
    sphere("Ball", (0.0, 0.0, 1.0))
    return {"ended": list(bpy.ops.gf_usd.bake()), **scene_state()}


def twice(out):
    """A second bake takes the place of the first."""
    sphere("Ball", (0.0, 0.0, 1.0))
    bpy.ops.gf_usd.bake()
    ball = bpy.data.objects["Ball"]
    bpy.ops.object.select_all(action="DESELECT")
    ball.hide_set(False)
    ball.select_set(True)
    ended = list(bpy.ops.gf_usd.bake())
    folders = sorted(path.name for path in Path(out).iterdir())
    return {"ended": ended, "folders": folders, **scene_state()}


def refusals(out):
    """What is wrong, in whose words, and what is left in the scene."""
    sphere("Ball", (0.0, 0.0, 1.0))
    settings = scene().gf_usd
    messages = {}
    for name, change in (
        ("material", {"material": "ruber"}),
        ("option", {"extra": "--nonsense 3"}),
        ("quotes", {"extra": "'--friction"}),
        ("floor", {"floor": 5.0}),
        ("program", {}),
    ):
        before = {key: getattr(settings, key) for key in change}
        for key, value in change.items():
            setattr(settings, key, value)
        preferences = bpy.context.preferences.addons[MODULE].preferences
        program = preferences.program
        if name == "program":
            preferences.program = str(Path(out) / "nowhere")
        try:
            bpy.ops.gf_usd.bake()
        except RuntimeError as error:
            messages[name] = [str(error), state().message, state().hint]
        preferences.program = program
        for key, value in before.items():
            setattr(settings, key, value)
    return {
        "messages": messages,
        "left": [path.name for path in Path(out).iterdir()],
        **scene_state(),
    }


class Operator:
    """The operator's own methods, with a stand-in for what needs a window."""

    def __init__(self):
        from bl_ext.user_default.gf_usd_bake.operators import GFUSD_OT_bake as real

        self.job, self.names, self.folder, self.timer, self.reports = None, [], None, None, []
        for name in ("invoke", "modal", "finish", "fail", "tidy"):
            setattr(self, name, getattr(real, name).__get__(self))

    def report(self, kind, text):
        self.reports.append([*kind, text])


class Windowed:
    """The context, with a window manager that only counts."""

    def __init__(self):
        self.handlers, self.timers = [], []
        self.status = []
        self.window = None
        self.window_manager = SimpleNamespace(
            event_timer_add=lambda tick, window: self.timers.append(tick) or len(self.timers),
            event_timer_remove=lambda timer: self.timers.pop(),
            modal_handler_add=self.handlers.append,
        )
        self.workspace = SimpleNamespace(status_text_set=self.status.append)

    def __getattr__(self, name):
        return getattr(bpy.context, name)


def event(kind):
    return SimpleNamespace(type=kind, value="PRESS" if kind == "ESC" else "NOTHING")


def modal(out):
    """Started with a click, looked at by a timer."""
    sphere("Ball", (0.0, 0.0, 1.0))
    operator, context = Operator(), Windowed()
    started = list(operator.invoke(context, event("LEFTMOUSE")))
    free = bpy.ops.gf_usd.bake.poll()  # one at a time
    elsewhere = list(operator.modal(context, event("MOUSEMOVE")))
    progress = []
    while (ended := operator.modal(context, event("TIMER"))) == {"PASS_THROUGH"}:
        progress.append(operator.job.share)
        time.sleep(0.05)
    return {
        "started": started, "free": free, "elsewhere": elsewhere, "ended": list(ended),
        "progress": progress, "status": context.status, "timers": context.timers,
        "reports": operator.reports, **scene_state(),
    }  # fmt: skip


def stopped(out):
    """Esc in the middle."""
    scene().frame_end = FIRST + 400
    sphere("Ball", (0.0, 0.0, 1.0))
    operator, context = Operator(), Windowed()
    operator.invoke(context, event("LEFTMOUSE"))
    process = operator.job._process
    while not operator.job.done:
        assert operator.modal(context, event("TIMER")) == {"PASS_THROUGH"}, operator.reports
        time.sleep(0.05)
    ended = operator.modal(context, event("ESC"))
    while ended == {"PASS_THROUGH"}:
        time.sleep(0.05)
        ended = operator.modal(context, event("TIMER"))
    return {
        "ended": list(ended), "status": process.returncode, "reports": operator.reports,
        "timers": context.timers, **scene_state(),
        "left": sorted(path.name for path in Path(out).iterdir()),
    }  # fmt: skip


class Layout:
    """What a panel draws, as text."""

    def __init__(self):
        self.drawn = []

    def prop(self, data, name):
        self.drawn.append(data.bl_rna.properties[name].name)

    def label(self, text, icon):
        self.drawn.append(text)

    def operator(self, name, text, icon):
        self.drawn.append(text)

    def progress(self, factor, text):
        self.drawn.append(f"{factor:.1f} {text}")


def draw():
    from bl_ext.user_default.gf_usd_bake.panel import GFUSD_PT_bake

    layout = Layout()
    GFUSD_PT_bake.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.drawn


def drawn(out):
    """The panel with nothing selected, with a mesh, after an error, and while a bake runs."""
    before = draw()
    sphere("Ball", (0.0, 0.0, 1.0))
    ready = draw()
    scene().gf_usd.material = "ruber"
    operator, context = Operator(), Windowed()
    operator.invoke(context, event("LEFTMOUSE"))
    running = draw()
    while operator.modal(context, event("TIMER")) == {"PASS_THROUGH"}:
        time.sleep(0.05)
    return {"before": before, "ready": ready, "running_panel": running, "after": draw()}


def listed(out):
    """Materials to choose from, and that all of it can be taken away and put back."""
    import bl_ext.user_default.gf_usd_bake as addon
    from bl_ext.user_default.gf_usd_bake.preferences import materials

    # the program on PATH
    bpy.context.preferences.addons[MODULE].preferences.program = ""
    names = [name for name, _ in materials(bpy.context)]
    addon.unregister()
    gone = not hasattr(bpy.types.Scene, "gf_usd") and not hasattr(bpy.types, "GFUSD_PT_bake")
    addon.register()
    back = hasattr(bpy.types.Scene, "gf_usd") and hasattr(bpy.types, "GFUSD_PT_bake")
    return {"materials": names, "gone": gone, "back": back}


def state():
    from bl_ext.user_default.gf_usd_bake.state import state

    return state


def scene():
    return bpy.context.scene


def sphere(name, place, turn=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    bpy.ops.mesh.primitive_uv_sphere_add(
        radius=0.5, location=place, rotation=turn, segments=16, ring_count=10
    )
    made = bpy.context.object
    made.name, made.scale = name, scale
    material = bpy.data.materials.new(f"{name} paint")
    made.data.materials.append(material)
    return made


def results():
    found = bpy.data.collections.get("gf-usd")
    return list(found.objects) if found else []


def scene_state():
    return {
        "message": state().message,
        "hint": state().hint,
        "running": state().job is not None,
        "objects": sorted(bpy.data.objects.keys()),
        "selected": sorted(o.name for o in bpy.context.selected_objects),
        "paths": {o.name: o.modifiers[0].object_path for o in results()},
        "files": sorted({o.modifiers[0].cache_file.filepath for o in results()}),
        "materials": {o.name: [slot.material.name for slot in o.material_slots] for o in results()},
    }


def world_vertices():
    frames = {item.name: [] for item in results()}
    for frame in range(FIRST, LAST + 1):
        scene().frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        for item in results():
            shape = item.evaluated_get(graph)
            flat = np.empty(3 * len(shape.data.vertices), np.float32)
            shape.data.vertices.foreach_get("co", flat)
            matrix = np.array(shape.matrix_world, np.float64)
            frames[item.name].append(flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
    return frames


package, program, case, target = sys.argv[1:]
# a release of Blender has its own OpenUSD on the path, the wheel does not
carried = Path(bpy.utils.system_resource("PYTHON")).glob("lib/python*/site-packages")
sys.path.append(str(next(carried)))
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(
    filepath=package, repo="user_default", enable_on_install=True
)
bpy.context.preferences.addons[MODULE].preferences.program = program
scene().frame_start, scene().frame_end = FIRST, LAST
settings = scene().gf_usd
settings.particles, settings.material, settings.folder = 300, "jelly", target
result = globals()[case](target)
Path(target).with_suffix(".json").write_text(json.dumps(result))
np.savez(Path(target).with_suffix(".npz"), **world_vertices())
