"""A bake as a binary glTF 2.0 file: skins, morph targets, Gaussians, and one animation.

Nodes hold joints and meshes; the topmost one turns the world's up axis to +Y.  Rotations are
normalized 16-bit integers and weights normalized bytes, which the standard allows.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core import __version__
from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import BakeError
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.core.scene import Recording
from gf_usd.delivery.gltf.splats import NAME, POINTS, attributes, extension
from gf_usd.delivery.gltf.surface import Primitive, encoded, primitives_of, sampler_of
from gf_usd.delivery.rig import Rig
from gf_usd.delivery.splats.clouds import Cloud
from gf_usd.delivery.transforms import Hierarchy, hierarchy
from gf_usd.system.atomic_files import partial_path

MAGIC, JSON, BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
TYPES = {np.uint8: 5121, np.int16: 5122, np.uint16: 5123, np.uint32: 5125, np.float32: 5126}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES, INDICES = 34962, 34963  # targets of buffer views
SHORT = 32767


def write_glb(
    target: Path, recording: Recording, rigs: Sequence[Rig], clouds: Sequence[Cloud] = ()
) -> tuple[str, ...]:
    """Write `target` under its partial name; returns notes as text.

    clouds : the sets of Gaussians that bodies have parts of.

    Raises BakeError where a file cannot be written.
    """
    writer = _Writer(recording, clouds)
    for rig in rigs:
        writer.add(rig)
    partial = partial_path(target)
    try:
        partial.write_bytes(writer.file())
    except OSError as error:
        raise BakeError(
            f"{partial} could not be written: {error.strerror}",
            f"check that {partial.absolute().parent} is writable and has space left",
        ) from error
    return tuple(writer.notes)


def up_rotation(up: Sequence[float]) -> Floats:
    """(4,) the quaternion (x, y, z, w) that turns a unit vector to +Y."""
    x, y, z = up
    if y < -1.0 + 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0])
    q = np.array([-z, 0.0, x, 1.0 + y])  # (up x Y, 1 + up . Y)
    return q / np.linalg.norm(q)


class _Writer:
    def __init__(self, recording: Recording, clouds: Sequence[Cloud]) -> None:
        self._recording, self._clouds = recording, clouds
        self._data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._nodes: list[dict[str, Any]] = [{"name": recording.name, "children": []}]
        turn = up_rotation(recording.up)
        self._upright = np.eye(3)  # what node 0 does
        if abs(turn[3]) < 1.0 - 1e-12:
            self._nodes[0]["rotation"] = turn.tolist()
            self._upright = matrix_from_quaternion(turn[[3, 0, 1, 2]][None])[0]
        self._roots = [0]
        self._meshes: list[dict[str, Any]] = []
        self._skins: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._textures: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []
        self._curves: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        times = np.array([recording.seconds(code) for code in recording.time_codes])
        self._times = self._accessor(times.astype(np.float32)[:, None], bounds=True)
        self.notes: dict[str, None] = {}

    def add(self, rig: Rig) -> None:
        """A body with its joints or shapes; a static one has none."""
        if not (rig.body.moves or rig.body.shown or rig.body.splats):
            for number in rig.body.meshes:
                mesh = self._mesh(rig, number)
                self._nodes[0]["children"].append(len(self._nodes))
                self._nodes.append({"mesh": mesh, **self._named(mesh)})
            return
        joints = hierarchy(rig)
        root = len(self._nodes)
        names = ["Root", *(f"Joint{j}" for j in range(len(joints) - 1))]
        for name, place in zip(names, joints.bind_local):
            self._nodes.append({"name": name, "translation": _floats(place)})
        self._nodes[0]["children"].append(root)
        below = list(range(root + 1, root + len(joints)))
        if rig.body.moves:
            for j in range(len(joints)):
                self._animate(root + j, joints, j)
        if rig.body.shown:
            self._hide(root, rig)
        meshes = [self._mesh(rig, i) for i in rig.body.meshes]
        if rig.skinning is not None:
            skin = self._skin(joints, root, below, np.eye(3)) if meshes else -1
            for mesh in meshes:
                self._skinned(mesh, skin)
            for number, single in enumerate(rig.single):
                self._on_nodes(rig, number, single, joints, root, below)
            bound = () if rig.single else range(len(rig.body.splats))
            splats = [self._splats(rig, n, self._upright) for n in bound]
            if splats and not (meshes and np.array_equal(self._upright, np.eye(3))):
                skin = self._skin(joints, root, below, self._upright)
            for mesh in splats:
                self._skinned(mesh, skin)
        else:
            splats = [self._splats(rig, n, np.eye(3)) for n in range(len(rig.body.splats))]
            for mesh in (*meshes, *splats):
                below.append(len(self._nodes))
                place = {"translation": _floats(-joints.bind[0])}
                self._nodes.append({"mesh": mesh, **place, **self._named(mesh)})
                if rig.blend_shapes:
                    assert rig.keys is not None
                    keys = rig.keys.astype(np.float32).reshape(-1, 1)
                    self._channel(below[-1], "weights", self._accessor(keys))
        if below:
            self._nodes[root]["children"] = below

    def _skin(self, joints: Hierarchy, root: int, below: Sequence[int], turn: Floats) -> int:
        """turn : (3, 3) how the points of the meshes are turned against the world."""
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        inverse[:, :3, :3] = turn  # by columns
        inverse[:, 3, :3] = -joints.bind
        matrices = self._accessor(inverse.reshape(-1, 16).astype(np.float32))
        self._skins.append(
            {"inverseBindMatrices": matrices, "skeleton": root, "joints": [root, *below]}
        )
        return len(self._skins) - 1

    def _skinned(self, mesh: int, skin: int) -> None:
        self._roots.append(len(self._nodes))
        self._nodes.append({"mesh": mesh, "skin": skin, **self._named(mesh)})

    def _named(self, mesh: int) -> dict[str, Any]:
        return {"name": self._meshes[mesh]["name"]}

    def _animate(self, node: int, joints: Hierarchy, j: int) -> None:
        turns = np.rint(joints.rotations[:, j] * SHORT).astype(np.int16)
        self._channel(node, "rotation", self._accessor(turns, normalized=True))
        moves = joints.translations[:, j].astype(np.float32)
        self._channel(node, "translation", self._accessor(moves))

    def _hide(self, root: int, rig: Rig) -> None:
        """A scale of 0 where the body is hidden, by which glTF 2.0 (3.5.3) animates visibility."""
        scale = np.repeat(np.array(rig.body.shown, np.float32)[:, None], 3, axis=1)
        self._channel(root, "scale", self._accessor(scale), interpolation="STEP")
        for mesh in rig.body.meshes:
            name = self._recording.meshes[mesh].name
            self.notes[f"{name}: a scale of 0 hides it in the frames in which it is invisible"] = (
                None
            )

    def _channel(self, node: int, path: str, output: int, **how: str) -> None:
        self._channels.append(
            {"sampler": len(self._curves), "target": {"node": node, "path": path}}
        )
        self._curves.append({"input": self._times, "output": output, **how})

    def _mesh(self, rig: Rig, number: int) -> int:
        shape = self._recording.meshes[number]
        images = [self._texture(texture) for texture in shape.textures]
        rows = [
            self._primitive(rig, number, primitive, images) for primitive in primitives_of(shape)
        ]
        made: dict[str, Any] = {"name": shape.name.rpartition("/")[2], "primitives": rows}
        return self._add_mesh(rig, made)

    def _add_mesh(self, rig: Rig, made: dict[str, Any]) -> int:
        if rig.blend_shapes:
            made["weights"] = [0.0] * rig.blend_shapes
        self._meshes.append(made)
        return len(self._meshes) - 1

    def _splats(self, rig: Rig, number: int, turn: Floats) -> int:
        """A mesh of the Gaussians `rig.body.splats[number]`, turned (3, 3) against the world.

        Under a skin they are upright by themselves, not by node 0: a loader without skins of points
        shows the rest pose.
        """
        cloud_number, rows = rig.body.splats[number]
        cloud = self._clouds[cloud_number]
        at = np.arange(len(rig.body.rest))[rig.body.splats_of(number)]
        points = (rig.body.rest[at] @ turn.T).astype(np.float32)
        named = {"POSITION": self._accessor(points, VERTICES, bounds=True)}
        for name, (values, normalized) in attributes(cloud, rows, turn).items():
            named[name] = self._accessor(values, VERTICES, normalized=normalized)
        named |= self._influences(rig, at)
        return self._add_mesh(rig, _splat_mesh(cloud, named, self._targets(rig, at)))

    def _on_nodes(
        self,
        rig: Rig,
        number: int,
        single: Ints,
        joints: Hierarchy,
        root: int,
        below: list[int],
    ) -> None:
        """The Gaussians `rig.body.splats[number]` as a mesh below each joint that some follow."""
        cloud_number, rows = rig.body.splats[number]
        cloud = self._clouds[cloud_number]
        order = np.argsort(single, kind="stable")
        used, starts = np.unique(single[order], return_index=True)
        ends = [*starts[1:].tolist(), len(order)]
        rest = rig.body.rest[rig.body.splats_of(number)]
        points = (rest - joints.bind[single])[order].astype(np.float32)
        whole = {"POSITION": (points, False), **attributes(cloud, rows[order], np.eye(3))}
        views = {name: self._view(_bytes(rows), VERTICES) for name, (rows, _) in whole.items()}
        for name, (values, _) in whole.items():  # required for views of several accessors
            self._views[views[name]]["byteStride"] = values.itemsize * values.shape[1]
        for joint, start, end in zip(used.tolist(), starts.tolist(), ends):
            named = {
                name: self._accessor(
                    values[start:end], normalized=normalized, bounds=name == "POSITION",
                    shared=(views[name], start * values.itemsize * values.shape[1]),
                )
                for name, (values, normalized) in whole.items()
            }  # fmt: skip
            mesh = self._add_mesh(rig, _splat_mesh(cloud, named, {}))
            children = below if joint == 0 else self._nodes[root + joint].setdefault("children", [])
            children.append(len(self._nodes))
            self._nodes.append({"mesh": mesh, **self._named(mesh)})

    def _primitive(
        self, rig: Rig, number: int, primitive: Primitive, images: Sequence[int]
    ) -> dict[str, Any]:
        at = np.arange(len(rig.body.rest))[rig.body.points_of(number)][primitive.points]
        points = rig.body.rest[at].astype(np.float32)
        named = {"POSITION": self._accessor(points, VERTICES, bounds=True)}
        for name, values in (("NORMAL", primitive.normals), ("TEXCOORD_0", primitive.uvs),
                             ("COLOR_0", primitive.colors)):  # fmt: skip
            if values is not None:
                named[name] = self._accessor(values.astype(np.float32), VERTICES)
        named |= self._influences(rig, at)
        kind = np.uint16 if len(points) < 65535 else np.uint32
        row: dict[str, Any] = {
            "attributes": named,
            "indices": self._accessor(primitive.triangles.reshape(-1, 1).astype(kind), INDICES),
            "material": self._material(primitive, images),
        }
        return row | self._targets(rig, at)

    def _influences(self, rig: Rig, at: Ints) -> dict[str, int]:
        """The attributes of a skin at points `at` of a body."""
        if rig.skinning is None:
            return {}
        skin = rig.skinning
        joints = np.where(skin.weights > 0, skin.joints + 1, 0)[at]
        kind = np.uint8 if len(skin) < 256 else np.uint16
        weights = skin.weights[at].astype(np.uint8)
        return {
            "JOINTS_0": self._accessor(joints.astype(kind), VERTICES),
            "WEIGHTS_0": self._accessor(weights, VERTICES, normalized=True),
        }

    def _targets(self, rig: Rig, at: Ints) -> dict[str, Any]:
        """The morph targets of points `at` of a body."""
        if not rig.blend_shapes:
            return {}
        assert rig.shapes is not None
        rows = [
            {"POSITION": self._accessor(s[at].astype(np.float32), VERTICES, bounds=True)}
            for s in rig.shapes
        ]
        return {"targets": rows}

    def _material(self, primitive: Primitive, images: Sequence[int]) -> int:
        surface: dict[str, Any] = {
            "metallicFactor": round(primitive.metallic, 6),
            "roughnessFactor": round(primitive.roughness, 6),
        }
        if primitive.texture >= 0:
            surface["baseColorTexture"] = {"index": images[primitive.texture]}
        else:
            surface["baseColorFactor"] = [*(min(1.0, round(c, 6)) for c in primitive.color), 1.0]
        row = {"pbrMetallicRoughness": surface, "doubleSided": True}
        if row not in self._materials:
            self._materials.append(row)
        return self._materials.index(row)

    def _texture(self, texture: Any) -> int:
        data, media = encoded(texture)
        self._images.append({"bufferView": self._view(data), "mimeType": media})
        sampler = sampler_of(texture)
        if sampler not in self._samplers:
            self._samplers.append(sampler)
        self._textures.append(
            {"source": len(self._images) - 1, "sampler": self._samplers.index(sampler)}
        )
        if "black" in (texture.wrap_s, texture.wrap_t):
            self.notes[
                "a texture that is black outside its border repeats its border instead, because "
                "glTF has no such wrap mode"
            ] = None
        return len(self._textures) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        self._data += b"\0" * (-len(self._data) % 4)
        row = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)}
        self._views.append(row if target is None else {**row, "target": target})
        self._data += data
        return len(self._views) - 1

    def _accessor(
        self,
        values: Any,
        target: int | None = None,
        *,
        normalized: bool = False,
        bounds: bool = False,
        shared: tuple[int, int] | None = None,
    ) -> int:
        """An array (n, width) of one of TYPES.

        shared : the buffer view that has it already, and from which byte on.
        """
        view, offset = shared or (self._view(_bytes(values), target), 0)
        row: dict[str, Any] = {
            "bufferView": view,
            **({"byteOffset": offset} if offset else {}),
            "componentType": TYPES[values.dtype.type],
            "count": len(values),
            "type": WIDTHS[values.shape[1]],
        }
        if normalized:
            row["normalized"] = True
        if bounds:
            row["min"], row["max"] = _floats(values.min(axis=0)), _floats(values.max(axis=0))
        self._accessors.append(row)
        return len(self._accessors) - 1

    def file(self) -> bytes:
        """The whole file."""
        tree: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"gf-usd {__version__}"},
            "scene": 0,
            "scenes": [{"nodes": self._roots}],
            "nodes": [
                {k: v for k, v in node.items() if k != "children" or v} for node in self._nodes
            ],
            "meshes": self._meshes,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._data) + (-len(self._data) % 4)}],
        }
        if self._channels:
            tree["animations"] = [
                {"name": "bake", "samplers": self._curves, "channels": self._channels}
            ]
        for key, rows in (
            ("materials", self._materials), ("skins", self._skins), ("textures", self._textures),
            ("images", self._images), ("samplers", self._samplers),
        ):  # fmt: skip
            if rows:
                tree[key] = rows
        if any("extensions" in row for mesh in self._meshes for row in mesh["primitives"]):
            tree["extensionsUsed"] = [NAME]
        text = json.dumps(tree, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(self._data) + b"\0" * (-len(self._data) % 4)
        chunks = (
            struct.pack("<II", len(text), JSON) + text + struct.pack("<II", len(data), BIN) + data
        )
        return struct.pack("<III", MAGIC, 2, 12 + len(chunks)) + chunks


def _bytes(values: Any) -> bytes:
    return np.ascontiguousarray(values).tobytes()


def _splat_mesh(cloud: Cloud, named: dict[str, int], targets: dict[str, Any]) -> dict[str, Any]:
    """A mesh of one primitive of Gaussians.  named : accessors of its attributes."""
    row = {"attributes": named, "mode": POINTS, "extensions": extension(cloud), **targets}
    return {"name": cloud.name.rpartition("/")[2], "primitives": [row]}


def _floats(values: Any) -> list[float]:
    # as single precision: bounds must be those of the stored numbers
    return [float(np.float32(value)) for value in values]
