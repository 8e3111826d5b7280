"""For every rule of the check the ways to break a good stage, each as small as can be."""

from __future__ import annotations

import numpy as np
from check_damage import (
    GAUSSIANS,
    MESH,
    MIDDLE,
    OURS,
    POINTS,
    RUBBER,
    Break,
    apply_api,
    bare_mesh,
    grow,
    half,
    late_samples,
    lone_extent,
    metadata,
    no_extent,
    no_range,
    normals_by,
    primvar_normals,
    put,
    spoil,
    target,
    thin_extent,
    with_nan,
)
from check_stages import CUBE, FACES, GRID, RATE, floats, vec3
from pxr import Gf, UsdGeom, Vt

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
        ("late", late_samples, "samples from 1 to 12, the stage runs from 1 to 9"),
        ("backwards", lambda s: s.SetStartTimeCode(20.0), "startTimeCode 20 lies after"),
        ("none", no_range, "the stage says no time range"),
    ],
    "particle-lengths": [
        ("masses", put(POINTS, OURS + "masses", floats(ONES[:5])), "5 elements for 27 points"),
        (
            "strain",
            put(GAUSSIANS, OURS + "deformationGradients", Vt.Matrix3dArray(2), MIDDLE),
            "deformationGradients has 2 elements for 27 points at time 1",
        ),
        (
            "longer",
            put(POINTS, OURS + "vonMisesStress", floats(np.ones(28)), MIDDLE),
            "28 elements for 27 points at time 6, and so in 6 more samples",
        ),
    ],
    "point-lengths": [
        ("scales", put(GAUSSIANS, "scales", vec3(np.ones((3, 3)))), "scales has 3 elements"),
        ("too many", put(GAUSSIANS, "opacities", floats(np.ones(30))), "30 elements for 27"),
        ("widths", put(POINTS, "widths", floats(np.full(2, 0.1))), "widths has 2 elements"),
        ("ids", lambda s: UsdGeom.Points.Get(s, POINTS).CreateIdsAttr([1, 2]), "ids has 2"),
        ("velocities", half(("velocities",)), "velocities has 7 elements for 8 points at time 6"),
    ],
    "sh-count": [
        ("degree", put(GAUSSIANS, "radiance:sphericalHarmonicsDegree", 2), "wants 243"),
        ("negative", put(GAUSSIANS, "radiance:sphericalHarmonicsDegree", -1), "Degree is -1"),
    ],
    "finite": [
        (name, put(path, name, value, code), "not finite, the first is [1]")
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
            (GAUSSIANS, "scales", vec3(np.zeros((COUNT, 3))), "outside (0, inf], the first is 0"),
            (GAUSSIANS, OURS + "restScales", vec3(-(GRID**2) - 1), "outside (0, inf]"),
            (POINTS, "widths", floats(-ONES), "widths has 27 of 27 values outside [0, inf]"),
            (POINTS, OURS + "restVolumes", floats(0 * ONES), "outside (0, inf], the first is 0"),
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
        ("law", put(RUBBER, OURS + "law", "ogden"), 'law = "ogden" is none of corotated'),
        ("solver", put("/Body", OURS + "solver", "fem"), 'solver = "fem" is none of total'),
    ],
    "dangling-relationship": [
        ("gone", target(POINTS, OURS + "sourceMeshes", "/Body/Lost"), "leads to </Body/Lost>"),
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
            "values from -1 to -1, gaussianFlesh:materials has 2 targets",
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
        ("sum", put(MESH, "faceVertexCounts", [4] * 5), "add up to 20, faceVertexIndices has 24"),
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
            "9 points where the first sample has 8 at time 6",
        ),
    ],
    "normals-length": [
        ("faceVarying", normals_by("faceVarying"), "8 elements, interpolation faceVarying wants"),
        ("uniform", normals_by("uniform"), "interpolation uniform wants 6"),
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
            (24.0 / RATE, "is 0.8 times the motion"),  # the default rate in place of the stage's
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
