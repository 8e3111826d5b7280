"""Flowing and solid bodies in contact: a sand castle, a snowball, and paste on a brush.

Each stage states the materials of its bodies, so that one command bakes it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from tools.samples.bowl import bowl
from tools.samples.implicit import Field, Floats, ellipsoid, join, lozenge, meet, unit_normals
from tools.samples.quads import Quads
from tools.samples.sphere import sphere_quads
from tools.samples.surface_nets import surface_nets
from tools.samples.usd import Look, collide, define_material, define_plain

Ints = NDArray[np.int64]

FPS, FRAMES = 24, 48
STEP = 0.4  # [cm] of the lattice that the castle's surface is drawn on
FILLET = 0.3  # [cm] radius of the corners that a bucket leaves
WALLS, TOWERS, KEEP = 7.0, 2.4, 3.6  # [cm] half width between towers, radii
WALL_TOP, TOWER_TOP, KEEP_TOP = 4.4, 7.0, 10.0  # [cm]
MERLON = 1.2  # [cm] height and width of the teeth on top
DUCK_AT, DUCK_SPEED = (1.0, 5.0, 22.0), (0.0, 20.0, 360.0)  # [cm], [cm/s] in its own frame
BALL, BALL_AT, BALL_SPEED = 1.1, (4.2, 4.6, 0.0), (0.0, -8.0, 0.0)  # [m], [m/s] of the snowball
BRUSH, PASTE_STEP = 1.5, 0.06  # [cm] height of its bristles' tips, lattice of the paste
TUFT, TUFTS_ACROSS, TUFTS_ALONG = 0.4, (-0.5, 0.0, 0.5), np.linspace(-1.5, 1.5, 7)  # [cm]
GRAINS, DABS = 6000, 2000  # particles: minutes instead of an hour
SAND = Look(color=(0.62, 0.45, 0.24), roughness=0.95, clearcoat=0.0)
SNOW = Look(color=(0.86, 0.90, 0.95), roughness=0.8, clearcoat=0.0)
PASTE = Look(color=(0.25, 0.72, 0.66), roughness=0.35, clearcoat=0.4)
CLAY, HANDLE, BRISTLES = (0.20, 0.33, 0.52), (0.80, 0.10, 0.12), (0.88, 0.88, 0.84)


def box(p: Floats, center: tuple[float, ...], half: tuple[float, ...]) -> Floats:
    """Distance to a box outside of it, minus the distance to its nearest side inside."""
    q = np.abs(p - np.array(center)) - np.array(half)
    return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(-1), 0.0)


def drum(p: Floats, center: tuple[float, ...], radius: float, top: float) -> Floats:
    """The same to an upright cylinder from y = 0 to `top`."""
    away = np.hypot(p[..., 0] - center[0], p[..., 2] - center[1]) - radius
    up = np.abs(p[..., 1] - 0.5 * top) - 0.5 * top
    q = np.stack([away, up], -1)
    return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(-1), 0.0)


def castle(p: Floats) -> Floats:
    """A square of walls with a tower at each corner, a keep, teeth on all of them, and a gate."""
    f = box(p, (0.0, 0.5 * WALL_TOP, 0.0), (WALLS, 0.5 * WALL_TOP, WALLS))
    for x in (-WALLS, WALLS):
        for z in (-WALLS, WALLS):
            f = join(f, teeth(p, (x, z), TOWERS, TOWER_TOP, 4), FILLET)
    f = join(f, teeth(p, (0.0, 0.0), KEEP, KEEP_TOP, 6), FILLET)
    gate = box(p, (0.0, 1.2, WALLS), (1.3, 1.4, 1.6))
    return np.maximum(f, -gate)


def teeth(p: Floats, center: tuple[float, float], radius: float, top: float, count: int) -> Floats:
    """A tower whose rim is cut by `count` gaps, even in x about the tower's own middle."""
    f = drum(p, center, radius, top)
    x, z = p[..., 0] - center[0], p[..., 2] - center[1]
    if center[0] < 0.0:
        x = -x  # the mesh is even in x
    angle = np.arctan2(x, z)
    turn = 2.0 * np.pi / count
    off = np.abs((angle / turn - 0.5) - np.round(angle / turn - 0.5)) * turn
    wide = np.hypot(x, z) * np.sin(np.minimum(off, 0.5 * np.pi)) - 0.5 * MERLON
    hollow = np.hypot(x, z) - (radius - MERLON)
    gap = np.maximum(np.minimum(wide, hollow), (top - MERLON) - p[..., 1])
    return np.maximum(f, -gap)


def castle_mesh() -> Quads:
    """The castle [cm], its underside on y = 0."""
    high, wide = int(KEEP_TOP / STEP) + 3, int((WALLS + TOWERS) / STEP) + 3
    return surface_nets(castle, wide, (-3, -wide), (high, wide), STEP)


def paste(p: Floats) -> Floats:
    """A ribbon of paste [cm] as it lies: four flat lumps in a row, and a tip."""
    f = lozenge(p, (0.0, 0.0, -0.95), (0.52, 0.34, 0.55))
    for z in (-0.3, 0.35, 0.95):
        f = join(f, lozenge(p, (0.0, 0.0, z), (0.52, 0.36, 0.52)), 0.12)
    f = join(f, ellipsoid(p, (0.0, 0.30, 1.1), (0.18, 0.34, 0.24)), 0.15)
    return meet(f, -0.24 - p[..., 1], 0.08)  # its flat underside


def paste_mesh() -> Quads:
    """The ribbon [cm] about the origin."""
    wide, high, long = (int(reach / PASTE_STEP) for reach in (0.6, 0.9, 1.7))
    return surface_nets(paste, wide, (-high, -long), (high, long), PASTE_STEP)


def tufts() -> tuple[Floats, Ints, Ints, Floats]:
    """points (V, 3) [cm], counts, indices, normals of the bristles: a block for each tuft."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T
    half = np.array([0.5 * TUFT, 0.5 * (BRUSH - 0.6), 0.5 * TUFT])
    rows = [(x, z) for x in TUFTS_ACROSS for z in TUFTS_ALONG]
    faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
                      [1, 5, 7, 3]])  # fmt: skip
    points = [corners * half + np.array([x, 0.6 + half[1], z]) for x, z in rows]
    indices = np.concatenate([faces + 8 * k for k in range(len(rows))])
    outward = corners[faces].mean(1)  # of a face, at each of its corners
    normals = np.tile(np.repeat(outward, 4, 0), (len(rows), 1))
    return np.concatenate(points), np.full(len(indices), 4), indices.ravel(), normals


def write_sandcastle(path: Path, duck: str) -> None:
    """The castle of wet sand and the rubber duck that flies into it; duck: its layer."""
    stage = _stage(
        path, "SandCastle", "A rubber duck runs into a castle of wet sand. Centimeters, Y up.", 0.01
    )
    _body(stage, "/SandCastle/Castle", castle_mesh(), castle, SAND, "wet-sand", GRAINS)
    xform = UsdGeom.Xform.Define(stage, "/SandCastle/Duck")
    prim = xform.GetPrim()
    prim.GetReferences().AddReference(duck)
    xform.AddTranslateOp().Set(Gf.Vec3d(*DUCK_AT))
    xform.AddRotateYOp().Set(180.0)
    UsdPhysics.RigidBodyAPI.Apply(prim).CreateVelocityAttr(Gf.Vec3f(*DUCK_SPEED))
    _soft(prim, "rubber")
    _ground(stage, "/SandCastle")
    stage.GetRootLayer().Save()


def write_snowball(path: Path) -> None:
    """A ball of powder snow above the rim of the bowl of the ten ducks, in meters."""
    stage = _stage(path, "Snowball", "A snowball bursts on the rim of a bowl. Meters, Y up.", 1.0)
    quads = sphere_quads()
    counts = np.full(len(quads.faces), 4)
    mesh = define_plain(
        stage, "/Snowball/Ball", BALL * quads.points, counts, quads.faces.ravel(), quads.points,
        SNOW.color,
    )  # fmt: skip
    mesh.AddTranslateOp().Set(Gf.Vec3d(*BALL_AT))
    _drawn(stage, mesh, SNOW)
    _soft(mesh.GetPrim(), "powder-snow")
    UsdPhysics.RigidBodyAPI.Apply(mesh.GetPrim()).CreateVelocityAttr(Gf.Vec3f(*BALL_SPEED))
    points, counts, indices, normals = bowl()
    dish = define_plain(stage, "/Snowball/Bowl", points, counts, indices, normals, CLAY)
    dish.AddTranslateOp().Set(Gf.Vec3d(0.0, round(-float(points[:, 1].min()), 4), 0.0))
    collide(dish.GetPrim())
    _ground(stage, "/Snowball")
    stage.GetRootLayer().Save()


def write_toothpaste(path: Path) -> None:
    """A ribbon of toothpaste just above a brush that lies on the ground."""
    stage = _stage(path, "Toothpaste", "Toothpaste falls on a brush. Centimeters, Y up.", 0.01)
    mesh = _body(stage, "/Toothpaste/Paste", paste_mesh(), paste, PASTE, "toothpaste", DABS)
    mesh.AddTranslateOp().Set(Gf.Vec3d(0.0, BRUSH + 2.2, 0.0))
    bristles = define_plain(stage, "/Toothpaste/Bristles", *tufts(), BRISTLES)
    collide(bristles.GetPrim())
    for name, at, size in (
        ("Head", (0.0, 0.3, 0.0), (1.7, 0.6, 3.6)),
        ("Handle", (0.0, 0.3, -6.8), (1.0, 0.6, 10.0)),
    ):
        cube = UsdGeom.Cube.Define(stage, f"/Toothpaste/{name}")
        cube.CreateSizeAttr(1.0)
        cube.CreateExtentAttr([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)])
        cube.AddTranslateOp().Set(Gf.Vec3d(*at))
        cube.AddScaleOp().Set(Gf.Vec3f(*size))
        cube.CreateDisplayColorAttr([Gf.Vec3f(*HANDLE)])
        collide(cube.GetPrim())
    _ground(stage, "/Toothpaste")
    stage.GetRootLayer().Save()


def _stage(path: Path, name: str, doc: str, meters: float) -> Usd.Stage:
    path.unlink(missing_ok=True)
    stage = Usd.Stage.CreateNew(str(path))
    layer = stage.GetRootLayer()
    layer.documentation = doc
    layer.customLayerData = {"license": "Apache-2.0", "madeBy": "gf-usd tools/make_samples.py"}
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, f"/{name}").GetPrim())
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, meters)
    stage.SetTimeCodesPerSecond(FPS)
    stage.SetFramesPerSecond(FPS)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(FRAMES)
    return stage


def _body(
    stage: Usd.Stage, path: str, quads: Quads, field: Field, look: Look, preset: str,
    particles: int,
) -> UsdGeom.Mesh:  # fmt: skip
    """A soft body of a preset, with the normals of the field that it was drawn from."""
    counts, normals = np.full(len(quads.faces), 4), unit_normals(field, quads.points)
    mesh = define_plain(stage, path, quads.points, counts, quads.faces.ravel(), normals, look.color)
    _drawn(stage, mesh, look)
    _soft(mesh.GetPrim(), preset, particles)
    return mesh


def _drawn(stage: Usd.Stage, mesh: UsdGeom.Mesh, look: Look) -> None:
    material = define_material(stage, Sdf.Path(f"{mesh.GetPath()}Shading"), look)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def _soft(prim: Usd.Prim, preset: str, particles: int | None = None) -> None:
    prim.AddAppliedSchema("GaussianFleshBakeAPI")
    types, uniform = Sdf.ValueTypeNames, Sdf.VariabilityUniform
    prim.CreateAttribute("gaussianFlesh:enabled", types.Bool, False, uniform).Set(True)
    prim.CreateAttribute("gaussianFlesh:material", types.Token, False, uniform).Set(preset)
    if particles is not None:
        prim.CreateAttribute("gaussianFlesh:particles", types.Int, False, uniform).Set(particles)


def _ground(stage: Usd.Stage, root: str) -> None:
    ground = UsdGeom.Plane.Define(stage, f"{root}/Ground")
    ground.CreateAxisAttr(UsdGeom.Tokens.y)
    ground.CreateDisplayColorAttr([Gf.Vec3f(0.34, 0.36, 0.38)])
    collide(ground.GetPrim())
