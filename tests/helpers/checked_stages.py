"""A small stage with everything that the rules of the check examine, and changes that break it.

`good_stage` writes one with nothing wrong.  For every rule `BREAKS` has the ways to break it, each
as small as can be.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdVol, Vt

RATE = 30.0  # time codes per second; not the default 24, so that a mix-up shows
CODES = np.arange(1.0, 13.0)
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
GRID = np.array([[x, y, z] for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5) for z in (-0.5, 0, 0.5)])
Types = Sdf.ValueTypeNames


def motion(rest: np.ndarray, code: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities [1/s] of a falling, slowly swelling body: smooth by construction."""
    t = (code - CODES[0]) / RATE
    swell, rate = 1.0 + 0.1 * np.sin(3.0 * t), 0.3 * np.cos(3.0 * t)
    x = rest * swell + np.array([0.0, 8.0 - 4.905 * t * t, 0.0])
    v = rest * rate + np.array([0.0, -9.81 * t, 0.0])
    return x, v


def vec3(values: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def floats(values: np.ndarray | list[float]) -> Vt.FloatArray:
    return Vt.FloatArray.FromNumpy(np.asarray(values, np.float32))


def box(points: np.ndarray, margin: float = 0.0) -> Vt.Vec3fArray:
    return vec3(np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin]))


def good_stage(path: Path) -> Usd.Stage:
    """A mesh, its Gaussians and their twin of points, with materials, over 12 frames."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetFramesPerSecond(RATE)
    stage.SetStartTimeCode(CODES[0])
    stage.SetEndTimeCode(CODES[-1])
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/Body")
    stage.SetDefaultPrim(root.GetPrim())
    root.GetPrim().ApplyAPI("GaussianFleshBakeAPI")
    root.GetPrim().GetAttribute("gaussianFlesh:solver").Set("totalLagrangian")
    materials = [_material(stage, name) for name in ("Rubber", "Steel")]
    _mesh(stage)
    _gaussians(stage, materials)
    _points(stage, materials)
    return stage


def _material(stage: Usd.Stage, name: str) -> Sdf.Path:
    prim = UsdShade.Material.Define(stage, f"/Body/{name}").GetPrim()
    UsdPhysics.MaterialAPI.Apply(prim).CreateDensityAttr(1100.0)
    prim.ApplyAPI("GaussianFleshMaterialAPI")
    prim.GetAttribute("gaussianFlesh:law").Set("neoHookean")
    prim.GetAttribute("physics:youngsModulus").Set(1e6)
    prim.GetAttribute("physics:poissonsRatio").Set(0.4)
    return prim.GetPath()


def _mesh(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh.Define(stage, "/Body/Mesh")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(FACES)
    mesh.CreateNormalsAttr(vec3(CUBE / np.sqrt(3.0)))
    mesh.SetNormalsInterpolation("vertex")
    for code in CODES:
        x, v = motion(CUBE, code)
        mesh.CreatePointsAttr().Set(vec3(x), code)
        mesh.CreateVelocitiesAttr().Set(vec3(v), code)
        mesh.CreateExtentAttr().Set(box(x), code)


def _gaussians(stage: Usd.Stage, materials: list[Sdf.Path]) -> None:
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Body/Gaussians")
    prim, count = field.GetPrim(), len(GRID)
    _particles(prim, materials)
    identity = Vt.QuatfArray(count, Gf.Quatf(1.0))
    prim.GetAttribute("opacities").Set(floats(np.full(count, 0.5)))
    prim.GetAttribute("scales").Set(vec3(np.full((count, 3), 0.1)))
    prim.GetAttribute("orientations").Set(identity)
    prim.GetAttribute("radiance:sphericalHarmonicsDegree").Set(1)
    prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Set(vec3(np.ones((4 * count, 3))))
    for code in CODES:
        x, v = motion(GRID, code)
        prim.GetAttribute("positions").Set(vec3(x), code)
        prim.GetAttribute("gaussianFlesh:velocities").Set(vec3(v), code)
        field.CreateExtentAttr().Set(box(x, 0.3), code)


def _points(stage: Usd.Stage, materials: list[Sdf.Path]) -> None:
    points = UsdGeom.Points.Define(stage, "/Body/Points")
    _particles(points.GetPrim(), materials)
    points.CreateWidthsAttr(floats(np.full(len(GRID), 0.2)))
    points.SetWidthsInterpolation("vertex")
    for code in CODES:
        x, v = motion(GRID, code)
        points.CreatePointsAttr().Set(vec3(x), code)
        points.CreateVelocitiesAttr().Set(vec3(v), code)
        points.CreateExtentAttr().Set(box(x, 0.1), code)


def _particles(prim: Usd.Prim, materials: list[Sdf.Path]) -> None:
    count = len(GRID)
    prim.ApplyAPI("GaussianFleshParticlesAPI")
    ours = {
        "restPositions": vec3(GRID),
        "restOrientations": Vt.QuatfArray(count, Gf.Quatf(1.0)),
        "restScales": vec3(np.full((count, 3), 0.1)),
        "restVolumes": floats(np.full(count, 8.0 / count)),
        "masses": floats(np.full(count, 8800.0 / count)),
        "materialIndices": Vt.IntArray([i % 2 for i in range(count)]),
        "youngsModulus": floats(np.full(count, 1e6)),
        "poissonsRatio": floats(np.full(count, 0.4)),
        "densities": floats(np.full(count, 1100.0)),
    }
    for name, value in ours.items():
        prim.GetAttribute(f"gaussianFlesh:{name}").Set(value)
    prim.GetAttribute("gaussianFlesh:vonMisesStress").Set(floats(np.zeros(count)), CODES[0])
    prim.GetRelationship("gaussianFlesh:materials").SetTargets(materials)
    prim.GetRelationship("gaussianFlesh:sourceMeshes").SetTargets(["/Body/Mesh"])


Break = Callable[[Usd.Stage], None]
GAUSSIANS, POINTS, MESH, RUBBER = "/Body/Gaussians", "/Body/Points", "/Body/Mesh", "/Body/Rubber"
OURS = "gaussianFlesh:"
MIDDLE = float(CODES[5])


def put(path: str, name: str, value: object, code: float | None = None) -> Break:
    """A break that sets one attribute, at its default or at one sample."""

    def apply(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath(path).GetAttribute(name)
        assert attribute, f"{path} has no {name}"
        attribute.Set(value) if code is None else attribute.Set(value, code)

    return apply


def spoil(path: str, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Break:
    """A break that changes every sample of an array of vectors."""

    def apply(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath(path).GetAttribute(name)
        for code in attribute.GetTimeSamples():
            attribute.Set(vec3(change(np.array(attribute.Get(code), np.float64))), code)

    return apply


def with_nan(values: np.ndarray) -> np.ndarray:
    values = np.array(values, np.float64)
    values[1] = np.nan
    return values


def apply_api(path: str, type_name: str, api: str) -> Break:
    def apply(stage: Usd.Stage) -> None:
        prim = stage.DefinePrim(path, type_name)
        prim.SetMetadata("apiSchemas", Sdf.TokenListOp.Create(prependedItems=[api]))

    return apply


def target(path: str, name: str, *targets: str) -> Break:
    def apply(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath(path).GetRelationship(name).SetTargets(list(targets))

    return apply


def metadata(key: str, value: object) -> Break:
    return lambda stage: stage.GetRootLayer().pseudoRoot.SetInfo(key, value)


def normals_by(interpolation: str) -> Break:
    return lambda stage: UsdGeom.Mesh.Get(stage, MESH).SetNormalsInterpolation(interpolation)


def primvar_normals(stage: Usd.Stage) -> None:
    primvar = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(MESH)).CreatePrimvar(
        "normals", Sdf.ValueTypeNames.Normal3fArray, "faceVarying"
    )
    primvar.Set(vec3(CUBE))
    primvar.SetIndices(Vt.IntArray([0, 1, 2]))


def half(names: tuple[str, ...]) -> Break:
    """Cut every sample of these arrays to its first elements."""

    def apply(stage: Usd.Stage) -> None:
        for name in names:
            attribute = stage.GetPrimAtPath(MESH).GetAttribute(name)
            attribute.Set(attribute.Get(MIDDLE)[:7], MIDDLE)

    return apply


def lone_extent(stage: Usd.Stage) -> None:
    """An extent only for the first frame: the body falls out of it."""
    extent = stage.GetPrimAtPath(MESH).GetAttribute("extent")
    value = extent.Get(CODES[0])
    extent.Clear()
    extent.Set(value)


def no_extent(stage: Usd.Stage) -> None:
    stage.GetPrimAtPath(GAUSSIANS).RemoveProperty("extent")


def thin_extent(stage: Usd.Stage) -> None:
    """Around the points, but not around their balls of width 0.2."""
    extent = stage.GetPrimAtPath(POINTS).GetAttribute("extent")
    for code in CODES:
        extent.Set(box(motion(GRID, code)[0], 0.05), code)


def late_samples(stage: Usd.Stage) -> None:
    stage.SetEndTimeCode(CODES[-1] - 3)


def no_range(stage: Usd.Stage) -> None:
    layer = stage.GetRootLayer()
    layer.ClearStartTimeCode()
    layer.ClearEndTimeCode()


def bare_mesh(stage: Usd.Stage) -> None:
    mesh = UsdGeom.Mesh.Define(stage, "/Body/Mesh2")
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])


def grow(mesh: Usd.Prim) -> None:
    """One point more in one sample, inside the extent and moving along with the others."""
    for name in ("points", "velocities"):
        attribute = mesh.GetAttribute(name)
        values = np.array(attribute.Get(MIDDLE))
        attribute.Set(vec3(np.vstack([values, values.mean(axis=0)])), MIDDLE)


UNIT_Q = Gf.Quatf(1.0)
COUNT = len(GRID)
ONES = np.ones(COUNT)

# rule -> breaks, each with a piece of the message that carries the numbers
CASES: dict[str, list[tuple[str, Break, str]]] = {
    "time-codes-per-second": [
        ("zero", metadata("timeCodesPerSecond", 0.0), "timeCodesPerSecond = 0"),
        ("negative", metadata("timeCodesPerSecond", -24.0), "timeCodesPerSecond = -24"),
        ("nan", metadata("timeCodesPerSecond", float("nan")), "timeCodesPerSecond = nan"),
        ("inf", metadata("timeCodesPerSecond", float("inf")), "timeCodesPerSecond = inf"),
    ],
    "stage-units": [
        ("zero meters", metadata("metersPerUnit", 0.0), "metersPerUnit = 0"),
        ("negative mass", metadata("kilogramsPerUnit", -1.0), "kilogramsPerUnit = -1"),
    ],
    "time-range": [
        ("late", late_samples, "samples from 1 to 12, but the stage runs from 1 to 9"),
        ("backwards", lambda s: s.SetStartTimeCode(20.0), "startTimeCode 20 is after"),
        ("none", no_range, "the stage has no time range"),
    ],
    "particle-lengths": [
        ("masses", put(POINTS, OURS + "masses", floats(ONES[:5])), "5 elements but 27 points"),
        (
            "strain",
            put(GAUSSIANS, OURS + "deformationGradients", Vt.Matrix3dArray(2), MIDDLE),
            "deformationGradients has 2 elements but 27 points at time 1",
        ),
        (
            "longer",
            put(POINTS, OURS + "vonMisesStress", floats(np.ones(28)), MIDDLE),
            "28 elements but 27 points at time 6, and also in 6 more samples",
        ),
    ],
    "point-lengths": [
        ("scales", put(GAUSSIANS, "scales", vec3(np.ones((3, 3)))), "scales has 3 elements"),
        ("too many", put(GAUSSIANS, "opacities", floats(np.ones(30))), "30 elements but 27"),
        ("widths", put(POINTS, "widths", floats(np.full(2, 0.1))), "widths has 2 elements"),
        ("ids", lambda s: UsdGeom.Points.Get(s, POINTS).CreateIdsAttr([1, 2]), "ids has 2"),
        ("velocities", half(("velocities",)), "velocities has 7 elements but 8 points at time 6"),
    ],
    "sh-count": [
        ("degree", put(GAUSSIANS, "radiance:sphericalHarmonicsDegree", 2), "needs 243"),
        ("negative", put(GAUSSIANS, "radiance:sphericalHarmonicsDegree", -1), "Degree is -1"),
    ],
    "finite": [
        (name, put(path, name, value, code), "not finite; the first is [1]")
        for path, name, value, code in (
            (MESH, "points", vec3(with_nan(CUBE)), MIDDLE),
            (MESH, "velocities", vec3(with_nan(CUBE)), MIDDLE),
            (MESH, "normals", vec3(with_nan(CUBE)), None),
            (MESH, "extent", vec3(with_nan(CUBE[:2])), MIDDLE),
            (GAUSSIANS, "scales", vec3(with_nan(np.ones((COUNT, 3)))), None),
            (GAUSSIANS, "opacities", floats(with_nan(ONES)), None),
            (POINTS, OURS + "masses", floats(np.where(np.arange(COUNT) == 1, np.inf, 1)), None),
        )
    ]
    + [
        (
            "half orientations",
            lambda s: (
                s.GetPrimAtPath(GAUSSIANS)
                .GetAttribute("orientationsh")
                .Set(Vt.QuathArray([Gf.Quath(1.0), Gf.Quath(float("nan"))] + [Gf.Quath(1.0)] * 25))
            ),
            "orientationsh holds 1 of 27 elements",
        ),
        (
            "transform",
            lambda s: (
                UsdGeom.Xformable(s.GetPrimAtPath("/Body"))
                .AddTranslateOp()
                .Set(Gf.Vec3d(0, float("inf"), 0))
            ),
            "xformOp:translate holds 1 of 3 elements",
        ),
    ],
    "value-range": [
        (name, put(path, name, value), message)
        for path, name, value, message in (
            (GAUSSIANS, "opacities", floats(ONES * 1.5), "27 of 27 values outside [0, 1]"),
            (GAUSSIANS, "scales", vec3(np.zeros((COUNT, 3))), "outside (0, inf]; the first is 0"),
            (GAUSSIANS, OURS + "restScales", vec3(-(GRID**2) - 1), "outside (0, inf]"),
            (POINTS, "widths", floats(-ONES), "widths has 27 of 27 values outside [0, inf]"),
            (POINTS, OURS + "restVolumes", floats(0 * ONES), "outside (0, inf]; the first is 0"),
            (POINTS, OURS + "masses", floats(-ONES), "the first is -1 at [0]"),
            (POINTS, OURS + "youngsModulus", floats(0 * ONES), "outside (0, inf]"),
            (POINTS, OURS + "poissonsRatio", floats(0.5 * ONES), "outside (-1, 0.5)"),
            (POINTS, OURS + "densities", floats(-ONES), "outside (0, inf]"),
            (RUBBER, "physics:youngsModulus", -1.0, "a value outside [0, inf]: -1"),
            (RUBBER, "physics:poissonsRatio", -1.0, "a value outside (-1, 0.5): -1"),
            (RUBBER, "physics:restitution", 1.5, "a value outside [0, 1]: 1.5"),
            (RUBBER, "physics:density", -1.0, "a value outside [0, inf]: -1"),
            (RUBBER, OURS + "dampingTime", -0.1, "a value outside [0, inf]: -0.1"),
            ("/Body", OURS + "spacing", -0.1, "a value outside [0, inf]: -0.1"),
            ("/Body", OURS + "seed", -1, "a value outside [0, inf]: -1"),
        )
    ],
    "unit-quaternions": [
        (
            "rest",
            put(POINTS, OURS + "restOrientations", Vt.QuatfArray([UNIT_Q] * 26 + [UNIT_Q * 2])),
            "1 of 27 quaternions that are not unit, [26] has length 2",
        ),
        (
            "zero",
            put(GAUSSIANS, "orientations", Vt.QuatfArray(COUNT, Gf.Quatf(0.0)), MIDDLE),
            "27 of 27 quaternions that are not unit, [0] has length 0 at time 6",
        ),
    ],
    "allowed-tokens": [
        ("law", put(RUBBER, OURS + "law", "ogden"), 'law = "ogden" is not one of corotated'),
        ("solver", put("/Body", OURS + "solver", "fem"), 'solver = "fem" is not one of total'),
    ],
    "dangling-relationship": [
        ("gone", target(POINTS, OURS + "sourceMeshes", "/Body/Lost"), "refers to </Body/Lost>"),
        (
            "type",
            target(POINTS, OURS + "sourceMeshes", RUBBER),
            "</Body/Rubber>, a Material, not a geometric prim",
        ),
        (
            "mesh",
            target(POINTS, OURS + "materials", RUBBER, MESH),
            "</Body/Mesh>, a Mesh, not a Material",
        ),
    ],
    "material-indices": [
        ("few", target(POINTS, OURS + "materials", RUBBER), "values from 0 to 1"),
        ("none", target(POINTS, OURS + "materials"), "has 0 targets"),
        (
            "negative",
            put(POINTS, OURS + "materialIndices", Vt.IntArray(COUNT, -1)),
            "values from -1 to -1, but gaussianFlesh:materials has 2 targets",
        ),
    ],
    "applied-schema": [
        ("ours", apply_api("/Body/Eye", "Camera", "GaussianFleshParticlesAPI"), "to a Camera"),
        ("bake", apply_api("/Body/Eye", "Camera", "GaussianFleshBakeAPI"), "Xform, Scope"),
        ("unknown", apply_api("/Body/Eye", "Camera", "GaussianFleshHairAPI"), "HairAPI, which"),
        (
            "USD's",
            apply_api("/Body/Eye", "Camera", "ParticleFieldPositionAttributeAPI"),
            "made for ParticleField",
        ),
    ],
    "mesh-topology": [
        ("range", put(MESH, "faceVertexIndices", [*FACES[:-1], 8]), "from 0 to 8"),
        (
            "sum",
            put(MESH, "faceVertexCounts", [4] * 5),
            "add up to 20, but faceVertexIndices has 24",
        ),
        ("line", put(MESH, "faceVertexCounts", [4] * 5 + [2, 2]), "a face of 2 corners"),
        (
            "no points",
            bare_mesh,
            "has 0 points",
        ),
    ],
    "point-count": [
        (
            "more",
            lambda s: grow(s.GetPrimAtPath(MESH)),
            "9 points, but the first sample has 8 at time 6",
        ),
    ],
    "normals-length": [
        (
            "faceVarying",
            normals_by("faceVarying"),
            "8 elements, but interpolation faceVarying needs",
        ),
        ("uniform", normals_by("uniform"), "interpolation uniform needs 6"),
        ("indices", primvar_normals, "primvars:normals has 3 elements"),
    ],
    "extent": [
        ("first frame", lone_extent, "leaves points up to"),
        ("widths", thin_extent, "leaves points up to 0.05 outside"),
        ("none", no_extent, "no extent is authored around positions"),
        ("corners", put(MESH, "extent", vec3(CUBE[:1]), MIDDLE), "has 1 corners instead of 2"),
    ],
    "velocities": [
        (f"{path} times {factor:.4g}", spoil(path, name, lambda v, f=factor: v * f), text)
        for path, name in ((MESH, "velocities"), (GAUSSIANS, OURS + "velocities"))
        for factor, text in (
            (1.0 / RATE, "is 0.0333 times the motion"),  # per time code
            (24.0 / RATE, "is 0.8 times the motion"),  # the default rate instead of the stage's
            (100.0, "is 100 times the motion"),  # centimeters in a stage of meters
            (-1.0, "is -1 times the motion"),
            (0.0, "is 0 times the motion"),
        )
    ],
}


ALSO = {
    # a point more makes the per-point normals too few as well
    ("point-count", "more"): {"normals-length"},
}
