"""The window: draws the frame of a playback `Clock`, and handles its keys."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.scene import MotionFrame, Recording
from gf_usd.view.render.camera import fit_camera
from gf_usd.view.report.thinning import evenly_spaced
from gf_usd.view.window.clock import Clock
from gf_usd.view.window.requirements import (
    ALTERNATIVE,
    PACKAGES,
    import_open3d,
    require_display,
)
from gf_usd.view.window.shapes import EllipsoidMesh, ShadedMesh, floor_lines, mesh_at_frame

SIZE = (1280, 800)  # [pixels] of the window
SAMPLED_FRAMES = 48  # number of frames for the bounding box of a longer motion
BACKGROUND = (0.93, 0.94, 0.96)
LINE_COLOR = (0.76, 0.78, 0.81)
POLL_INTERVAL = 0.004  # [s] shorter than the refresh interval of a screen
SPACE, RIGHT, LEFT = 32, 262, 263  # key codes of GLFW
KEYS = "space plays and pauses, arrows step, G mesh or Gaussians, R resets, Q quits"


class Source(Protocol):
    """One variant of a bake, read frame by frame."""

    def recording(self) -> Recording: ...

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]: ...


class Window:
    """A window that plays one variant; frames are read when they are displayed.

    Raises
    ------
    UsageError : open3d, a system library, a display or OpenGL is missing.
    InputError : the data of a frame is invalid.
    """

    def __init__(self, source: Source) -> None:
        self._o3d = import_open3d()
        require_display()
        self._source, self._recording = source, source.recording()
        recording = self._recording
        self._mesh = ShadedMesh(recording.meshes) if recording.meshes or recording.flows else None
        self._ellipsoids = EllipsoidMesh(recording.gaussians) if recording.gaussians else None
        self._shapes: dict[str, Any] = {}
        for kind, source_mesh in (("mesh", self._mesh), ("gaussians", self._ellipsoids)):
            if source_mesh is not None:
                self._shapes[kind] = self._o3d.geometry.TriangleMesh()
                self._shapes[kind].triangles = self._ints(source_mesh.triangles)
                self._shapes[kind].vertex_colors = self._floats(source_mesh.colors)
        self.shown = next(iter(self._shapes))
        low, high = self._bounds()
        times = [recording.seconds(code) for code in recording.time_codes]
        self.clock = Clock(times, time.perf_counter)
        self._window = self._open_window()
        self._update_shape()
        if recording.ground is not None:
            self._add_floor(low, high, recording.ground)
        self._window.add_geometry(self._shapes[self.shown])
        corners = [[(low, high)[b][i] for i, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]
        self._corners = np.array(corners)
        self._frame_motion()
        self._register_keys()
        self.clock.rewind()

    def run(self) -> None:
        """Play until the window is closed."""
        self._window.run()
        self._window.destroy_window()

    def _open_window(self) -> Any:
        # the errors below replace the messages of open3d
        self._o3d.utility.set_verbosity_level(self._o3d.utility.VerbosityLevel.Error)
        window = self._o3d.visualization.VisualizerWithKeyCallback()
        title = f"{self._recording.name} {self._recording.variant}".strip()
        opened = window.create_window(f"{title}: {KEYS}", *SIZE)
        option = window.get_render_option() if opened else None
        if option is None:
            raise UsageError(
                "the display offers no OpenGL window", f"{PACKAGES}; without OpenGL, {ALTERNATIVE}"
            )
        option.background_color = np.array(BACKGROUND)
        option.mesh_show_back_face = True
        # open3d's name of smooth shading
        option.mesh_shade_option = self._o3d.visualization.MeshShadeOption.Color
        return window

    def _update_shape(self) -> None:
        """Set the displayed shape to the current frame of the clock."""
        code = self._recording.time_codes[self.clock.frame]
        frame = next(iter(self._source.frames([code])))
        shape = self._shapes[self.shown]
        if self.shown == "mesh" and self._mesh is not None:
            mesh = mesh_at_frame(self._recording, self._mesh, frame)
            points, normals = mesh.pose((*frame.meshes, *(mesh.points for mesh in frame.flows)))
            if mesh is not self._mesh:
                shape.triangles = self._ints(mesh.triangles)
                shape.vertex_colors = self._floats(mesh.colors)
        elif (
            self._ellipsoids is not None and frame.positions is not None and frame.axes is not None
        ):
            points, normals = self._ellipsoids.pose(frame.positions, frame.axes)
        else:
            return
        shape.vertices, shape.vertex_normals = self._floats(points), self._floats(normals)
        if not shape.has_triangle_normals() or self._recording.flows:
            # open3d requires triangle normals for lighting, although it shades by vertex normals
            shape.compute_triangle_normals()

    def _add_floor(self, low: Floats, high: Floats, ground: float) -> None:
        lines = floor_lines(low, high, np.array(self._recording.up), ground)
        pairs = np.arange(2 * len(lines)).reshape(-1, 2)
        line_set = self._o3d.geometry.LineSet(
            self._floats(lines.reshape(-1, 3)), self._o3d.utility.Vector2iVector(pairs)
        )
        line_set.paint_uniform_color(LINE_COLOR)
        self._window.add_geometry(line_set)

    def _bounds(self) -> tuple[Floats, Floats]:
        """Bounding box [m] of all shapes over the motion."""
        codes = self._recording.time_codes
        boxes = []
        for frame in self._source.frames(
            [codes[i] for i in evenly_spaced(len(codes), SAMPLED_FRAMES)]
        ):
            cloud = [] if frame.positions is None else [frame.positions]
            flows = [mesh.points for mesh in frame.flows]
            points = np.concatenate([np.zeros((0, 3)), *frame.meshes, *flows, *cloud])
            if not len(points):
                continue
            boxes.append((points.min(axis=0), points.max(axis=0)))
        return np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))

    def _frame_motion(self) -> None:
        """Set the camera so that the view contains the whole motion."""
        control = self._window.get_view_control()
        pinhole = control.convert_to_pinhole_camera_parameters()
        intrinsic = pinhole.intrinsic
        fov = 2.0 * np.degrees(np.arctan(0.5 * intrinsic.height / intrinsic.intrinsic_matrix[1, 1]))
        camera = fit_camera(
            self._corners, self._recording.up, intrinsic.width / intrinsic.height, fov=float(fov)
        )
        eye, target = np.array(camera.eye), np.array(camera.target)
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, camera.up)
        right /= np.linalg.norm(right)
        rows = np.stack([right, np.cross(forward, right), forward])
        extrinsic = np.eye(4)
        extrinsic[:3, :3], extrinsic[:3, 3] = rows, -rows @ eye
        pinhole.extrinsic = extrinsic
        control.convert_from_pinhole_camera_parameters(pinhole, allow_arbitrary=True)

    def _register_keys(self) -> None:
        def bind(key: int, action: Any) -> None:
            def on_press(window: Any) -> bool:
                action()
                self._redraw()
                return True

            self._window.register_key_callback(key, on_press)

        bind(SPACE, self.clock.toggle)
        bind(RIGHT, lambda: self.clock.step(1))
        bind(LEFT, lambda: self.clock.step(-1))
        bind(ord("G"), self._switch_shape)
        bind(ord("R"), self._reset)
        self._window.register_animation_callback(self._tick)

    def _tick(self, window: Any) -> bool:
        if not self.clock.tick():
            time.sleep(POLL_INTERVAL)
            return False
        self._redraw()
        return True

    def _redraw(self) -> None:
        self._update_shape()
        self._window.update_geometry(self._shapes[self.shown])

    def _switch_shape(self) -> None:
        kinds = list(self._shapes)
        self._window.remove_geometry(self._shapes[self.shown], reset_bounding_box=False)
        self.shown = kinds[(kinds.index(self.shown) + 1) % len(kinds)]
        self._update_shape()
        self._window.add_geometry(self._shapes[self.shown], reset_bounding_box=False)

    def _reset(self) -> None:
        self._frame_motion()
        self.clock.rewind()

    def _floats(self, values: Floats) -> Any:
        return self._o3d.utility.Vector3dVector(np.ascontiguousarray(values, dtype=np.float64))

    def _ints(self, values: Floats) -> Any:
        return self._o3d.utility.Vector3iVector(np.ascontiguousarray(values, dtype=np.int32))
