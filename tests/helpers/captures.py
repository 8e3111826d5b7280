"""Small captures: discs on a surface, as 3D Gaussian splatting leaves them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gf_usd.core.asset import Splats
from gf_usd.readers.splats.write import ply_bytes

COLOR = (0.8, 0.3, 0.1)  # encoded, of every disc
Y_0 = 0.28209479177387814


def facing(normals: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions (w, x, y, z) whose axis 2 is the normal."""
    out = np.empty((len(normals), 4))
    for row, n in enumerate(normals):
        across = np.cross(n, np.eye(3)[np.abs(n).argmin()])
        across /= np.linalg.norm(across)
        turn = np.stack([across, np.cross(n, across), n], axis=1)
        out[row] = Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]]
    return out


def sphere_directions(count: int) -> np.ndarray:
    """(count, 3) unit, evenly spread: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def ball(count: int = 800, radius: float = 0.5, degree: int = 0, seed: int = 0) -> Splats:
    """A hollow ball of opaque discs about the origin, with random coefficients above degree 0."""
    rng = np.random.default_rng(seed)
    n = sphere_directions(count)
    wide = radius * np.sqrt(4.0 * np.pi / count)  # the spacing of the discs
    harmonics = 0.2 * rng.normal(size=(count, (degree + 1) ** 2, 3))
    harmonics[:, 0] = (np.array(COLOR) - 0.5) / Y_0
    return Splats(
        positions=(radius * n).astype(np.float32),
        orientations=facing(n),
        scales=np.tile(np.float32([0.7, 0.6, 0.1]) * np.float32(wide), (count, 1)),
        opacities=np.ones(count, np.float32),
        harmonics=harmonics.astype(np.float32),
        path="/ball",
    )


def together(*sets: Splats) -> Splats:
    """Several captures of one degree as one."""
    arrays = {
        name: np.concatenate([getattr(s, name) for s in sets])
        for name in ("positions", "orientations", "scales", "opacities", "harmonics")
    }
    return Splats(**arrays, path=sets[0].path)


def write_ply(path: Path, splats: Splats) -> Path:
    """The capture as a 3DGS PLY file."""
    path.write_bytes(ply_bytes(splats))
    return path


def define(stage, path: str, splats: Splats, *, half: bool = False):
    """A ParticleField3DGaussianSplat prim with the capture, in float or in half precision."""
    from pxr import Sdf, UsdVol, Vt

    types, mark = Sdf.ValueTypeNames, "h" if half else ""
    width = np.float16 if half else np.float32
    three, four = (Vt.Vec3hArray, Vt.QuathArray) if half else (Vt.Vec3fArray, Vt.QuatfArray)
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, path).GetPrim()

    def author(name: str, kind: str, array, values) -> None:
        made = array.FromNumpy(np.ascontiguousarray(values, width))
        prim.CreateAttribute(f"{name}{mark}", getattr(types, kind), False).Set(made)

    author("positions", "Point3hArray" if half else "Point3fArray", three, splats.positions)
    vector = "Half3Array" if half else "Float3Array"
    author("scales", vector, three, splats.scales)
    turns = splats.orientations[:, [1, 2, 3, 0]]
    author("orientations", "QuathArray" if half else "QuatfArray", four, turns)
    one = Vt.HalfArray if half else Vt.FloatArray
    author("opacities", "HalfArray" if half else "FloatArray", one, splats.opacities)
    flat = splats.harmonics.reshape(-1, 3)
    author("radiance:sphericalHarmonicsCoefficients", vector, three, flat)
    prim.CreateAttribute("radiance:sphericalHarmonicsDegree", types.Int, False).Set(splats.degree)
    return prim
