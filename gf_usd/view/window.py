"""A window that plays a bake, by open3d: an extra, for it is large and wants system libraries."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from gf_usd.errors import UsageError
from gf_usd.model import Floats
from gf_usd.recording import MotionFrame, Recording
from gf_usd.view.camera import fit_camera
from gf_usd.view.report_thin import spread
from gf_usd.view.window_clock import Clock
from gf_usd.view.window_needs import INSTEAD, PACKAGES, import_open3d, require_display
from gf_usd.view.window_shapes import Balls, Skin, floor_lines

SIZE = (1280, 800)  # pixels of the window
LOOKS = 48  # frames of a longer motion that the camera is fitted to
PAPER = (0.93, 0.94, 0.96)
LINES = (0.76, 0.78, 0.81)
IDLE = 0.004  # [s] between looks at the clock: shorter than a frame of any screen
SPACE, RIGHT, LEFT = 32, 262, 263  # GLFW's codes of keys
KEYS = "space plays and pauses, arrows step, G mesh or Gaussians, R resets, Q quits"


class Source(Protocol):
    """One look that can be read."""

    def recording(self) -> Recording: ...

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]: ...


class Window:
    """One look, played until the window is closed; a frame is read when it is shown.

    Raises
    ------
    UsageError : open3d, a system library, a display or OpenGL is missing.
    InputError : a frame is broken.
    """

    def __init__(self, source: Source) -> None:
        self._o3d = import_open3d()
        require_display()
        self._source, self._recording = source, source.recording()
        recording = self._recording
        self._skin = Skin(recording.meshes) if recording.meshes else None
        self._balls = Balls(recording.gaussians) if recording.gaussians else None
        self._shapes: dict[str, Any] = {}
        for kind, made in (("mesh", self._skin), ("gaussians", self._balls)):
            if made is not None:
                self._shapes[kind] = self._o3d.geometry.TriangleMesh()
                self._shapes[kind].triangles = self._ints(made.triangles)
                self._shapes[kind].vertex_colors = self._floats(made.colours)
        self.shown = next(iter(self._shapes))
        low, high = self._bounds()
        times = [recording.seconds(code) for code in recording.time_codes]
        self.clock = Clock(times, time.perf_counter)
        self._window = self._open()
        self._pose()
        if recording.ground is not None:
            self._add_floor(low, high, recording.ground)
        self._window.add_geometry(self._shapes[self.shown])
        corners = [[(low, high)[b][i] for i, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]
        self._corners = np.array(corners)
        self._look()
        self._listen()
        self.clock.rewind()

    def run(self) -> None:
        """Play until the window is closed."""
        self._window.run()
        self._window.destroy_window()

    def _open(self) -> Any:
        # what open3d would print is said by the errors here
        self._o3d.utility.set_verbosity_level(self._o3d.utility.VerbosityLevel.Error)
        window = self._o3d.visualization.VisualizerWithKeyCallback()
        title = f"{self._recording.name} {self._recording.look}".strip()
        opened = window.create_window(f"{title}: {KEYS}", *SIZE)
        option = window.get_render_option() if opened else None
        if option is None:
            raise UsageError(
                "The display offers no OpenGL window.", f"{PACKAGES}; without OpenGL, {INSTEAD}"
            )
        option.background_color = np.array(PAPER)
        option.mesh_show_back_face = True
        # open3d's Python name of smooth shading
        option.mesh_shade_option = self._o3d.visualization.MeshShadeOption.Color
        return window

    def _pose(self) -> None:
        """Put the clock's frame into the shape that is shown."""
        code = self._recording.time_codes[self.clock.frame]
        frame = next(iter(self._source.frames([code])))
        shape = self._shapes[self.shown]
        if self.shown == "mesh" and self._skin is not None:
            points, normals = self._skin.pose(frame.meshes)
        elif self._balls is not None and frame.positions is not None and frame.axes is not None:
            points, normals = self._balls.pose(frame.positions, frame.axes)
        else:
            return
        shape.vertices, shape.vertex_normals = self._floats(points), self._floats(normals)
        if not shape.has_triangle_normals():
            # open3d lights only meshes that have these as well, though it shades by the others
            shape.compute_triangle_normals()

    def _add_floor(self, low: Floats, high: Floats, ground: float) -> None:
        lines = floor_lines(low, high, np.array(self._recording.up), ground)
        pairs = np.arange(2 * len(lines)).reshape(-1, 2)
        drawn = self._o3d.geometry.LineSet(
            self._floats(lines.reshape(-1, 3)), self._o3d.utility.Vector2iVector(pairs)
        )
        drawn.paint_uniform_color(LINES)
        self._window.add_geometry(drawn)

    def _bounds(self) -> tuple[Floats, Floats]:
        """Box [m] of all that is shown, over the motion."""
        codes = self._recording.time_codes
        boxes = []
        for frame in self._source.frames([codes[i] for i in spread(len(codes), LOOKS)]):
            cloud = [] if frame.positions is None else [frame.positions]
            points = np.concatenate([*frame.meshes, *cloud])
            boxes.append((points.min(axis=0), points.max(axis=0)))
        return np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))

    def _look(self) -> None:
        """Stand where the whole motion is in the picture."""
        control = self._window.get_view_control()
        pinhole = control.convert_to_pinhole_camera_parameters()
        lens = pinhole.intrinsic
        fov = 2.0 * np.degrees(np.arctan(0.5 * lens.height / lens.intrinsic_matrix[1, 1]))
        camera = fit_camera(
            self._corners, self._recording.up, lens.width / lens.height, fov=float(fov)
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

    def _listen(self) -> None:
        def on(key: int, act: Any) -> None:
            def pressed(window: Any) -> bool:
                act()
                self._redraw()
                return True

            self._window.register_key_callback(key, pressed)

        on(SPACE, self.clock.toggle)
        on(RIGHT, lambda: self.clock.step(1))
        on(LEFT, lambda: self.clock.step(-1))
        on(ord("G"), self._switch)
        on(ord("R"), self._reset)
        self._window.register_animation_callback(self._tick)

    def _tick(self, window: Any) -> bool:
        if not self.clock.tick():
            time.sleep(IDLE)
            return False
        self._redraw()
        return True

    def _redraw(self) -> None:
        self._pose()
        self._window.update_geometry(self._shapes[self.shown])

    def _switch(self) -> None:
        kinds = list(self._shapes)
        self._window.remove_geometry(self._shapes[self.shown], reset_bounding_box=False)
        self.shown = kinds[(kinds.index(self.shown) + 1) % len(kinds)]
        self._pose()
        self._window.add_geometry(self._shapes[self.shown], reset_bounding_box=False)

    def _reset(self) -> None:
        self._look()
        self.clock.rewind()

    def _floats(self, values: Floats) -> Any:
        return self._o3d.utility.Vector3dVector(np.ascontiguousarray(values, dtype=np.float64))

    def _ints(self, values: Floats) -> Any:
        return self._o3d.utility.Vector3iVector(np.ascontiguousarray(values, dtype=np.int32))
