"""A window that plays a bake, by open3d: an extra, for it is large and wants system libraries.

Which frame is on the screen: playing in real time, over and over, or stepped by hand.

What a window needs of the machine, looked for before it is opened.

What a window draws, as triangles and lines: mesh, Gaussians and floor.
"""

from __future__ import annotations

import ctypes
import importlib
import math
import os
import sys
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import GaussianSet, MotionFrame, Recording, RenderMesh
from gf_usd.view.render.camera import fit_camera
from gf_usd.view.report.surface import make_skin, sample, spread

SIZE = (1280, 800)  # pixels of the window
SAMPLED_FRAMES = 48  # frames of a longer motion that the camera is fitted to
PAPER = (0.93, 0.94, 0.96)
LINES = (0.76, 0.78, 0.81)
IDLE = 0.004  # [s] between readings of the clock: shorter than a frame of any screen
SPACE, RIGHT, LEFT = 32, 262, 263  # GLFW's codes of keys
KEYS = "space plays and pauses, arrows step, G mesh or Gaussians, R resets, Q quits"


class Source(Protocol):
    """One variant that can be read."""

    def recording(self) -> Recording: ...

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]: ...


class Window:
    """One variant, played until the window is closed; a frame is read when it is shown.

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
        self._skin = Skin(recording.meshes) if recording.meshes or recording.flows else None
        self._balls = Balls(recording.gaussians) if recording.gaussians else None
        self._shapes: dict[str, Any] = {}
        for kind, made in (("mesh", self._skin), ("gaussians", self._balls)):
            if made is not None:
                self._shapes[kind] = self._o3d.geometry.TriangleMesh()
                self._shapes[kind].triangles = self._ints(made.triangles)
                self._shapes[kind].vertex_colors = self._floats(made.colors)
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
        title = f"{self._recording.name} {self._recording.variant}".strip()
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
            skin = skin_at(self._recording, self._skin, frame)
            points, normals = skin.pose((*frame.meshes, *(mesh.points for mesh in frame.flows)))
            if skin is not self._skin:
                shape.triangles = self._ints(skin.triangles)
                shape.vertex_colors = self._floats(skin.colors)
        elif self._balls is not None and frame.positions is not None and frame.axes is not None:
            points, normals = self._balls.pose(frame.positions, frame.axes)
        else:
            return
        shape.vertices, shape.vertex_normals = self._floats(points), self._floats(normals)
        if not shape.has_triangle_normals() or self._recording.flows:
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
        for frame in self._source.frames([codes[i] for i in spread(len(codes), SAMPLED_FRAMES)]):
            cloud = [] if frame.positions is None else [frame.positions]
            flows = [mesh.points for mesh in frame.flows]
            points = np.concatenate([np.zeros((0, 3)), *frame.meshes, *flows, *cloud])
            if not len(points):
                continue
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


ROUNDING = 1e-9  # [s] a time computed a little before a frame's own shows that frame


class Clock:
    """Playback of frames at given times.

    times : [s] of playback, ascending.   now : a clock [s], e.g. `time.perf_counter`.
    """

    def __init__(self, times: Sequence[float], now: Callable[[], float]) -> None:
        self._times, self._now = list(times), now
        # the last frame is held as long as the one before it
        self._length = times[-1] - times[0] + (times[-1] - times[-2] if len(times) > 1 else 0.0)
        self.frame = 0
        self.playing = True
        self._start = now()

    def tick(self) -> bool:
        """Move on to the frame that is due; True where that is another one."""
        if not self.playing or self._length <= 0.0:
            return False
        at = self._times[0] + (self._now() - self._start) % self._length
        frame = max(0, bisect_right(self._times, at + ROUNDING) - 1)
        changed, self.frame = frame != self.frame, frame
        return changed

    def toggle(self) -> None:
        """Play from the frame that is shown, or stop there."""
        self.playing = not self.playing
        self._start = self._now() - (self._times[self.frame] - self._times[0])

    def step(self, by: int) -> None:
        """Stop, and show the frame before or after; it goes round."""
        self.playing = False
        self.frame = (self.frame + by) % len(self._times)

    def rewind(self) -> None:
        """Back to the first frame."""
        self.frame, self._start = 0, self._now()


PACKAGES = "on Debian and Ubuntu: apt-get install libx11-6 libgl1 libegl1 libusb-1.0-0 libgomp1"
INSTEAD = "gf-usd report writes a page that plays in a browser"


def import_open3d() -> Any:
    """The module open3d.

    Raises UsageError where it, or a system library that it needs, is not installed.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"A window needs the Python module {error.name}, which is not installed.",
            f"pip install open3d; without it, {INSTEAD}",
        ) from error
    except (ImportError, OSError) as error:
        raise UsageError(
            f"open3d is installed, but a system library that it needs is not: {error}.", PACKAGES
        ) from error


def require_display() -> None:
    """Raise UsageError where no X display can be opened; elsewhere than on Linux all is well.

    Without a display open3d crashes at the first use of its window.
    """
    if not sys.platform.startswith("linux"):
        return
    name = os.environ.get("DISPLAY")
    if not name:
        raise UsageError(
            "There is no display: the environment variable DISPLAY is not set.",
            f"run it on a desktop, or under xvfb-run; without a display, {INSTEAD}",
        )
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError as error:
        raise UsageError(
            f"A system library that a window needs is not installed: {error}.", PACKAGES
        ) from error
    x11.XOpenDisplay.argtypes = [ctypes.c_char_p]
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if not display:
        raise UsageError(
            f"The display DISPLAY={name} cannot be opened.",
            f"check that it is running and that you may use it; without a display, {INSTEAD}",
        )
    x11.XCloseDisplay(display)


MOST_BALLS = 20_000  # more would not be moved in real time
CELLS = 10  # of the floor's grid, each way from the middle


class Skin:
    """All meshes as one, with vertices split at creases and where the color changes."""

    def __init__(self, meshes: tuple[RenderMesh, ...]) -> None:
        self._skin = make_skin(meshes, sum(len(mesh.points) for mesh in meshes))
        self.triangles = self._skin.corners
        self.colors = self._skin.colors / 255.0

    def pose(self, meshes: tuple[Floats, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vertices and unit normals (D, 3) of the meshes' points; n = sum of a x b over faces."""
        joined = np.concatenate([np.zeros((0, 3)), *meshes])
        points = joined[self._skin.kept][self._skin.source]
        corners = points[self.triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        shade = self._skin.shade
        into = shade[self.triangles].reshape(-1)
        each = np.repeat(face, 3, axis=0)
        count = int(shade.max(initial=-1)) + 1
        total = np.stack([np.bincount(into, each[:, i], minlength=count) for i in range(3)], axis=1)
        normals = total[shade]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points, normals / np.where(length > 0.0, length, 1.0)


def skin_at(recording: Recording, skin: Skin, frame: MotionFrame) -> Skin:
    """The skin of a frame: another one where meshes are there whose faces change."""
    return Skin((*recording.meshes, *frame.flows)) if recording.flows else skin


class Balls:
    """Gaussians as ellipsoids of one standard deviation, a few faces each."""

    def __init__(self, cloud: GaussianSet) -> None:
        self._chosen = sample(len(cloud), MOST_BALLS)
        self._corners, faces = icosahedron()
        count = len(self._chosen)
        first = len(self._corners) * np.arange(count)[:, None, None]
        self.triangles = (faces + first).reshape(-1, 3)
        colors = linear_to_srgb(np.clip(cloud.colors[self._chosen], 0.0, 1.0))
        self.colors = np.repeat(colors, len(self._corners), axis=0)

    def pose(self, positions: Floats, axes: Floats) -> tuple[Floats, Floats]:
        """Vertices x = c + A s and normals along A^-T s, both (12 n, 3)."""
        A = np.asarray(axes)[self._chosen]
        points = np.asarray(positions)[self._chosen][:, None, :] + self._corners @ A.mT
        # cofactors are A^-T but for a factor, and exist where A is flat as well
        cofactor = np.stack(
            [np.cross(A[:, :, (i + 1) % 3], A[:, :, (i + 2) % 3]) for i in range(3)], axis=2
        )
        normals = self._corners @ cofactor.mT
        normals *= np.sign(np.linalg.det(A))[:, None, None]
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        return points.reshape(-1, 3), normals.reshape(-1, 3)


def icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners (12, 3) on the unit ball and faces (20, 3), outward: the hull of (0, ±1, ±phi)."""
    phi = 0.5 * (1.0 + math.sqrt(5.0))
    corners = np.array(
        [np.roll((0.0, a, b * phi), k) for k in range(3) for a in (-1, 1) for b in (-1, 1)]
    )
    faces = []
    for i, j, k in combinations(range(12), 3):
        p, q, r = corners[[i, j, k]]
        if all(abs(np.linalg.norm(d) - 2.0) < 1e-9 for d in (p - q, q - r, r - p)):
            faces.append((i, j, k) if np.dot(np.cross(q - p, r - p), p) > 0.0 else (i, k, j))
    return corners / np.linalg.norm(corners[0]), np.array(faces, dtype=np.int64)


def floor_lines(low: Floats, high: Floats, up: Floats, ground: float) -> NDArray[np.float64]:
    """(n, 2, 3) [m] lines of a grid under a box, at a height along up."""
    axis = int(np.argmax(np.abs(up)))
    across = [i for i in range(3) if i != axis]
    middle = 0.5 * (np.asarray(low) + np.asarray(high))
    reach = 0.75 * float(np.max(np.asarray(high) - low)) or 1.0
    ticks = np.linspace(-reach, reach, 2 * CELLS + 1)
    lines = []
    for along, other in (across, across[::-1]):
        ends = np.tile(middle, (len(ticks), 2, 1))
        ends[:, :, axis] = ground
        ends[:, :, other] += ticks[:, None]
        ends[:, 0, along] -= reach
        ends[:, 1, along] += reach
        lines.append(ends)
    return np.concatenate(lines)
