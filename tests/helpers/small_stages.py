"""Small stages, and a bake of them without a solver: an analytic motion instead."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.asset import Asset, StageFacts, Surface
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import BakedFrame, BakeInfo, GaussianPose, Health, MeshPose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.core.units import StageUnits
from gf_usd.layers.cache import CacheSummary, CacheWriter
from gf_usd.layers.root import RootSummary, write_root
from gf_usd.layers.variants import BakedVariant
from gf_usd.system.atomic_files import publish

ALL = Choices()
CUBE_POINTS = "[(0,0,0),(1,0,0),(1,1,0),(0,1,0),(0,0,1),(1,0,1),(1,1,1),(0,1,1)]"
CUBE_INDICES = [0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7]
CUBE = f"""
    point3f[] points = {CUBE_POINTS}
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = {CUBE_INDICES}
    float3[] extent = [(0, 0, 0), (1, 1, 1)]
"""
# Float32 keeps 6e-8 of the largest number that a point passes through; local coordinates under
# scales of 50 and offsets of meters are within a hundred units here.
EPS = 2e-6
RUBBER = Material(
    name="rubber",
    law="neoHookean",
    density=1100.0,
    youngs_modulus=2e5,
    poissons_ratio=0.45,
    damping_time=0.002,
    friction=0.7,
    restitution=0.6,
)


def write(path: Path, body: str, head: str = 'upAxis = "Y"\n metersPerUnit = 1') -> Path:
    """A usda file."""
    path.write_text(f"#usda 1.0\n(\n {head}\n)\n{body}", encoding="utf-8")
    return path


def asset_of(path: Path, *, skinned: tuple[str, ...] = ()) -> Asset:
    """Every Mesh, and every Cube as eight points, at the first time code."""
    stage = Usd.Stage.Open(str(path))
    layer = stage.GetRootLayer()
    start = layer.startTimeCode if layer.HasStartTimeCode() else None
    xforms = UsdGeom.XformCache(Usd.TimeCode.EarliestTime() if start is None else start)
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    surfaces = []
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.GetTypeName() not in ("Mesh", "Cube"):
            continue
        matrix = np.array(xforms.GetLocalToWorldTransform(prim))
        surfaces.append(_surface(prim, matrix, unit, str(prim.GetPath()) in skinned))
    roots = [p for p in stage.GetPseudoRoot().GetAllChildren() if p.IsDefined()]
    facts = StageFacts(
        path=path,
        units=StageUnits(
            meters_per_unit=unit,
            kilograms_per_unit=stage.GetMetadata("kilogramsPerUnit") or 1.0,
        ),
        up_axis=UsdGeom.GetStageUpAxis(stage),
        time_codes_per_second=layer.timeCodesPerSecond if layer.HasTimeCodesPerSecond() else None,
        start_time_code=start,
        end_time_code=layer.endTimeCode if layer.HasEndTimeCode() else None,
        root_prims=tuple(str(p.GetPath()) for p in roots if not p.IsAbstract()),
        default_prim=str(stage.GetDefaultPrim().GetPath()) if stage.GetDefaultPrim() else None,
    )
    return Asset(facts=facts, surfaces=tuple(surfaces))


def _surface(prim: Usd.Prim, matrix: np.ndarray, unit: float, skinned: bool) -> Surface:
    normals, interpolation = None, ""
    if prim.GetTypeName() == "Cube":
        half = prim.GetAttribute("size").Get() / 2.0
        cube = [
            (0, 0, 0),
            (1, 0, 0),
            (1, 1, 0),
            (0, 1, 0),
            (0, 0, 1),
            (1, 0, 1),
            (1, 1, 1),
            (0, 1, 1),
        ]
        local = (2.0 * np.array(cube) - 1.0) * half
        counts, indices = np.full(6, 4), np.array(CUBE_INDICES)
    else:
        mesh = UsdGeom.Mesh(prim)
        time = Usd.TimeCode.EarliestTime()
        local = np.array(mesh.GetPointsAttr().Get(time), np.float64)
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get(time))
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get(time))
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
        if primvar.HasAuthoredValue():
            normals, interpolation = primvar.ComputeFlattened(), primvar.GetInterpolation()
        elif mesh.GetNormalsAttr().HasAuthoredValue():
            normals, interpolation = mesh.GetNormalsAttr().Get(), mesh.GetNormalsInterpolation()
    world = local @ matrix[:3, :3] + matrix[3, :3]
    if normals is not None:
        normals = np.array(normals, np.float64) @ np.linalg.inv(matrix[:3, :3]).T
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    starts = np.cumsum(counts) - counts
    corners = np.concatenate(
        [[(s, s + k, s + k + 1) for k in range(1, n - 1)] for s, n in zip(starts, counts)]
    )
    return Surface(
        path=str(prim.GetPath()),
        type_name=str(prim.GetTypeName()),
        points=world * unit,
        face_counts=counts,
        face_indices=indices,
        triangles=indices[corners],
        triangle_corners=corners,
        normals=normals,
        normals_interpolation=interpolation,
        skinned=skinned,
    )


def particles_of(asset: Asset, count: int = 40, *, bodies: int = 1) -> Particles:
    """Points in the box of the asset's surfaces; body k has material k."""
    rng = np.random.default_rng(7)
    cloud = np.concatenate([s.points for s in asset.surfaces])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    quaternions = rng.normal(size=(count, 4))
    spacing = float((np.prod(high - low) / count) ** (1 / 3))
    return Particles(
        X=low + rng.random((count, 3)) * (high - low),
        V0=np.full(count, spacing**3) * rng.uniform(0.5, 1.5, count),
        material=np.arange(count) % bodies,
        orientation=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        scale=spacing * rng.uniform(0.1, 1.0, (count, 3)),
        color=rng.random((count, 3)),
        opacity=rng.uniform(0.3, 1.0, count),
        surface=np.zeros(count, int),
        spacing=spacing,
        volume=float(np.prod(high - low)),
        lattice=spacing,
        corner=low,
    )


def info_of(asset: Asset, *, frames: int = 5, look: str = "rubber", bodies: int = 1) -> BakeInfo:
    """24 frames per second, the source's time codes."""
    facts = asset.facts
    rate = facts.time_codes_per_second or 24.0
    settings = Settings(
        frames=frames,
        fps=rate,
        time_codes_per_second=rate,
        start=1.0 if facts.start_time_code is None else facts.start_time_code,
        gravity=(0.0, -9.81, 0.0),
        up=(0.0, 1.0, 0.0),
    )
    return BakeInfo(
        look=look,
        materials=(RUBBER,) * bodies,
        settings=settings,
        command="gf-usd bake duck.usda",
        version="0.1.0",
        input_hash=hashlib.sha256(facts.path.read_bytes()).hexdigest(),
    )


def motion(x: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A squash, a turn and a fall x(t) = A(t) x + b(t): positions, velocities and A."""
    turn, rate = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]]), 2.0
    c, s = np.cos(rate * t), np.sin(rate * t)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    squash = np.diag([1 + 0.3 * np.sin(5 * t), 1 - 0.4 * np.sin(5 * t), 1 + 0.2 * np.sin(5 * t)])
    speed = np.diag([1.5, -2.0, 1.0]) * np.cos(5 * t)
    a = rotation @ squash
    a_dot = rate * turn @ rotation @ squash + rotation @ speed
    b, b_dot = np.array([0.1 * t, -4.9 * t * t, 0.2]), np.array([0.1, -9.8 * t, 0.0])
    return x @ a.T + b, x @ a_dot.T + b_dot, a


def frames_of(
    asset: Asset, particles: Particles, info: BakeInfo, choices: Choices = ALL
) -> Iterator[BakedFrame]:
    """The motion's frames."""
    settings = info.settings
    step = settings.time_codes_per_second / settings.fps
    for index in range(settings.frames):
        t = index / settings.fps
        meshes = {}
        for surface in asset.surfaces if choices.mesh else ():
            x, v, a = motion(surface.points, t)
            normals = surface.normals
            if normals is not None:
                normals = normals @ np.linalg.inv(a)
                normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
            meshes[surface.path] = MeshPose(points=x, velocities=v, normals=normals)
        x, v, _ = motion(particles.X, t)
        yield BakedFrame(
            index=index,
            time_code=settings.start + index * step,
            meshes=meshes,
            gaussians=GaussianPose(
                positions=x,
                velocities=v,
                orientations=particles.orientation,
                scales=particles.scale * (1 + 0.1 * index),
            ),
            health=Health(),
        )


def write_cache(
    path: Path,
    asset: Asset,
    *,
    save_every: int = 2,
    publishing: bool = True,
    choices: Choices = ALL,
    **options: object,
) -> tuple[CacheSummary, Particles, BakeInfo]:
    """The cache of the motion, published."""
    info = info_of(asset, **options)
    particles = particles_of(asset, bodies=len(info.materials))
    with CacheWriter(
        path, asset, particles, info, save_every=save_every, choices=choices
    ) as writer:
        for frame in frames_of(asset, particles, info, choices):
            writer.write(frame)
    if publishing:
        publish(path)
    return writer.close(), particles, info


def finish(cache: Path, asset: Asset, particles: Particles, info: BakeInfo) -> RootSummary:
    """Cache and root layer of the motion with these settings, published."""
    with CacheWriter(cache, asset, particles, info) as writer:
        for frame in frames_of(asset, particles, info):
            writer.write(frame)
    publish(cache)
    look = BakedVariant(name=info.look, cache=cache, info=info)
    return write_root(cache.with_name("root.usda"), asset, [look])


def bake(
    asset: Asset,
    folder: Path,
    *,
    looks: tuple[str, ...] = ("rubber",),
    choices: Choices = ALL,
    **options: object,
) -> tuple[RootSummary, Particles, BakeInfo]:
    """Caches and root layer of the motion, all published in ``folder``."""
    stem = asset.facts.path.stem
    baked = []
    for look in looks:
        cache = folder / f"{stem}.{look}.cache.usdc"
        _, particles, info = write_cache(cache, asset, look=look, choices=choices, **options)
        baked.append(BakedVariant(name=look, cache=cache, info=info, health={"minJ": 0.5}))
    path = folder / f"{stem}.{'_'.join(looks)}.usda"
    root = write_root(path, asset, baked, choices=choices)
    return root, particles, info


def world(stage: Usd.Stage, path: str, name: str, time_code: float) -> np.ndarray:
    """Values of a point attribute in the world, stage units."""
    prim = stage.GetPrimAtPath(path)
    matrix = np.array(UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim))
    values = np.array(prim.GetAttribute(name).Get(time_code), np.float64)
    return values @ matrix[:3, :3] + matrix[3, :3]


def open_with(path: Path, variant: str, load: object = Usd.Stage.LoadAll) -> Usd.Stage:
    """The stage with one variant selected on every root prim that has the set."""
    stage = Usd.Stage.Open(str(path), load)
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in stage.GetPseudoRoot().GetAllChildren():
        if prim.GetVariantSets().HasVariantSet("gaussianFlesh"):
            assert prim.GetVariantSet("gaussianFlesh").SetVariantSelection(variant)
    return stage
