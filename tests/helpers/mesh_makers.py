"""Small mesh files, made in the test: a cube as OBJ, and glTF files out of arrays."""

from __future__ import annotations

import json
import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gf_usd.core.asset import Asset
from gf_usd.readers import convert, read_asset

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
# counter-clockwise seen from outside
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])

KINDS = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121, "int8": 5120}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def cube_obj(first: int = 1) -> str:
    """v and f lines of a unit cube with six quads; its points count from `first`."""
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    return points + "".join(f"f {' '.join(str(i + first) for i in quad)}\n" for quad in QUADS)


def png(color: tuple[int, int, int] = (200, 30, 10), size: tuple[int, int] = (4, 2)) -> bytes:
    """An image of one color, its lower left texel white."""
    picture = Image.new("RGB", size, color)
    picture.putpixel((0, size[1] - 1), (255, 255, 255))
    out = BytesIO()
    picture.save(out, "PNG")
    return out.getvalue()


def written(path: Path, folder: Path, **options: Any) -> Asset:
    """A mesh file converted, written into a folder, and read back from what was written."""
    source = convert(path, **options)
    assert source is not None
    folder.mkdir(exist_ok=True)
    return read_asset(source.write(folder / f"{path.stem}.source.usdc"))


class GltfMaker:
    """A glTF file in the making: arrays become accessors in one buffer."""

    def __init__(self) -> None:
        self.data = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            **{key: [] for key in ("bufferViews", "accessors", "meshes", "nodes")},
        }

    def view(self, data: bytes) -> int:
        """The number of a new buffer view."""
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        )
        self.data += data + b"\0" * (-len(data) % 4)
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, **more: Any) -> int:
        """The number of a new accessor with rows of these values."""
        width = 1 if values.ndim == 1 else int(np.prod(values.shape[1:]))
        self.tree["accessors"].append(
            {
                "bufferView": self.view(np.ascontiguousarray(values).tobytes()),
                "componentType": KINDS[str(values.dtype)],
                "count": len(values),
                "type": SHAPES[width],
                **more,
            }
        )
        return len(self.tree["accessors"]) - 1

    def primitive(self, points: Any, triangles: Any, **attributes: np.ndarray) -> dict[str, Any]:
        """A primitive without material."""
        return {
            "attributes": {
                "POSITION": self.accessor(np.asarray(points, np.float32)),
                **{name: self.accessor(values) for name, values in attributes.items()},
            },
            "indices": self.accessor(np.asarray(triangles, np.uint32).reshape(-1)),
        }

    def mesh(self, *primitives: dict[str, Any], **node: Any) -> int:
        """The number of a new node with a mesh."""
        self.tree["meshes"].append({"primitives": list(primitives)})
        self.tree["nodes"].append({"mesh": len(self.tree["meshes"]) - 1, **node})
        return len(self.tree["nodes"]) - 1

    def glb(self, path: Path) -> Path:
        """Write it as one binary file."""
        tree = {**self.tree, "buffers": [{"byteLength": len(self.data)}]}
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.data), 0x004E4942) + self.data
        path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        return path

    def gltf(self, path: Path) -> Path:
        """Write it as text with its buffer next to it."""
        path.with_suffix(".bin").write_bytes(self.data)
        buffer = {"uri": f"{path.stem}.bin", "byteLength": len(self.data)}
        path.write_text(json.dumps({**self.tree, "buffers": [buffer]}))
        return path
