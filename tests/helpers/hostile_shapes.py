"""Meshes that no modeler would hand in, as USD; what a bake makes of them is for the tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

Shape = tuple[np.ndarray, np.ndarray]  # points (V, 3), triangles (T, 3)


def ball(radius: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Shape:
    """A sphere of 320 triangles."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(mesh.vertices) + at, np.asarray(mesh.faces)


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Shape:
    """A box of 12 triangles about a place."""
    mesh = trimesh.creation.box(extents=size)
    return np.asarray(mesh.vertices) + at, np.asarray(mesh.faces)


def joined(*shapes: Shape) -> Shape:
    """Several shapes as one mesh."""
    starts = np.cumsum([0, *(len(points) for points, _ in shapes)])
    return (
        np.concatenate([points for points, _ in shapes]),
        np.concatenate([faces + start for (_, faces), start in zip(shapes, starts)]),
    )


def inside_out() -> Shape:
    points, faces = ball()
    return points, faces[:, ::-1]


def half_inside_out() -> Shape:
    points, faces = ball()
    faces = faces.copy()
    faces[::2] = faces[::2, ::-1]
    return points, faces


def one_place() -> Shape:
    points, faces = ball()
    return np.zeros_like(points), faces


def a_line() -> Shape:
    points, faces = ball()
    return points * (1.0, 0.0, 0.0), faces


def flat() -> Shape:
    points, faces = ball()
    return points * (1.0, 0.0, 1.0), faces


def nearly_flat() -> Shape:
    points, faces = ball()
    return points * (1.0, 1e-7, 1.0), faces


def three_on_an_edge() -> Shape:
    """Two boxes that share an edge, and a fin on it."""
    points, faces = joined(box((1, 1, 1)), box((1, 1, 1), (1.0, 1.0, 0.0)))
    points = np.concatenate([points, [[0.5, 0.5, -0.5], [0.5, 0.5, 0.5], [2.0, 0.0, 0.0]]])
    return points, np.concatenate([faces, [[16, 17, 18]]])


def touching_in_a_point() -> Shape:
    return joined(box((1, 1, 1)), box((1, 1, 1), (1.0, 1.0, 1.0)))


def through_itself() -> Shape:
    """A torus whose tube is wider than its hole."""
    mesh = trimesh.creation.torus(major_radius=0.5, minor_radius=0.8)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def overlapping() -> Shape:
    return joined(ball(), ball(0.9, (0.7, 0.0, 0.0)), ball(0.3))


def every_face_twice() -> Shape:
    points, faces = ball()
    return points, np.concatenate([faces, faces])


def back_to_back() -> Shape:
    points, faces = ball()
    return points, np.concatenate([faces, faces[:, ::-1]])


def slivers() -> Shape:
    points, faces = ball()
    return points * (1.0, 1.0, 1e-5), faces


def spike() -> Shape:
    points, faces = ball()
    points[0] *= 1e6
    return points, faces


def same_corner() -> Shape:
    points, faces = ball()
    faces = faces.copy()
    faces[::3] = faces[::3, :1]
    return points, faces


def stray_point() -> Shape:
    points, faces = ball()
    return np.concatenate([points, [[1e30, -1e30, 1e30]]]), faces


def loose_point() -> Shape:
    points, faces = ball()
    return np.concatenate([points, [[100.0, -100.0, 100.0]]]), faces


def one_triangle() -> Shape:
    return np.eye(3), np.array([[0, 1, 2]])


def noise() -> Shape:
    """Triangles between random points: no surface at all."""
    dice = np.random.default_rng(0)
    return dice.normal(size=(60, 3)), dice.integers(0, 60, (200, 3))


def shells(count: int) -> Shape:
    """Small boxes on a lattice."""
    side = int(np.ceil(count ** (1 / 3)))
    at = np.stack(np.unravel_index(np.arange(count), (side,) * 3), -1) * 2.0
    return joined(*(box((1, 1, 1), tuple(place)) for place in at))


def scaled(factor: float) -> Callable[[], Shape]:
    def made() -> Shape:
        points, faces = ball()
        return factor * points, faces

    return made


SHAPES: dict[str, Callable[[], Shape]] = {
    shape.__name__: shape
    for shape in (
        inside_out, half_inside_out, one_place, a_line, flat, nearly_flat, three_on_an_edge,
        touching_in_a_point, through_itself, overlapping, every_face_twice, back_to_back, slivers,
        spike, same_corner, stray_point, loose_point, one_triangle, noise,
    )
}  # fmt: skip
SCALES = {f"{factor:g} units": scaled(factor) for factor in (1e-9, 1e-6, 1e6, 1e9)}


def usda(shape: Shape, *, meters_per_unit: float = 1.0, more: str = "") -> str:
    """A stage of one mesh; more : lines of the mesh."""
    points, faces = shape
    corners = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in points)
    return f"""#usda 1.0
(
    defaultPrim = "Body"
    metersPerUnit = {meters_per_unit!r}
    upAxis = "Y"
)
def Xform "Body"
{{
    def Mesh "Skin"
    {{
        point3f[] points = [{corners}]
        int[] faceVertexCounts = {[3] * len(faces)}
        int[] faceVertexIndices = {[int(i) for i in faces.ravel()]}
        uniform token subdivisionScheme = "none"
{more}    }}
}}
"""
