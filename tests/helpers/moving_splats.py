"""A moving stage with captured Gaussians over a mesh, without a solver; and a reader of glTF.

The reader shares no code with gf-usd: it follows glTF 2.0 and KHR_gaussian_splatting.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from captures import ball
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt
from scipy.spatial.transform import Rotation

FRAMES = 5
Types = Sdf.ValueTypeNames
KHR = "KHR_gaussian_splatting"


def gradient(t: float) -> np.ndarray:
    """(3, 3) F of the whole stage at t in 0..1: a turn by a right angle, and a squash along z."""
    turn = Rotation.from_rotvec([0.0, np.pi / 2 * t, 0.0]).as_matrix()
    return turn @ np.diag([1 + 0.2 * t, 1 + 0.2 * t, 1 - 0.3 * t])


def bent(points: np.ndarray, t: float) -> np.ndarray:
    """(n, 3) where points of the ball are at t."""
    wave = 0.04 * t * np.sin(4.0 * points[:, [1, 2, 0]])
    return (points + wave) @ gradient(t).T + (0.0, 0.0, -2.0 * t)


def moving_splats(
    path: Path,
    *,
    count: int = 200,
    degree: int = 0,
    mesh: bool = True,
    particles: bool = False,
    still: bool = False,
) -> Path:
    """Z up, centimeters, under a prim that is moved and turned.

    still : the captured Gaussians stay at rest.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    root = UsdGeom.Xform.Define(stage, "/Ball")
    root.AddTranslateOp().Set(Gf.Vec3d(3.0, -2.0, 5.0))
    root.AddRotateZOp().Set(30.0)
    stage.SetDefaultPrim(root.GetPrim())
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(FRAMES)
    rest = ball(count, degree=degree)
    if mesh:
        skin = UsdGeom.Mesh.Define(stage, "/Ball/Skin")
        from scipy.spatial import ConvexHull

        corners = ball(80, radius=0.5).positions.astype(float)
        faces = ConvexHull(corners).simplices
        out = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]],
                       corners[faces[:, 2]] - corners[faces[:, 0]])  # fmt: skip
        turned = (out * corners[faces].mean(axis=1)).sum(axis=1) < 0
        faces[turned] = faces[turned][:, ::-1]
        skin.CreateFaceVertexCountsAttr([3] * len(faces))
        skin.CreateFaceVertexIndicesAttr(faces.reshape(-1).tolist())
        skin.CreateSubdivisionSchemeAttr("none")
        for code in range(1, FRAMES + 1):
            moved = bent(corners, (code - 1) / (FRAMES - 1)).astype(np.float32)
            skin.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(moved), code)
    _splats(stage, "/Ball/Splats", rest, still)
    if particles:
        inside = ball(60, radius=0.3)
        prim = _splats(stage, "/Ball/GaussianFlesh/Gaussians", inside)
        prim.CreateAttribute("gaussianFlesh:restPositions", Types.Point3fArray, False).Set(
            Vt.Vec3fArray.FromNumpy(inside.positions.astype(np.float32))
        )
        UsdGeom.Imageable(prim).MakeInvisible()
    stage.Save()
    return path


def _splats(stage: Usd.Stage, path: str, rest, still: bool = False) -> Usd.Prim:
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, path).GetPrim()
    names = (("positions", Types.Point3fArray), ("orientations", Types.QuatfArray),
             ("scales", Types.Float3Array), ("extent", Types.Float3Array))  # fmt: skip
    moving = {name: prim.CreateAttribute(name, kind, False) for name, kind in names}
    light = "radiance:sphericalHarmonics"
    prim.CreateAttribute(f"{light}Degree", Types.Int, False).Set(rest.degree)
    prim.CreateAttribute(f"{light}Coefficients", Types.Float3Array, False).Set(
        Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rest.harmonics.reshape(-1, 3), np.float32))
    )
    opacities = np.linspace(0.2, 1.0, len(rest)).astype(np.float32)
    prim.CreateAttribute("opacities", Types.FloatArray, False).Set(
        Vt.FloatArray.FromNumpy(opacities)
    )
    axes = Rotation.from_quat(rest.orientations[:, [1, 2, 3, 0]]).as_matrix()
    axes = axes * rest.scales[:, None, :].astype(float)
    for code in [Usd.TimeCode.Default()] if still else range(1, FRAMES + 1):
        t = 0.0 if still else (code - 1) / (FRAMES - 1)
        at = bent(rest.positions.astype(float), t)
        U, s, _ = np.linalg.svd(gradient(t) @ axes)
        U = U * np.sign(np.linalg.det(U))[:, None, None]
        turns = Rotation.from_matrix(U).as_quat().astype(np.float32)
        box = np.array([at.min(0) - 1.0, at.max(0) + 1.0])
        moving["positions"].Set(Vt.Vec3fArray.FromNumpy(at.astype(np.float32)), code)
        moving["orientations"].Set(Vt.QuatfArray.FromNumpy(turns), code)
        moving["scales"].Set(Vt.Vec3fArray.FromNumpy(s.astype(np.float32)), code)
        moving["extent"].Set(Vt.Vec3fArray.FromNumpy(box.astype(np.float32)), code)
    return prim


def world_splats(path: Path, name: str, code: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) [m] and covariances (n, 3, 3) [m^2] in the world."""
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath(name)
    matrix = np.array(UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(code))

    def value(attribute: str) -> np.ndarray:
        found = prim.GetAttribute(attribute).Get(code)
        found = prim.GetAttribute(f"{attribute}h").Get(code) if found is None else found
        return np.array(found, float)

    at = value("positions") @ matrix[:3, :3] + matrix[3, :3]
    C = Rotation.from_quat(value("orientations")).as_matrix() * value("scales")[:, None, :]
    A = matrix[:3, :3].T @ C
    return 0.01 * at, 1e-4 * (A @ A.transpose(0, 2, 1))


def upright(at: np.ndarray, covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From Z up to Y up."""
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return at @ turn.T, turn @ covariances @ turn.T


@dataclass
class Glb:
    """Nodes of a binary glTF file at the keys of its animation."""

    tree: dict
    blob: bytes

    @classmethod
    def read(cls, path: Path) -> Glb:
        data = path.read_bytes()
        size = struct.unpack_from("<I", data, 12)[0]
        return cls(json.loads(data[20 : 20 + size]), data[28 + size :])

    def array(self, number: int) -> np.ndarray:
        row = self.tree["accessors"][number]
        view = self.tree["bufferViews"][row["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[row["type"]]
        kind = {5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
        start = view["byteOffset"] + row.get("byteOffset", 0)
        flat = np.frombuffer(self.blob, kind[row["componentType"]], row["count"] * width, start)
        full = {5121: 255.0, 5122: 32767.0}[row["componentType"]] if "normalized" in row else 1.0
        return flat.reshape(-1, width) / full

    def splats(self) -> list[tuple[int, dict]]:
        """(node, primitive) of each set of Gaussians."""
        found = []
        for number, node in enumerate(self.tree["nodes"]):
            for row in self.tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
                if KHR in row.get("extensions", {}):
                    found.append((number, row))
        return found

    def worlds(self, frame: int | None) -> list[np.ndarray]:
        """(4, 4) of every node for column vectors; None: without the animation."""
        nodes = [dict(node) for node in self.tree["nodes"]]
        for animation in self.tree["animations"] if frame is not None else []:
            for channel in animation["channels"]:
                sampler = animation["samplers"][channel["sampler"]]
                rows = self.array(sampler["output"])
                rows = rows.reshape(len(self.array(sampler["input"])), -1)
                nodes[channel["target"]["node"]][channel["target"]["path"]] = rows[frame]
        self.nodes = nodes
        where = [np.eye(4)] * len(nodes)

        def walk(number: int, above: np.ndarray) -> None:
            own = np.eye(4)
            turn = nodes[number].get("rotation", (0, 0, 0, 1))
            own[:3, :3] = Rotation.from_quat(turn).as_matrix()
            own[:3, 3] = nodes[number].get("translation", (0, 0, 0))
            where[number] = above @ own
            for child in nodes[number].get("children", []):
                walk(child, where[number])

        for root in self.tree["scenes"][0]["nodes"]:
            walk(root, np.eye(4))
        return where

    def posed(
        self, node: int, primitive: dict, frame: int | None, *, skins: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) and covariances (n, 3, 3) of Gaussians.

        skins : False: as a loader without skins and morph targets places them.
        """
        where = self.worlds(frame)
        named, row = primitive["attributes"], self.nodes[node]
        at = self.array(named["POSITION"]).astype(float)
        for k, target in enumerate(primitive.get("targets", []) if skins else []):
            at = at + row["weights"][k] * self.array(target["POSITION"])
        M = np.repeat(where[node][None], len(at), axis=0)
        if "skin" in row and skins:
            skin = self.tree["skins"][row["skin"]]
            inverse = self.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            joints = np.array([where[j] @ b for j, b in zip(skin["joints"], inverse)])
            used = self.array(named["JOINTS_0"]).astype(int)
            M = np.einsum("vk,vkij->vij", self.array(named["WEIGHTS_0"]), joints[used])
        turns = Rotation.from_quat(self.array(named[f"{KHR}:ROTATION"])).as_matrix()
        A = M[:, :3, :3] @ (turns * self.array(named[f"{KHR}:SCALE"])[:, None, :])
        at = np.einsum("vij,vj->vi", M[:, :3, :3], at) + M[:, :3, 3]
        return at, A @ A.transpose(0, 2, 1)
