"""Attachments of a bake's tetrahedra to pins, for other simulators.

They are PhysicsAttachment prims of the AOUSD proposal for deformables: points of a TetMesh (src0)
at positions in the frame of a prim (src1).  Where a pin moves like the prim that it is named after,
or one above it, that prim is src1 and the positions are constant; otherwise they are in the frame
of the attachments' own prim, with time samples.  The proposal cannot describe a region that ends
between points: GaussianFleshAttachmentAPI has the region itself, and the motion of its own points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, free_name, prim_name
from gf_usd.core.frames.frame import MeshPose
from gf_usd.core.frames.particles import TetAttachment, TetLattice
from gf_usd.core.frames.settings import Settings, sampled
from gf_usd.layers.space import Space
from gf_usd.layers.stage import Clock, vectors
from gf_usd.system.usd_schema import ATTACHMENT_API

Types = Sdf.ValueTypeNames
ATTACHMENTS = ("PhysicsAttachment", "OmniPhysicsVtxXformAttachment")
SAME = 1e-5  # of the region: places are single precision


def not_in_source(
    source: Usd.Stage, attachments: Sequence[TetAttachment]
) -> tuple[TetAttachment, ...]:
    """The attachments that are not already in a stage."""
    return tuple(
        one
        for one in attachments
        if not (prim := _named(source, one)) or str(prim.GetTypeName()) not in ATTACHMENTS
    )


def _named(source: Usd.Stage, one: TetAttachment) -> Usd.Prim:
    """The prim that a pin is named after; an invalid prim for other names."""
    return source.GetPrimAtPath(one.pin) if one.pin.startswith("/") else Usd.Prim()


class Attachments:
    """Writes the attachments of a bake's tetrahedra, under a prim of their own.

    Parameters
    ----------
    cache, path : stage and path of the parent prim.
    source : the baked stage.
    attachments : one for each pin and body.
    tets : by body, with the path of its TetMesh.
    asset, settings, clock : of the bake.
    origin : (3,) [stage units] origin of positions.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        source: Usd.Stage,
        attachments: Sequence[TetAttachment],
        tets: Mapping[int, tuple[TetLattice, Sdf.Path]],
        asset: Asset,
        settings: Settings,
        clock: Clock,
        origin: Floats,
    ) -> None:
        self.prim = UsdGeom.Xform.Define(cache, path).GetPrim()
        self._unit, self._origin = asset.facts.units.length, origin
        self._moving: list[tuple[str, TetAttachment, Usd.Attribute, Usd.Attribute]] = []
        every, root = sampled(settings), path.GetPrefixes()[0]
        self._times = [every.time_code(index) for index in range(every.frames)]
        meshes = [Sdf.Path(s.path) for s in asset.surfaces]
        if not all(mesh.HasPrefix(root) for mesh in meshes):
            meshes = []  # a payload may not point outside of its root prim
        self._lift = lift = np.asarray(settings.lift, float)
        for one in attachments:
            lattice, mesh = tets[one.body]
            name = free_name(_name_of(one.pin), self.prim.GetAllChildrenNames().__contains__)
            prim = cache.DefinePrim(path.AppendChild(name), ATTACHMENTS[0])
            carrier = self._reference_prim(_named(source, one), root, one, clock)
            still = lattice.X[one.points] + lift
            prim.CreateRelationship("physics:src0", False).SetTargets([mesh])
            onto = path if carrier is None else carrier[0]
            prim.CreateRelationship("physics:src1", False).SetTargets([onto])
            uniform = Sdf.VariabilityUniform
            for name, kind in (("type0", "point"), ("type1", "xform")):
                prim.CreateAttribute(f"physics:{name}", Types.Token, False, uniform).Set(kind)
            indices = Vt.IntArray.FromNumpy(np.ascontiguousarray(one.points, np.int32))
            prim.CreateAttribute("physics:indices0", Types.IntArray, False).Set(indices)
            prim.CreateAttribute("physics:stiffness", Types.Float, False).Set(np.inf)
            coords = prim.CreateAttribute("physics:coords1", Types.Vector3fArray, False)
            if carrier is not None:
                coords.Set(vectors(carrier[1].points(still, self._times[0])))
            elif len(one.path) == 1:
                coords.Set(vectors(self._local(still)))
            else:
                anchors = prim.CreateAttribute("gaussianFlesh:anchors", Types.Point3fArray, False)
                self._moving.append((lattice.key, one, coords, anchors))
            prim.ApplyAPI(ATTACHMENT_API)
            prim.CreateAttribute("gaussianFlesh:pin", Types.String, False, uniform).Set(one.pin)
            prim.CreateRelationship("gaussianFlesh:sourceMeshes", False).SetTargets(meshes)

    def write(self, poses: Mapping[str, MeshPose], time_code: float) -> None:
        """Author the moving positions at a time code; poses : by `TetLattice.key`."""
        frame = int(np.searchsorted(self._times, time_code - 1e-9))
        for key, one, coords, anchors in self._moving:
            coords.Set(vectors(self._local(poses[key].points[one.points])), time_code)
            now = one.path[min(frame, len(one.path) - 1)] + self._lift
            anchors.Set(vectors(self._local(now)), time_code)

    def _local(self, x: Floats) -> np.ndarray:
        return np.asarray(x, np.float64) / self._unit - self._origin

    def _reference_prim(
        self, named: Usd.Prim, root: Sdf.Path, one: TetAttachment, clock: Clock
    ) -> tuple[Sdf.Path, Space] | None:
        """The prim in whose frame the positions are constant; None where there is none.

        root : a payload may not refer to prims outside its root prim.
        """
        while named and not named.IsA(UsdGeom.Xformable):
            named = named.GetParent()
        if not named or named.IsPseudoRoot() or not named.GetPath().HasPrefix(root):
            return None
        space = Space(named, clock, self._unit)
        if len(one.path) == 1 and not space.animated:
            return named.GetPath(), space
        first = space.points(one.path[0], self._times[0])
        most = SAME * float(np.ptp(first, axis=0).max())
        for index, code in enumerate(self._times):
            x = one.path[min(index, len(one.path) - 1)]
            if np.abs(space.points(x, code) - first).max() > most:
                return None
        return named.GetPath(), space


def _name_of(pin: str) -> str:
    """The prim name of the attachment of a pin: the last part of the pin's name, or its kind."""
    return prim_name(pin.rpartition("/")[2] if pin.startswith("/") else pin.partition(":")[0])
