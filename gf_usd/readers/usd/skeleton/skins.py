"""UsdSkel skinning at one time: points, blend shapes and normals of skinned meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from gf_usd.core.arrays import Floats
from gf_usd.core.matrices import signed_polar
from gf_usd.readers.notes import POSED, Notes
from gf_usd.readers.usd.stage import Placement

PROXIES = Usd.TraverseInstanceProxies()


@dataclass(frozen=True)
class SkinnedPlacement(Placement):
    """Points skinned in skeleton space, then transformed by its local-to-world `matrix`."""

    skeleton: UsdSkel.SkeletonQuery
    skin: UsdSkel.SkinningQuery
    time: Usd.TimeCode
    notes: Notes
    bind: bool = False  # in the bind pose, without joint transforms

    @property
    def skinned(self) -> bool:
        """True: the points are skinned."""
        return True

    @property
    def _bind(self) -> Floats:
        return np.array(self.skin.GetGeomBindTransform(self.time))[:3, :3]

    @property
    def mirrored(self) -> bool:
        """True where the bind and skeleton transforms together reverse the winding."""
        return bool(np.linalg.det(self._bind @ self.matrix[:3, :3]) < 0.0)

    def points(self, points: Floats) -> Floats:
        """(V, 3) authored points to skinned world points."""
        posed = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, dtype=np.float32))
        if self.skin.HasBlendShapes():
            self._blend(posed)
        if self.bind:
            blended = np.array(posed, dtype=np.float64).reshape(-1, 3)
            M = self.bind_matrix
            return super().points(blended @ M[:3, :3] + M[3, :3])
        if self.skin.HasJointInfluences():
            joints = self.skeleton.ComputeSkinningTransforms(self.time)
            self.skin.ComputeSkinnedPoints(joints, posed, self.time)
        return super().points(np.array(posed, dtype=np.float64).reshape(-1, 3))

    def normals(self, normals: Floats, carriers: NDArray[np.int64]) -> Floats:
        """(K, 3) authored normals to world space, by the joints of the points `carriers` (K,)."""
        if self.skin.HasBlendShapes():
            self._remark("its normals follow its joints, but not its blend shapes")
        if self.bind:
            if self.skin.HasJointInfluences() and np.linalg.det(self._bind) != 0.0:
                normals = normals @ np.linalg.inv(self._bind).T
            return super().normals(normals, carriers)
        if self.skin.HasJointInfluences():
            posed = self._skin_normals(normals, carriers)
            if posed is None:
                self._remark("its normals cannot follow its joints and stay in their bind pose")
            else:
                normals = posed
        return super().normals(normals, carriers)

    @property
    def bind_matrix(self) -> NDArray[np.float64]:
        """(4, 4) bind transform from the mesh to skeleton space, row vectors, before skinning."""
        if not self.skin.HasJointInfluences():
            return np.eye(4)
        return np.array(self.skin.GetGeomBindTransform(self.time), dtype=np.float64)

    def _skin_normals(self, normals: Floats, carriers: NDArray[np.int64]) -> Floats | None:
        """(K, 3) normals skinned in skeleton space; None where the influences do not allow it."""
        joints = self._joint_matrices()
        influences = self.skin.GetNumInfluencesPerComponent()
        count = len(UsdGeom.PointBased(self.skin.GetPrim()).GetPointsAttr().Get(self.time))
        found = self.skin.ComputeVaryingJointInfluences(count, self.time)
        if joints is None or not found or len(found[0]) != count * influences:
            return None
        if np.linalg.det(self._bind) == 0.0:
            return None
        rows = [np.array(part).reshape(count, influences)[carriers].reshape(-1) for part in found]
        posed = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals, dtype=np.float32))
        done = UsdSkel.SkinNormals(
            self.skin.GetSkinningMethod(),
            Gf.Matrix3d(*np.linalg.inv(self._bind).T.reshape(-1).tolist()),
            Vt.Matrix3dArray.FromNumpy(np.ascontiguousarray(joints)),
            Vt.IntArray.FromNumpy(rows[0].astype(np.int32)),
            Vt.FloatArray.FromNumpy(rows[1].astype(np.float32)),
            influences,
            posed,
            False,
        )
        return np.array(posed, dtype=np.float64).reshape(-1, 3) if done else None

    def _joint_matrices(self) -> Floats | None:
        """(J, 3, 3) inverse transposes of the skinning transforms, in the mesh's joint order."""
        joints = self.skeleton.ComputeSkinningTransforms(self.time)
        linear = np.array(joints, dtype=np.float64).reshape(-1, 4, 4)[:, :3, :3]
        order = self.skin.GetJointOrder()
        if order:
            rows = {name: row for row, name in enumerate(self.skeleton.GetJointOrder())}
            still = np.concatenate([linear, np.eye(3)[None]])
            linear = still[[rows.get(name, len(linear)) for name in order]]
        if len(linear) == 0 or not np.all(np.abs(np.linalg.det(linear)) > 0.0):
            return None
        return np.linalg.inv(linear).transpose(0, 2, 1).astype(np.float64)

    def _blend(self, posed: Vt.Vec3fArray) -> None:
        """Add the weighted blend shape offsets to `posed`, in place."""
        animation = self.skeleton.GetAnimQuery()
        weights = animation.ComputeBlendShapeWeights(self.time) if animation else None
        mapper = self.skin.GetBlendShapeMapper()
        if not weights or mapper is None:
            return
        shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(self.skin.GetPrim()))
        parts = shapes.ComputeSubShapeWeights(mapper.Remap(weights))
        deformed = parts is not None and shapes.ComputeDeformedPoints(
            *parts,
            shapes.ComputeBlendShapePointIndices(),
            shapes.ComputeSubShapePointOffsets(),
            posed,
        )
        if not deformed:
            self._remark("its blend shapes do not match its points and are ignored")

    def _remark(self, text: str) -> None:
        self.notes.add(text, str(self.skin.GetPrim().GetPath()))


class Skins:
    """The skel bindings of a stage at one time, by prim path.

    bind : meshes are in the bind pose, at the location of the skeleton at that time.
    """

    def __init__(
        self,
        time: Usd.TimeCode,
        xforms: UsdGeom.XformCache,
        notes: Notes,
        *,
        bind: bool = False,
    ) -> None:
        self._time = time
        self._bind = bind
        self._xforms = xforms
        self._notes = notes
        self._cache = UsdSkel.Cache()
        self._roots: set[Sdf.Path] = set()
        self._aligned: dict[Sdf.Path, NDArray[np.float64]] = {}
        self._bound: dict[Sdf.Path, tuple[Usd.Prim, UsdSkel.SkinningQuery]] = {}

    def placement(self, prim: Usd.Prim) -> SkinnedPlacement | None:
        """The placement of a skinned mesh; None for a mesh that is not bound to a skeleton.

        Raises SkippedPrim where the skeleton's transform is singular.
        """
        self._populate(prim)
        bound = self._bound.get(prim.GetPath())
        if bound is None:
            if has_influences(prim):
                self._notes.add(
                    f"has joint influences but no skeleton poses it ({unposed(prim)}): it is read"
                    " without a pose",
                    str(prim.GetPath()),
                )
            return None
        skeleton, skin = bound
        world = Placement.of(self._xforms.GetLocalToWorldTransform(skeleton))
        if self._bind:
            world = Placement(self.alignment(skeleton) @ world.matrix)
        query = self._cache.GetSkelQuery(UsdSkel.Skeleton(skeleton))
        animation = query.GetAnimQuery()
        moves = animation and animation.JointTransformsMightBeTimeVarying()
        if moves and not self._bind:
            self._notes.add(POSED, str(prim.GetPath()))
        if not query.HasBindPose():
            self._notes.add(
                "its skeleton has no bind pose: the identity is assumed", str(prim.GetPath())
            )
        if not self._fits(prim, query, skin):
            self._notes.add(
                "its joint influences do not match its points: it is read without a pose",
                str(prim.GetPath()),
            )
            return None
        return SkinnedPlacement(world.matrix, query, skin, self._time, self._notes, self._bind)

    def alignment(self, skeleton: Usd.Prim) -> NDArray[np.float64]:
        """(4, 4) rigid transform, row vectors, that aligns the bind pose in skeleton space.

        It moves the topmost joint with skinned points to its transform at this time, since bind
        poses may be translated or rotated as a whole.
        """
        where = skeleton.GetPath()
        if where not in self._aligned:
            self._aligned[where] = self._align(skeleton)
        return self._aligned[where]

    def _align(self, skeleton: Usd.Prim) -> NDArray[np.float64]:
        query = self.query(skeleton)
        names = [str(name) for name in query.GetJointOrder()]
        used: set[str] = set()
        for above, skin in self._bound.values():
            if above.GetPath() == skeleton.GetPath() and skin.HasJointInfluences():
                index = np.array(skin.GetJointIndicesPrimvar().ComputeFlattened(self._time) or [0])
                weight = np.array(skin.GetJointWeightsPrimvar().ComputeFlattened(self._time) or [0])
                order = [str(name) for name in skin.GetJointOrder() or names]
                some = index[weight > 0.0] if index.shape == weight.shape else index[:0]
                used |= {order[k] for k in some if 0 <= k < len(order)}
        top = next((row for row, name in enumerate(names) if name in used), None)
        bind, posed = (
            query.GetJointWorldBindTransforms(),
            query.ComputeJointSkelTransforms(self._time),
        )
        if top is None or not bind or not posed or top >= min(len(bind), len(posed)):
            return np.eye(4)
        start, end = np.array(bind[top]), np.array(posed[top])
        if not (np.isfinite(start).all() and np.isfinite(end).all()):
            return np.eye(4)
        out = np.eye(4)
        turn = signed_polar(start[None, :3, :3])[0].T @ signed_polar(end[None, :3, :3])[0]
        out[:3, :3] = turn
        out[3, :3] = end[3, :3] - start[3, :3] @ turn
        return out

    @property
    def time(self) -> Usd.TimeCode:
        """The time of the poses."""
        return self._time

    def skeleton(self, prim: Usd.Prim) -> tuple[Usd.Prim, UsdSkel.SkinningQuery] | None:
        """The skeleton that a mesh is bound to, and its skinning query; None without one."""
        self._populate(prim)
        return self._bound.get(prim.GetPath())

    def query(self, skeleton: Usd.Prim) -> UsdSkel.SkeletonQuery:
        """The query of a skeleton's joints and animation."""
        return self._cache.GetSkelQuery(UsdSkel.Skeleton(skeleton))

    def _fits(
        self, prim: Usd.Prim, query: UsdSkel.SkeletonQuery, skin: UsdSkel.SkinningQuery
    ) -> bool:
        """Whether the joint influences are valid for the mesh's points."""
        points = UsdGeom.PointBased(prim).GetPointsAttr().Get(self._time)
        if not points or not skin.HasJointInfluences():
            return True
        joints = query.ComputeSkinningTransforms(self._time)
        return bool(skin.ComputeSkinnedPoints(joints, points, self._time))

    def lone(self, stage: Usd.Stage) -> Usd.Prim | None:
        """The only Skeleton of a stage, if it is under a SkelRoot, as UsdSkel requires; or None."""
        every = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        found = [prim for prim in every if prim.IsA(UsdSkel.Skeleton)]
        if len(found) != 1 or not UsdSkel.Root.Find(found[0]):
            return None
        self._populate(found[0])
        return found[0]

    def _populate(self, prim: Usd.Prim) -> None:
        """Resolve the bindings under the outermost SkelRoot above `prim`, once."""
        above, root = prim, None
        while above:
            root = UsdSkel.Root(above) if above.IsA(UsdSkel.Root) else root
            above = above.GetParent()
        if root is None or root.GetPath() in self._roots:
            return
        self._roots.add(root.GetPath())
        self._cache.Populate(root, PROXIES)
        for binding in self._cache.ComputeSkelBindings(root, PROXIES):
            for skin in binding.GetSkinningTargets():
                self._bound[skin.GetPrim().GetPath()] = (binding.GetSkeleton().GetPrim(), skin)


def has_influences(prim: Usd.Prim) -> bool:
    """Whether a mesh has joint influences, bound to a skeleton or not."""
    return bool(UsdSkel.BindingAPI(prim).GetJointIndicesPrimvar().HasAuthoredValue())


def unposed(prim: Usd.Prim) -> str:
    """The reason why a mesh with joint influences is not bound to a skeleton."""
    above, between = prim.GetParent(), None
    while above and not above.IsA(UsdSkel.Root):
        # UsdSkel traversal stops at prims that are not imageable; report the outermost
        between = between if above.IsA(UsdGeom.Imageable) or above.IsPseudoRoot() else above
        above = above.GetParent()
    if not above:
        return "it is not below a SkelRoot"
    if between is not None:
        kind = between.GetTypeName()
        what = f"is a {kind}" if kind else "has no type"
        return (
            f"<{between.GetPath()}> {what}, and USD ignores bindings below what it cannot draw:"
            " make it an Xform or a Scope"
        )
    if not UsdSkel.BindingAPI(prim).GetInheritedSkeleton():
        return "none is bound"
    return "USD does not accept its binding"
