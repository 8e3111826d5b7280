"""Bake, and stop baking."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import bpy

from . import objects, stage
from .job import Job
from .preferences import program
from .program import ProgramError
from .server import server
from .settings import frame_range, options
from .state import state

TICK = 0.2  # [s] between two looks at the process


class GFUSD_OT_bake(bpy.types.Operator):
    """Make the selected meshes soft: run gf-usd, and put its result on copies of them"""

    bl_idname = "gf_usd.bake"
    bl_label = "Bake"
    bl_options = {"UNDO"}  # noqa: RUF012 (Blender's own way)

    job: Job | None = None
    names: list[str] = []  # noqa: RUF012
    folder: Path | None = None
    timer: Any = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a mesh to bake, and one bake at a time."""
        return bool(objects.selected(context)) and state.job is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Wait for the result: for scripts."""
        try:
            self.job, self.names, self.folder = start(context)
            self.job.wait()
            return self.finish(context)
        except ProgramError as error:
            return self.fail(context, error)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start, and look again at every tick."""
        try:
            self.job, self.names, self.folder = start(context)
        except ProgramError as error:
            return self.fail(context, error)
        state.job = self.job
        manager = context.window_manager
        self.timer = manager.event_timer_add(TICK, window=context.window)
        manager.modal_handler_add(self)
        show_progress(context, self.job)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: Any) -> set[str]:
        """Esc stops it; all else is Blender's."""
        job = self.job
        assert job is not None
        if event.type == "ESC" and event.value == "PRESS" and not job.canceled:
            job.cancel()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not job.step():
            show_progress(context, job)
            return {"PASS_THROUGH"}
        try:
            return self.finish(context)
        except ProgramError as error:
            return self.fail(context, error)

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender where it closes while the process runs."""
        if self.job is not None:
            self.job.cancel(grace=1.0)
            self.job.wait()
        clear(self.names, self.folder)
        state.job = None

    def finish(self, context: bpy.types.Context) -> set[str]:
        """Load the result; raises ProgramError where there is none."""
        job = self.job
        assert job is not None
        if job.error is not None:
            raise job.error
        assert job.result is not None
        shown = objects.show(context, self.names, Path(job.result["root"]))
        for note in job.notes:
            self.report({"INFO"}, note)
        for warning in job.warnings:
            self.report({"WARNING"}, warning)
        found = job.result["check"]
        said = f"{', '.join(item.name for item in shown)}: {job.result['frames']} frames"
        doubts = [*job.warnings, *([f"gf-usd check: {len(found)} findings"] if found else [])]
        self.tidy(context, said, "\n".join(doubts))
        self.report({"WARNING"} if doubts else {"INFO"}, said)
        return {"FINISHED"}

    def fail(self, context: bpy.types.Context, error: ProgramError) -> set[str]:
        """Say why, in gf-usd's own words, and leave the scene as it was."""
        job = self.job
        # a result that cannot be shown is a result still, and a failure tells how it went
        worth = job is not None and (job.result is not None or job.failed)
        clear(self.names, None if worth else self.folder)
        self.tidy(context, error.message, error.hint)
        if job is not None and job.canceled:
            self.report({"INFO"}, "gf-usd: canceled")
        else:
            hint = f"\nHint: {error.hint}" if error.hint else ""
            self.report({"ERROR"}, f"{error.message}{hint}")
        return {"CANCELLED"}

    def tidy(self, context: bpy.types.Context, message: str, hint: str) -> None:
        """Take the progress away, and leave a message in the panel."""
        state.job, state.message, state.hint = None, message, hint
        if self.timer is not None:
            context.window_manager.event_timer_remove(self.timer)
            self.timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)


def start(context: bpy.types.Context) -> tuple[Job, list[str], Path]:
    """Export the selection and the obstacles, and start gf-usd on them.

    Returns the job, the names of the copies, and the new folder that everything goes to.

    Raises ProgramError where it cannot be started; then nothing of it is left.
    """
    scene, settings = context.scene, context.scene.gf_usd
    words = program(context)
    originals, bars = objects.selected(context), objects.obstacles(context)
    frames = frame_range(settings, scene)
    here = scene.frame_current
    names: list[str] = []
    standing: list[str] = []
    folder = None
    try:
        scene.frame_set(scene.frame_start)
        names = objects.make_copies(context, originals)
        standing = objects.make_copies(context, bars, "obstacle")
        pinned = _pinned(context, originals, names, frames)
        motions = dict(zip(standing, stage.record(context, bars, frames), strict=True))
        more = options(settings, scene, objects.lowest_vertex(names))
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", originals[0].name)
        folder = new_folder(scene, stem)
        asset = folder / f"{stem}.source.usdc"
        objects.export(context, [*names, *standing], asset)
        subsets = stage.complete(asset, frames, obstacles=motions, pinned=pinned)
        command = ["bake", str(asset), "--output", str(folder / f"{stem}.soft.usda")]
        for subset in subsets:
            command += ["--pin", subset]
        # the last word wins, so that More can change what the panel says
        return Job(words, [*command, *more], str(folder)), names, folder
    except ProgramError:
        clear(names, folder)
        raise
    finally:
        objects.discard(standing)
        scene.frame_set(here)


def _pinned(
    context: bpy.types.Context, originals: list[Any], names: list[str], frames: range
) -> dict[str, tuple[stage.Motion, list[int]]]:
    """Motion and pinned faces of the copies that have any.

    Raises ProgramError where the pin group is in none of the objects, or has no face.
    """
    group = context.scene.gf_usd.pin_group
    if not group:
        return {}
    faces = {
        name: stage.pinned_faces(original, bpy.data.objects[name], group)
        for original, name in zip(originals, names, strict=True)
    }
    held = [(o, name) for o, name in zip(originals, names, strict=True) if faces[name]]
    if not held:
        there = sorted({g.name for o in originals for g in o.vertex_groups})
        raise ProgramError(
            f"no face of the selected objects is in the vertex group {group!r}",
            f"give its vertices a weight above {stage.WEIGHT:g}; there are the groups: "
            f"{', '.join(there) or 'none'}",
        )
    motions = stage.record(context, [original for original, _ in held], frames)
    return {
        name: (motion, faces[name])
        for (_, name), motion in zip(held, motions, strict=True)
    }  # fmt: skip


def new_folder(scene: bpy.types.Scene, stem: str) -> Path:
    """A folder for one bake, so that an earlier one stays what it is, for Undo and other files.

    Next to the .blend file; while that is not saved, in Blender's temporary folder.

    Raises ProgramError where it cannot be made.
    """
    wanted = scene.gf_usd.folder
    if wanted.startswith("//") and not bpy.data.filepath:
        wanted = str(Path(bpy.app.tempdir) / "gf-usd")
    above = Path(bpy.path.abspath(wanted)).resolve()
    number = 1
    while (above / f"{stem}-{number:03d}").exists():
        number += 1
    folder = above / f"{stem}-{number:03d}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ProgramError(f"{folder} cannot be made: {error.strerror}", "change Folder") from error
    return folder


def clear(names: list[str], folder: Path | None) -> None:
    """Remove what a bake made that came to nothing."""
    objects.discard(names)
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def show_progress(context: bpy.types.Context, job: Job) -> None:
    """In the status bar and in the panel."""
    where = f"frame {job.done} of {job.total}" if job.total else "filling the meshes"
    if job.seconds_left is not None:
        where += f", about {job.seconds_left:.0f} s left"
    text = "gf-usd: stopping" if job.canceled else f"gf-usd: {where} (Esc stops it)"
    if context.workspace is not None:
        context.workspace.status_text_set(text)
    for area in context.screen.areas if context.screen else ():
        if area.type == "VIEW_3D":
            area.tag_redraw()


def register() -> None:
    """Called by the add-on."""
    bpy.utils.register_class(GFUSD_OT_bake)


def unregister() -> None:
    """Called by the add-on."""
    server.stop()
    bpy.utils.unregister_class(GFUSD_OT_bake)
