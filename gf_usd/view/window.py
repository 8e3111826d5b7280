"""A window that plays a bake, drawn by open3d.

`Window` draws the frame of a playback `Clock`: the mesh or the Gaussians as triangles, the floor as
lines.  open3d is an optional dependency, because it is large and needs system libraries;
`import_open3d` and `require_display` check for them before a window opens.
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
from gf_usd.view.report.surface import make_display_mesh
from gf_usd.view.report.thinning import evenly_spaced, random_subset

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
                "The display offers no OpenGL window.", f"{PACKAGES}; without OpenGL, {ALTERNATIVE}"
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


ROUNDING = 1e-9  # [s] tolerance of the time of a frame


class Clock:
    """Playback of frames at given times.

    times : playback times [s], ascending.   now : current time [s], e.g. `time.perf_counter`.
    """

    def __init__(self, times: Sequence[float], now: Callable[[], float]) -> None:
        self._times, self._now = list(times), now
        # the last frame has the duration of the one before
        self._duration = times[-1] - times[0] + (times[-1] - times[-2] if len(times) > 1 else 0.0)
        self.frame = 0
        self.playing = True
        self._start = now()

    def tick(self) -> bool:
        """Advance to the frame of the current time; True if it changes."""
        if not self.playing or self._duration <= 0.0:
            return False
        at = self._times[0] + (self._now() - self._start) % self._duration
        frame = max(0, bisect_right(self._times, at + ROUNDING) - 1)
        changed, self.frame = frame != self.frame, frame
        return changed

    def toggle(self) -> None:
        """Play from the current frame, or pause at it."""
        self.playing = not self.playing
        self._start = self._now() - (self._times[self.frame] - self._times[0])

    def step(self, by: int) -> None:
        """Pause, and step by a number of frames, modulo their number."""
        self.playing = False
        self.frame = (self.frame + by) % len(self._times)

    def rewind(self) -> None:
        """Return to the first frame."""
        self.frame, self._start = 0, self._now()


PACKAGES = "on Debian and Ubuntu: apt-get install libx11-6 libgl1 libegl1 libusb-1.0-0 libgomp1"
ALTERNATIVE = "gf-usd report writes a page that plays in a browser"


def import_open3d() -> Any:
    """Import open3d.

    Raises UsageError where open3d or a system library that it needs is not installed.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"A window needs the Python module {error.name}, which is not installed.",
            f"pip install open3d; without it, {ALTERNATIVE}",
        ) from error
    except (ImportError, OSError) as error:
        raise UsageError(
            f"open3d is installed, but a system library that it needs is not: {error}.", PACKAGES
        ) from error


def require_display() -> None:
    """Raise UsageError where no X display can be opened, on Linux.

    Without a display, open3d crashes at the first use of its window.
    """
    if not sys.platform.startswith("linux"):
        return
    name = os.environ.get("DISPLAY")
    if not name:
        raise UsageError(
            "There is no display: the environment variable DISPLAY is not set.",
            f"run it on a desktop, or under xvfb-run; without a display, {ALTERNATIVE}",
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
            f"check that it is running and that you may use it; without a display, {ALTERNATIVE}",
        )
    x11.XCloseDisplay(display)


MAX_ELLIPSOIDS = 20_000  # limit of playback in real time
GRID_CELLS = 10  # of the floor grid, from the center in each direction


class ShadedMesh:
    """All meshes as one, with the split vertices of `make_display_mesh`."""

    def __init__(self, meshes: tuple[RenderMesh, ...]) -> None:
        self._mesh = make_display_mesh(meshes, sum(len(mesh.points) for mesh in meshes))
        self.triangles = self._mesh.corners
        self.colors = self._mesh.colors / 255.0

    def pose(self, meshes: tuple[Floats, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vertices and unit normals (D, 3) at points of the meshes; n ~ sum of a x b over faces."""
        joined = np.concatenate([np.zeros((0, 3)), *meshes])
        points = joined[self._mesh.kept][self._mesh.source]
        corners = points[self.triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        groups = self._mesh.shade
        corner_groups = groups[self.triangles].reshape(-1)
        corner_normals = np.repeat(face, 3, axis=0)
        count = int(groups.max(initial=-1)) + 1
        normal_sums = np.stack(
            [np.bincount(corner_groups, corner_normals[:, i], minlength=count) for i in range(3)],
            axis=1,
        )
        normals = normal_sums[groups]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return points, normals / np.where(length > 0.0, length, 1.0)


def mesh_at_frame(recording: Recording, mesh: ShadedMesh, frame: MotionFrame) -> ShadedMesh:
    """The mesh of a frame: a new one for recordings with meshes of varying topology."""
    return ShadedMesh((*recording.meshes, *frame.flows)) if recording.flows else mesh


class EllipsoidMesh:
    """Gaussians as icosahedra scaled to ellipsoids of one standard deviation."""

    def __init__(self, cloud: GaussianSet) -> None:
        self._indices = random_subset(len(cloud), MAX_ELLIPSOIDS)
        self._corners, faces = icosahedron()
        count = len(self._indices)
        first = len(self._corners) * np.arange(count)[:, None, None]
        self.triangles = (faces + first).reshape(-1, 3)
        colors = linear_to_srgb(np.clip(cloud.colors[self._indices], 0.0, 1.0))
        self.colors = np.repeat(colors, len(self._corners), axis=0)

    def pose(self, positions: Floats, axes: Floats) -> tuple[Floats, Floats]:
        """Vertices x = c + A s and normals along A^-T s, both (12 n, 3)."""
        A = np.asarray(axes)[self._indices]
        points = np.asarray(positions)[self._indices][:, None, :] + self._corners @ A.mT
        # the cofactor matrix is det(A) A^-T, and exists for singular A too
        cofactor = np.stack(
            [np.cross(A[:, :, (i + 1) % 3], A[:, :, (i + 2) % 3]) for i in range(3)], axis=2
        )
        normals = self._corners @ cofactor.mT
        normals *= np.sign(np.linalg.det(A))[:, None, None]
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        return points.reshape(-1, 3), normals.reshape(-1, 3)


def icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners (12, 3) on the unit sphere and outward faces (20, 3) of an icosahedron.

    It is the convex hull of the cyclic permutations of (0, ±1, ±phi), phi the golden ratio.
    """
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
    """Lines (n, 2, 3) [m] of a grid below a box, at a height [m] along up."""
    axis = int(np.argmax(np.abs(up)))
    across = [i for i in range(3) if i != axis]
    middle = 0.5 * (np.asarray(low) + np.asarray(high))
    half_size = 0.75 * float(np.max(np.asarray(high) - low)) or 1.0
    ticks = np.linspace(-half_size, half_size, 2 * GRID_CELLS + 1)
    lines = []
    for along, other in (across, across[::-1]):
        ends = np.tile(middle, (len(ticks), 2, 1))
        ends[:, :, axis] = ground
        ends[:, :, other] += ticks[:, None]
        ends[:, 0, along] -= half_size
        ends[:, 1, along] += half_size
        lines.append(ends)
    return np.concatenate(lines)
