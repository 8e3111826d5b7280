"""One baked mesh in the cache layer: overs on its own prim, in its own local space.

TetMesh and Points prims are written likewise, with their own topology: every point of a
TetMesh, and the points of a Points prim without the surface that was reconstructed around them.

A bake keeps the topology of its first frame.  If the topology of the source changes, arrays with an
element for each point, face or corner whose length changes with it keep their value of that frame;
arrays of constant length stay animated.

A polygon mesh without normals gets smooth ones with creases.  The normal at a corner has the
direction of the sum of the area vectors of those faces around its point whose angle to the face of
the corner at rest is less than the crease angle.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt
from scipy.sparse import csr_matrix

from gf_usd.core.arrays import Floats, Ints, corners, cross
from gf_usd.core.asset import Surface
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.frame import MeshPose
from gf_usd.core.units import code_text
from gf_usd.layers.space import Space
from gf_usd.layers.stage import Clock, author_bind_pose, f32
from gf_usd.layers.tracks.sparse import Saved

Types = Sdf.ValueTypeNames
KEPT = ("Mesh", "TetMesh", "Points")  # types that have points of their own


class MeshTrack:
    """Streams one surface's poses.

    Topology, primvars, subsets and bindings stay those of the source; an implicit shape becomes
    a Mesh with the surface's own topology.

    Parameters
    ----------
    cache : stage whose root layer is the cache.
    prim : the surface's prim in the source.
    surface : what the reader made of it.
    clock, meters_per_unit : of the bake.
    velocities : whether they are written; else those of the source are blocked.
    clips : whether the samples are written to value clips.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        prim: Usd.Prim,
        surface: Surface,
        clock: Clock,
        meters_per_unit: float,
        *,
        velocities: bool = True,
        clips: bool = False,
    ) -> None:
        self.path = Sdf.Path(surface.path)
        self.notes: list[str] = []
        self.space = Space(prim, clock, meters_per_unit)
        self.low = self.high = np.zeros(3)
        self._surface = surface
        self._own = slice(surface.own_points)
        self._widths = _widths(prim, clock.source_time(clock.start))
        over = cache.OverridePrim(self.path)
        self._points = over.CreateAttribute("points", Types.Point3fArray, False)
        self._extent = over.CreateAttribute("extent", Types.Float3Array, False)
        self._velocities, self.saved = None, Saved()
        if velocities:
            self._velocities = over.CreateAttribute("velocities", Types.Vector3fArray, False)
        elif prim.GetAttribute("velocities").HasAuthoredValue():
            over.CreateAttribute("velocities", Types.Vector3fArray, False).Block()
        self._normals = None
        self._shading = None
        if surface.type_name in KEPT:
            self._replace_normals(over, prim, clips=clips)
        if surface.type_name == "Mesh":
            mesh = UsdGeom.Mesh(prim)
            topology = (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
            if any(attr.ValueMightBeTimeVarying() for attr in topology):
                self._author_topology(over)
                freeze_varying_arrays(cache, prim, clock.source_time(clock.start))
        elif surface.type_name not in KEPT:
            self._convert_to_mesh(over)
        if prim.GetAttribute("accelerations").HasAuthoredValue():
            over.CreateAttribute("accelerations", Types.Vector3fArray, False).Block()
        if surface.skinned:
            _unskin(over, prim)
        self._prim, self._over = prim, over

    def write_bind_pose(self, time_code: float) -> None:
        """Author the rest pose as the bind pose of the mesh to a simulation mesh.

        time_code : of the prim's transform.
        """
        points = self.space.points(self._surface.points[self._own], time_code)
        author_bind_pose(self._over, f32(points))

    def write(self, pose: MeshPose, time_code: float) -> None:
        """Author the pose at a time code: points, extent, velocities, normals.

        Raises BakeError where the pose has another number of points or is not finite.
        """
        expected = np.shape(self._surface.points)
        check(pose.points, expected, f"points of <{self.path}>", time_code)
        check(pose.velocities, expected, f"velocities of <{self.path}>", time_code)
        x, v = pose.points[self._own], pose.velocities[self._own]
        points = f32(self.space.points(x, time_code))
        velocities = f32(self.space.velocities(x, v, time_code))
        self.low, self.high = corners(points)
        if self._widths is not None:  # in single precision, as USD computes it of points and widths
            half = self._widths * np.float32(0.5)
            self.low, self.high = corners(points - half)[0], corners(points + half)[1]
        extent = f32(np.stack([self.low, self.high]))
        self._points.Set(Vt.Vec3fArray.FromNumpy(points), time_code)
        self._extent.Set(Vt.Vec3fArray.FromNumpy(extent), time_code)
        if self._velocities is not None:
            self._velocities.Set(Vt.Vec3fArray.FromNumpy(velocities), time_code)
        else:
            self.saved.count(velocities, velocities.nbytes)
        normals = self._local_normals(pose, points, time_code)
        if self._normals is not None and normals is not None:
            self._normals.Set(Vt.Vec3fArray.FromNumpy(f32(normals)), time_code)

    def to_world(self, time_code: float) -> Floats:
        """Local-to-world matrix (4, 4) for row vectors, stage units."""
        return np.linalg.inv(self.space.from_world(time_code))

    def _local_normals(self, pose: MeshPose, points: Floats, time_code: float) -> Floats | None:
        if self._shading is not None:
            return self._shading.of(points)
        rest = self._surface.normals
        if self._normals is None or rest is None or pose.normals is None:
            return None
        check(pose.normals, np.shape(rest), f"normals of <{self.path}>", time_code)
        return self.space.normals(pose.normals, time_code)

    @property
    def rest(self) -> dict[Sdf.Path, Vt.Vec3fArray] | None:
        """The source's values of the written arrays at rest, where none of them has an authored
        sample.

        None where they change over time, lack an extent, or are not those of the body: for skinned
        meshes, shapes that become meshes and indexed normals.
        """
        if self._surface.type_name not in KEPT or self._surface.skinned:
            return None
        based = UsdGeom.PointBased(self._prim)
        sources = [based.GetPointsAttr(), based.GetExtentAttr()]
        sources += [based.GetVelocitiesAttr()] if self._velocities is not None else []
        if self._normals is not None:
            primvar = UsdGeom.PrimvarsAPI(self._prim).GetPrimvar("normals")
            if primvar.HasAuthoredValue() and primvar.IsIndexed():
                return None
            sources.append(self._prim.GetAttribute(self._normals.GetName()))
        if any(one.ValueMightBeTimeVarying() for one in sources):
            return None
        found = {self.path.AppendProperty(one.GetName()): one.Get() for one in sources}
        points = found[self._points.GetPath()]
        if self._velocities is not None and points is not None:
            velocities = self._velocities.GetPath()
            found[velocities] = found[velocities] or Vt.Vec3fArray(len(points))
        return None if any(one is None for one in found.values()) else found

    def _convert_to_mesh(self, over: Usd.Prim) -> None:
        surface = self._surface
        over.SetTypeName("Mesh")
        mesh = UsdGeom.Mesh(over)
        self._author_topology(over)
        # a tessellated shape needs no subdivision
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        # without normals such a mesh is rendered faceted
        self._shading = CornerNormals(surface.points, surface.face_counts, surface.face_indices)
        self._normals = over.CreateAttribute("normals", Types.Normal3fArray, False)
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)

    def _author_topology(self, over: Usd.Prim) -> None:
        mesh = UsdGeom.Mesh(over)
        counts = np.ascontiguousarray(self._surface.face_counts, np.int32)
        indices = np.ascontiguousarray(self._surface.face_indices, np.int32)
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))

    def _replace_normals(self, over: Usd.Prim, prim: Usd.Prim, *, clips: bool) -> None:
        mesh = UsdGeom.PointBased(prim)
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
        named = primvar.GetAttr() if primvar.HasAuthoredValue() else mesh.GetNormalsAttr()
        if not named.HasAuthoredValue():
            return
        mine = over.CreateAttribute(named.GetName(), named.GetTypeName(), named.IsCustom())
        normals = self._surface.normals
        if normals is None:
            mine.Block()
            if mesh.GetNormalsAttr().HasAuthoredValue():  # which the primvar overrode
                over.CreateAttribute("normals", Types.Normal3fArray, False).Block()
            self.notes.append(
                f"<{self.path}>: its authored normals cannot follow the motion and are blocked"
            )
            return
        self._normals = mine
        if primvar.HasAuthoredValue() and primvar.IsIndexed():
            # the surface's normals are no longer indexed; nor may those of the default time be,
            # of which the source's value without its indices is too short
            name = f"{named.GetName()}:indices"
            over.CreateAttribute(name, Types.IntArray, False).Block()
            flat = primvar.ComputeFlattened(Usd.TimeCode.Default())
            if flat and not clips:  # a default would hide the samples of value clips
                mine.Set(flat)


def _widths(prim: Usd.Prim, time: Usd.TimeCode) -> np.ndarray | None:
    """(n, 1) or (1, 1) widths of the balls of Points; None for other prims."""
    if prim.IsA(UsdGeom.Points):
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths")
        value = primvar.ComputeFlattened(time) if primvar.HasAuthoredValue() else None
        value = UsdGeom.Points(prim).GetWidthsAttr().Get(time) if value is None else value
        if value is not None and len(value):
            return np.asarray(value, np.float32)[:, None]
    return None


def check(values: Floats, shape: tuple[int, ...], what: str, time_code: float) -> None:
    """Raise BakeError unless ``values`` has this shape and is finite."""
    if np.shape(values) != shape:
        raise BakeError(
            f"{what} at time code {code_text(time_code)} have shape {np.shape(values)}, not"
            f" {shape}",
            "this is a bug in gf-usd, not a fault of the asset: please report it",
        )
    finite = np.isfinite(values)
    if not finite.all():
        bad = int((~finite).sum())
        raise BakeError(
            f"{what} at time code {code_text(time_code)} contain {bad} numbers that are not finite",
            "the simulation became unstable: try a smaller --spacing or a softer --material",
        )


def end_instancing(cache: Usd.Stage, prim: Usd.Prim) -> None:
    """End every instance above a prim: opinions on instance proxies are ignored."""
    if not prim.IsInstanceProxy():
        return
    parent = prim.GetParent()
    while not parent.IsPseudoRoot():
        if parent.IsInstance():
            cache.OverridePrim(parent.GetPath()).SetInstanceable(False)
        parent = parent.GetParent()


def _unskin(over: Usd.Prim, prim: Usd.Prim) -> None:
    # the baked points are posed already; SkelBindingAPI itself stays, since the source's skel:
    # properties do and UsdValidation calls those without it an error
    binding = UsdSkel.BindingAPI(prim)
    for rel in (binding.GetSkeletonRel(), binding.GetAnimationSourceRel()):
        over.CreateRelationship(rel.GetName(), False).SetTargets([])
    targets = binding.GetBlendShapeTargetsRel()
    if targets.HasAuthoredTargets():
        over.CreateRelationship(targets.GetName(), False).SetTargets([])
    # some readers use weights even without the API
    for name in ("primvars:skel:jointIndices", "primvars:skel:jointWeights", "skel:blendShapes"):
        attr = prim.GetAttribute(name)
        if attr.HasAuthoredValue():
            over.CreateAttribute(name, attr.GetTypeName(), attr.IsCustom()).Block()


NORMALS = "primvars:normals"  # the bake writes its own
TAGS = (
    *("holeIndices", "creaseIndices", "creaseLengths", "creaseSharpnesses"),
    *("cornerIndices", "cornerSharpnesses"),
)


def freeze_varying_arrays(cache: Usd.Stage, prim: Usd.Prim, time: Usd.TimeCode) -> None:
    """Author in ``cache`` the value at ``time`` of every array of the mesh whose length changes."""
    for attribute in _arrays(prim):
        value = attribute.Get(time)
        if value is None or not _length_changes(attribute):
            continue
        over = cache.OverridePrim(attribute.GetPrimPath())
        mine = over.CreateAttribute(
            attribute.GetName(),
            attribute.GetTypeName(),
            attribute.IsCustom(),
            attribute.GetVariability(),
        )
        mine.Set(value)


def _arrays(prim: Usd.Prim) -> Iterator[Usd.Attribute]:
    yield from (prim.GetAttribute(name) for name in TAGS)
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
        if primvar.GetInterpolation() != UsdGeom.Tokens.constant and primvar.GetName() != NORMALS:
            yield primvar.GetAttr()
            if primvar.IsIndexed():
                yield primvar.GetIndicesAttr()
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        yield subset.GetIndicesAttr()


def _length_changes(attribute: Usd.Attribute) -> bool:
    lengths = (len(attribute.Get(time) or ()) for time in attribute.GetTimeSamples())
    first = next(lengths, 0)
    return any(length != first for length in lengths)


# between the 5 degrees of a fine tessellation and the 90 of a box
CREASE = 50.0


class CornerNormals:
    """Corner normals of one topology.

    Parameters
    ----------
    rest : (V, 3) points from which creases are computed, any unit.
    counts : (P,) corners of each face.
    indices : (C,) points of the corners.
    crease : [deg] faces that meet at a larger angle have separate normals.
    """

    def __init__(self, rest: Floats, counts: Ints, indices: Ints, crease: float = CREASE) -> None:
        counts, self._indices = np.asarray(counts), np.asarray(indices)
        self._face = np.repeat(np.arange(len(counts)), counts)
        self._first = np.repeat(np.cumsum(counts) - counts, counts)
        corners = np.arange(len(self._indices))
        last = np.append(self._face[1:] != self._face[:-1], True)
        self._next = np.where(last, self._first, corners + 1)
        self._faces = len(counts)
        area = self._areas(rest)
        length = np.linalg.norm(area, axis=1, keepdims=True)
        unit = np.divide(area, length, out=np.zeros_like(area), where=length > 0)
        # (C, P): the faces around each corner's point
        at_point = csr_matrix(
            (np.ones(len(corners)), (self._indices, self._face)),
            shape=(len(np.asarray(rest)), self._faces),
        )
        around = at_point[self._indices].tocoo()
        facing = np.einsum("ij,ij->i", unit[self._face[around.row]], unit[around.col])
        kept = (facing > np.cos(np.radians(crease))) | (self._face[around.row] == around.col)
        self._sum = csr_matrix(
            (np.ones(kept.sum()), (around.row[kept], around.col[kept])), shape=around.shape
        )

    def of(self, points: Floats) -> Floats:
        """Unit normals (C, 3), outward for counter-clockwise faces; zero where the area is zero."""
        total = self._sum @ self._areas(points)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.divide(total, length, out=np.zeros_like(total), where=length > 0)

    def _areas(self, points: Floats) -> Floats:
        """Area vectors (P, 3): sum over a face's edges of half (a - o) x (b - o)."""
        x = np.asarray(points, np.float64)[self._indices]
        half = 0.5 * cross(x - x[self._first], x[self._next] - x[self._first])
        areas = np.zeros((self._faces, 3))
        np.add.at(areas, self._face, half)
        return areas
