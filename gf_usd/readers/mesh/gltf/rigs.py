"""Conversion of glTF skins to UsdSkel: joint hierarchy, bind pose and animation.

A glTF skin has an inverse bind matrix M_j from the mesh to each joint; a vertex is at
x(t) = sum_j w_j x M_j L_j(t), with L_j the joint's transform to the scene (row vectors).  In
UsdSkel it is at sum_j w_j x G B_j^-1 J_j(t) W, with the bind transforms B_j and J_j in skeleton
space, G (geomBindTransform) of the mesh and W of the skeleton.  They are equal for

    L_j(t) = J_j(t) W        W of the common ancestors of all joints that are not animated
    G = M_0 L_0(0) W^-1      0 the topmost joint, whose bind transform is that of the first frame
    B_j = M_j^-1 G

so that joints have the translation, rotation and scale of their nodes.  Nodes between W and the
joints become joints without weights.  Skins on one joint hierarchy become one skeleton if the M_j
of their common joints differ by one matrix, which becomes a part of G.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, counted
from gf_usd.readers.mesh.data import REPAIR, FileMesh, FileSkeleton, FileSkin
from gf_usd.readers.mesh.gltf.animation import WEIGHTS, frame_times, read_animation
from gf_usd.readers.mesh.gltf.container import Gltf
from gf_usd.readers.mesh.gltf.morphs import target_count
from gf_usd.readers.mesh.gltf.nodes import Nodes, Parts, local_matrix
from gf_usd.readers.mesh.gltf.primitives import Primitive
from gf_usd.readers.mesh.gltf.skins import Skins
from gf_usd.readers.notes import Notes

ALIKE = 1e-4  # relative tolerance of equal matrices in single precision
FLAT = 1e-12  # determinant of a matrix without an inverse
HALF = 1e-6  # relative rounding error of a scale in half precision that is noted


@dataclass(kw_only=True)
class _Tree:
    """Skins that become one skeleton."""

    inverse: dict[int, Floats] = field(default_factory=dict)  # M_j by node
    order: list[int] = field(default_factory=list)  # nodes of the skeleton, parents first
    bind: Floats = field(default_factory=lambda: np.zeros((0, 4, 4)))  # B_j
    matrix: Floats = field(default_factory=lambda: np.eye(4))  # G


class Rigs:
    """The skeletons of a file, and the bindings of its meshes.

    used : indices of the skins of meshes; fps : of the frames, None: of the keyframes.
    """

    def __init__(
        self,
        gltf: Gltf,
        nodes: Nodes,
        skins: Skins,
        used: list[int],
        fps: float | None,
        notes: Notes,
    ) -> None:
        self._gltf, self._nodes, self._skins, self._notes = gltf, nodes, skins, notes
        self._trees: list[_Tree] = []
        self._of: dict[int, tuple[int, Floats]] = {}  # tree and matrix of each skin
        self._animation = read_animation(gltf, notes, self._morphs(used))
        self.fps, self._times = frame_times(self._animation, fps, str(gltf.path))
        for number in used:
            self._add(number)
        morphing = {self._posing(node) for node in self._animation.morphing}
        self.skeletons = tuple(
            self._skeleton(k, tree, morphs=k in morphing) for k, tree in enumerate(self._trees)
        )

    def weights(self, node: int) -> NDArray[np.float64] | None:
        """(F, K) the weights of the morph targets of a node's mesh at the frames; None: they are
        not animated.
        """
        channel = self._animation.channels.get((node, WEIGHTS))
        return None if channel is None else channel.at(self._times, 0.01 / self.fps)

    def _morphs(self, used: list[int]) -> dict[int, int]:
        """The number of morph targets of the meshes that skeletons pose, by node."""
        joints = {joint for number in used for joint in self._skins.joints(number)}
        out = {}
        for node, row in enumerate(self._gltf.rows("nodes")):
            if "mesh" in row and ("skin" in row or joints & set(self._nodes.chain(node))):
                out[node] = target_count(self._gltf.row("meshes", row["mesh"]))
        return {node: count for node, count in out.items() if count}

    def skinned(
        self, number: int, name: str, mesh: FileMesh, primitives: list[Primitive]
    ) -> FileMesh:
        """A mesh bound to the skeleton of a skin."""
        found = self._skins.influences(number, primitives)
        if found is None:
            raise InputError(
                f"{self._gltf.path}: mesh '{name}' has a skin but no weights",
                "bind it again in the program that made it",
            )
        at, matrix = self._of[number]
        tree = self._trees[at]
        rows = {node: row for row, node in enumerate(tree.order)}
        index, weights = found
        weights = weights.copy()
        if free := int((weights.sum(1) == 0.0).sum()):
            self._notes.add(
                f"{counted(free, 'point')} without weights: moved with the first joint", name
            )
            weights[weights.sum(1) == 0.0, 0] = 1.0
        joints = np.array([rows[node] for node in self._skins.joints(number)])
        skin = FileSkin(
            skeleton=at, joints=joints[index], weights=weights, matrix=matrix @ tree.matrix
        )
        return replace(mesh, skin=skin)

    def bound_rigidly(self, node: int, mesh: FileMesh) -> FileMesh | None:
        """A mesh bound rigidly to the joint that its node descends from; None where none does."""
        chain = self._nodes.chain(node)
        found = self._joint_above(chain)
        if found is None:
            return None
        above, at = found
        tree = self._trees[at]
        if self._animation.nodes & set(chain[:above]):
            self._notes.add(
                "moves relative to the joint it is attached to: that motion is ignored", mesh.name
            )
        matrix = np.eye(4)
        for between in chain[:above]:
            matrix = matrix @ self._nodes.local(between)
        row = tree.order.index(chain[above])
        ones = np.ones((len(mesh.points), 1))
        skin = FileSkin(
            skeleton=at, joints=np.full((len(ones), 1), row), weights=ones,
            matrix=matrix @ tree.bind[row],
        )  # fmt: skip
        return replace(mesh, skin=skin)

    def _joint_above(self, chain: list[int]) -> tuple[int, int] | None:
        """Of nodes, each the child of the next: the number of the first that is a joint, and its
        tree; None where none is.
        """
        for above, joint in enumerate(chain):
            for at, tree in enumerate(self._trees):
                if joint in tree.inverse:
                    return above, at
        return None

    def _posing(self, node: int) -> int | None:
        """The tree that poses the mesh of a node; None where none does."""
        row = self._nodes.row(node)
        if "skin" in row:
            return self._of[row["skin"]][0]
        found = self._joint_above(self._nodes.chain(node))
        return None if found is None else found[1]

    def _add(self, number: int) -> None:
        """Find the skeleton of a skin, or add one."""
        joints, inverse = self._skins.joints(number), self._skins.inverse_bind(number)
        where = f"{self._gltf.path}: skin {number}"
        if not joints or inverse is None:
            raise InputError(
                f"{where} has {len(joints)} joints but no inverse bind matrices",
                "export it with its bind pose, which is the rest shape",
            )
        finite = np.where(np.isfinite(inverse).all((1, 2), keepdims=True), inverse, 0.0)
        flat = np.abs(np.linalg.det(finite)) <= FLAT
        if flat.any():
            raise InputError(
                f"{where}: the inverse bind matrices of {int(flat.sum())} of {len(joints)} "
                f"joints cannot be inverted; the first is "
                f"{self._nodes.name(joints[int(flat.argmax())])}",
                REPAIR,
            )
        mine = dict(zip(joints, inverse))
        for at, tree in enumerate(self._trees):
            matrix = self._difference(tree, mine)
            if matrix is not None:
                back = np.linalg.inv(matrix)
                tree.inverse = {k: back @ M for k, M in mine.items()} | tree.inverse
                self._of[number] = at, matrix
                return
        self._trees.append(_Tree(inverse=mine))
        self._of[number] = len(self._trees) - 1, np.eye(4)

    def _difference(self, tree: _Tree, mine: dict[int, Floats]) -> Floats | None:
        """(4, 4) from the bind space of a skin to that of a tree; None: they do not match."""
        both = sorted(mine.keys() & tree.inverse.keys())
        common = [mine[node] @ np.linalg.inv(tree.inverse[node]) for node in both]
        if common:
            first = common[0]
            alike = all(np.abs(D - first).max() <= ALIKE * np.abs(first).max() for D in common)
            return first if alike else None
        below = {above for node in mine for above in self._nodes.chain(node)}
        above = {above for node in tree.inverse for above in self._nodes.chain(node)}
        return np.eye(4) if below & tree.inverse.keys() or above & mine.keys() else None

    def _skeleton(self, number: int, tree: _Tree, *, morphs: bool) -> FileSkeleton:
        """The skeleton of a tree; morphs : it poses meshes whose morph targets are animated."""
        wanted = {above for node in tree.inverse for above in self._nodes.chain(node)}
        below = {
            node: [c for c in self._nodes.row(node).get("children", []) if c in wanted]
            for node in wanted
        }
        tops = sorted(node for node in wanted if self._nodes.parents.get(node) is None)
        world = np.eye(4)
        fixed = tree.inverse.keys() | self._animation.nodes
        while len(tops) == 1 and tops[0] not in fixed:
            world = self._nodes.local(tops[0]) @ world
            tops = below[tops[0]]
        parents: list[int] = []
        waiting = [(node, -1) for node in reversed(tops)]
        while waiting:
            node, parent = waiting.pop()
            row = len(tree.order)
            tree.order.append(node)
            parents.append(parent)
            waiting += [(child, row) for child in reversed(below[node])]
        parts = [self._nodes.parts(node) for node in tree.order]
        # blend shapes are animated together with the joints
        moving = morphs or bool(self._animation.nodes & set(tree.order))
        motion = [self._motion(node, part) for node, part in zip(tree.order, parts)]
        T, Q, S = (np.stack(column, 1) for column in zip(*motion))
        local = [
            np.asarray(local_matrix({"translation": t, "rotation": q, "scale": s}))
            for t, q, s in zip(T[0], Q[0], S[0])
        ]
        self._bind(tree, parents, local)
        if np.abs(np.float16(S).astype(float) - S).max() > HALF * np.abs(S).max():
            self._notes.add(
                "the scales of its joints are rounded to half precision, the type "
                "that UsdSkel stores"
            )
        rest = [self._nodes.local(node) for node in tree.order]
        top = self._nodes.name(tree.order[0])
        return FileSkeleton(
            name=f"{top} skeleton" if number else "Skeleton",
            joints=tuple(self._nodes.name(node) for node in tree.order),
            parents=np.array(parents),
            bind=tree.bind,
            rest=np.stack(rest),
            matrix=world,
            translations=T if moving else None,
            rotations=Q[..., [3, 0, 1, 2]] if moving else None,
            scales=S if moving else None,
        )

    def _motion(self, node: int, part: Parts) -> tuple[Floats, Floats, Floats]:
        """Translations (F, 3), rotations (F, 4) (x, y, z, w) and scales (F, 3) of a node."""
        out = []
        for path, still in asdict(part).items():
            channel = self._animation.channels.get((node, path))
            if channel is None:
                out.append(np.repeat(np.asarray(still)[None], len(self._times), axis=0))
            else:
                out.append(channel.at(self._times, 0.01 / self.fps))
        length = np.linalg.norm(out[1], axis=1, keepdims=True)
        turn = np.where(length > 0.0, out[1] / np.where(length > 0.0, length, 1.0), (0, 0, 0, 1))
        # consecutive quaternions of equal sign, since not all programs take the shorter arc
        same = np.concatenate([[1.0], np.where((turn[1:] * turn[:-1]).sum(1) < 0.0, -1.0, 1.0)])
        return out[0], turn * np.cumprod(same)[:, None], out[2]

    def _bind(self, tree: _Tree, parents: list[int], local: list[NDArray[np.float64]]) -> None:
        """Set G, and B_j of all joints; joints without M_j are bound as in the first frame."""
        posed: list[NDArray[np.float64]] = []
        for row, parent in enumerate(parents):
            posed.append(local[row] @ posed[parent] if parent >= 0 else local[row])
        first = next(row for row, node in enumerate(tree.order) if node in tree.inverse)
        tree.matrix = tree.inverse[tree.order[first]] @ posed[first]
        known = {
            row: np.linalg.inv(tree.inverse[node]) @ tree.matrix
            for row, node in enumerate(tree.order)
            if node in tree.inverse
        }
        for row in reversed(range(len(parents))):  # from children to parents without M_j
            above = parents[row]
            if row in known and above >= 0 and abs(np.linalg.det(local[row])) > FLAT:
                known.setdefault(above, np.linalg.inv(local[row]) @ known[row])
        tree.bind = np.stack([known.get(row, M) for row, M in enumerate(posed)])
