"""A body as a TetMesh that other simulators read, with the motion of the bake.

The API schemas are those of the AOUSD proposal for deformables and of Omniverse, known by name
only: usd-core defines neither.  The rest shape is `restShapePoints`, with the connectivity of the
mesh; the masses of the points add up to that of the body, m_i = M sum of V_tet / 4 over the
tetrahedra at i, over their whole volume.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats, corners, cross
from gf_usd.core.frames.frame import BakeInfo, MeshPose
from gf_usd.core.frames.particles import Particles, TetLattice
from gf_usd.core.materials.per_particle import spread
from gf_usd.core.mesh.topology import tet_surface
from gf_usd.core.units import StageUnits
from gf_usd.layers.materials import bind
from gf_usd.layers.stage import author_bind_pose, box, f32
from gf_usd.layers.tracks.meshes import check
from gf_usd.layers.tracks.sparse import Saved

Types = Sdf.ValueTypeNames
BODY_APIS = ("PhysicsDeformableBodyAPI", "OmniPhysicsDeformableBodyAPI")
VOLUME_APIS = ("PhysicsVolumeDeformableSimAPI", "OmniPhysicsVolumeDeformableSimAPI")
COLLISION_API = "PhysicsCollisionAPI"


class TetTrack:
    """Writes the tetrahedra of one body.

    Parameters
    ----------
    cache, path : stage and prim path of the TetMesh.
    tets : at rest.
    particles, info : of the bake.
    units : of the stage.
    origin : (3,) [stage units] origin of positions.
    materials : Material prims in the order of the bake's materials.
    velocities : whether they are written.
    still : give the points a default value, for readers without a time; not with value clips, which
        it would hide.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        tets: TetLattice,
        particles: Particles,
        info: BakeInfo,
        units: StageUnits,
        origin: Floats,
        materials: Sequence[Sdf.Path],
        *,
        still: bool,
        velocities: bool = True,
    ) -> None:
        mesh = UsdGeom.TetMesh.Define(cache, path)
        self.path, self.prim, self.body = path, mesh.GetPrim(), tets.body
        self.low = self.high = np.zeros(3)
        self._count, self._unit, self._origin = len(tets.X), units.length, origin
        mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
        mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        indices = np.ascontiguousarray(tets.tets, np.int32)
        mesh.CreateTetVertexIndicesAttr(Vt.Vec4iArray.FromNumpy(indices))
        faces = np.ascontiguousarray(tet_surface(tets.tets)[0], np.int32)
        mesh.CreateSurfaceFaceVertexIndicesAttr(Vt.Vec3iArray.FromNumpy(faces))
        for api in (*BODY_APIS, *VOLUME_APIS, COLLISION_API):
            self.prim.AddAppliedSchema(api)
        rest = Vt.Vec3fArray.FromNumpy(f32(self._local(tets.X)))
        for name in ("physics", "omniphysics"):
            shape = f"{name}:restShapePoints"
            self.prim.CreateAttribute(shape, Types.Point3fArray, False).Set(rest)
        author_bind_pose(self.prim, f32(self._local(tets.X)))
        of = particles.body_of
        mine = of == tets.body
        weight = np.asarray(particles.V0, float) * spread(particles, info.materials)["density"]
        mass = float(weight[mine].sum()) / units.mass
        masses = f32(mass * point_shares(tets))
        self.prim.CreateAttribute("physics:masses", Types.FloatArray, False).Set(
            Vt.FloatArray.FromNumpy(masses)
        )
        self.prim.CreateAttribute("omniphysics:mass", Types.Float, False).Set(mass)
        most = np.bincount(np.asarray(particles.material)[mine], weight[mine]).argmax()
        bind(self.prim, materials[int(most)])
        self._points = mesh.CreatePointsAttr()
        if still:
            lift = np.asarray(info.settings.lift, float)
            at = Vt.Vec3fArray.FromNumpy(f32(self._local(tets.X + lift)))
            self._points.Set(at)
        self._velocities = mesh.CreateVelocitiesAttr() if velocities else None
        self.saved = Saved()
        self._extent = mesh.CreateExtentAttr()

    def write(self, pose: MeshPose, time_code: float) -> None:
        """Author the pose at a time code; raises BakeError as `MeshTrack.write`."""
        check(pose.points, (self._count, 3), f"points of <{self.path}>", time_code)
        check(pose.velocities, (self._count, 3), f"velocities of <{self.path}>", time_code)
        points = f32(self._local(pose.points))
        velocities = f32(np.asarray(pose.velocities) / self._unit)
        self.low, self.high = corners(points)
        self._points.Set(Vt.Vec3fArray.FromNumpy(points), time_code)
        if self._velocities is not None:
            self._velocities.Set(Vt.Vec3fArray.FromNumpy(velocities), time_code)
        else:
            self.saved.count(velocities, velocities.nbytes)
        self._extent.Set(box(self.low, self.high), time_code)

    def _local(self, x: Floats) -> np.ndarray:
        return np.asarray(x, np.float64) / self._unit - self._origin


def point_shares(tets: TetLattice) -> Floats:
    """(n,) the share of each point in the volume of the tetrahedra; they add up to 1."""
    a, b, c, d = np.moveaxis(np.asarray(tets.X, float)[tets.tets], 1, 0)
    volume = np.einsum("ij,ij->i", b - a, cross(c - a, d - a))
    return np.bincount(tets.tets.ravel(), np.repeat(volume, 4), len(tets.X)) / (4 * volume.sum())
