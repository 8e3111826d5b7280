"""The schema library: generated, registered in time, with the right fallbacks, and dispensable."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gf_usd.core.materials.laws import law_internals, law_parameters

ROOT = Path(__file__).resolve().parents[2]
GENERATOR = ROOT / "tools" / "generate_schema.py"

OUR_STAGE = """#usda 1.0
(
    defaultPrim = "Body"
    metersPerUnit = 1
    upAxis = "Y"
)

def Points "Body" (
    prepend apiSchemas = ["GaussianFleshParticlesAPI"]
)
{
    point3f[] points = [(0, 0, 0), (1, 0, 0)]
    uniform float[] gaussianFlesh:masses = [0.25, 0.5]
    rel gaussianFlesh:materials = </Body/Rubber>

    def Material "Rubber" (
        prepend apiSchemas = ["GaussianFleshMaterialAPI", "PhysicsMaterialAPI"]
    )
    {
        uniform token gaussianFlesh:law = "neoHookean"
        float physics:youngsModulus = 1234
    }
}
"""


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a fresh process: USD reads its schemas once per process."""
    inherited = {k: v for k, v in os.environ.items() if k != "PXR_PLUGINPATH_NAME"}
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env={**inherited, "PYTHONPATH": str(ROOT), **environment},
    )


def output(code: str, **environment: str) -> str:
    done = python(code, **environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_generated_files_are_what_the_generator_writes() -> None:
    pytest.importorskip("jinja2")
    done = subprocess.run(
        [sys.executable, str(GENERATOR), "--check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("docs/schema.md", "GaussianFleshBakeAPI", "GaussianFleshBake"),
        pytest.param(
            "schemas/gaussianFlesh/generatedSchema.usda",
            "corotated",
            "linear",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "schemas/gaussianFlesh/plugInfo.json",
            '"Root": "."',
            '"Root": ".."',
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_hand_edit_is_found(tmp_path: Path, name: str, old: str, new: str) -> None:
    pytest.importorskip("jinja2")
    for part in ("tools/generate_schema.py", "docs/schema.md", "schemas/gaussianFlesh"):
        target = tmp_path / part
        target.parent.mkdir(parents=True, exist_ok=True)
        source = ROOT / part
        shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
    edited = tmp_path / name
    text = edited.read_text("utf-8")
    assert old in text
    edited.write_text(text.replace(old, new), "utf-8")
    done = subprocess.run(
        [sys.executable, str(tmp_path / "tools" / "generate_schema.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert name in done.stdout


FALLBACKS = {
    "GaussianFleshMaterialAPI": {
        "gaussianFlesh:law": "corotated",
        "gaussianFlesh:dampingTime": 0.0,
        "gaussianFlesh:look": "",
        "physics:youngsModulus": 0.0,
        "physics:poissonsRatio": pytest.approx(0.3, rel=1e-7),  # stored as a float
        "physics:density": 0.0,  # of the built-in PhysicsMaterialAPI
    },
    "GaussianFleshBakeAPI": {
        "gaussianFlesh:enabled": True,
        "gaussianFlesh:material": "",
        "gaussianFlesh:spacing": 0.0,
        "gaussianFlesh:particles": 0,
        "gaussianFlesh:seed": 0,
        "gaussianFlesh:solver": "totalLagrangian",
    },
}


@pytest.mark.parametrize(("api", "type_name"), [*zip(FALLBACKS, ("Material", "Mesh"))])
def test_fallbacks_after_registration_at_import(api: str, type_name: str) -> None:
    """``ApplyAPI`` is True even without definitions: only the values prove the registration."""
    values = eval(
        output(
            "import gf_usd.system.usd_schema\n"
            "from pxr import Usd\n"
            "stage = Usd.Stage.CreateInMemory()\n"
            f"prim = stage.DefinePrim('/A', '{type_name}')\n"
            f"assert prim.ApplyAPI('{api}')\n"
            f"print({{n: prim.GetAttribute(n).Get() for n in {[*FALLBACKS[api]]}}})\n"
        )
    )
    assert values == FALLBACKS[api]


def test_particle_arrays_have_types_and_no_fallback() -> None:
    """Shape of the declaration: uniform at rest, varying where samples are written."""
    rows = output(
        "import gf_usd.system.usd_schema as schema\n"
        "from pxr import Usd\n"
        "d = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(schema.PARTICLES_API)\n"
        "for n in d.GetPropertyNames():\n"
        "    s = d.GetSchemaPropertySpec(n)\n"
        "    kind = getattr(s, 'typeName', 'rel')\n"
        "    print(n.split(':')[1], kind, str(s.variability).split('Variability')[-1],\n"
        "          getattr(s, 'default', None))\n"
    ).splitlines()
    assert set(rows) == {
        "restPositions point3f[] Uniform None",
        "restOrientations quatf[] Uniform None",
        "restScales float3[] Uniform None",
        "restVolumes float[] Uniform None",
        "masses float[] Uniform None",
        "materialIndices int[] Uniform None",
        "youngsModulus float[] Uniform None",
        "poissonsRatio float[] Uniform None",
        "densities float[] Uniform None",
        "velocities vector3f[] Varying None",
        "deformationGradients matrix3d[] Varying None",
        "vonMisesStress float[] Varying None",
        "plasticStrain float[] Varying None",
        "lostVolume float[] Varying None",
        "loosening float[] Varying None",
        "plasticVolume float[] Varying None",
        "elasticStrain float[] Varying None",
        *(f"{p.attribute} float[] Uniform None" for p in law_parameters()),
        "materials rel Uniform None",
        "sourceMeshes rel Uniform None",
    }


def test_apis_are_applied_to_the_types_they_are_made_for() -> None:
    code = (
        "import gf_usd.system.usd_schema as schema\n"
        "from pxr import Usd\n"
        "stage = Usd.Stage.CreateInMemory()\n"
        "for api in schema.APIS:\n"
        "    print(*[t for t in ('Xform', 'Scope', 'SkelRoot', 'Mesh', 'Sphere', 'Points',\n"
        "        'ParticleField3DGaussianSplat', 'Material', 'Camera')\n"
        "        if stage.DefinePrim('/' + t, t).CanApplyAPI(api)])\n"
    )
    assert output(code).splitlines() == [
        "Points ParticleField3DGaussianSplat",
        "Material",
        "Xform Scope SkelRoot Mesh Sphere",
        "Xform Scope SkelRoot Mesh Sphere Points ParticleField3DGaussianSplat Material Camera",
        "",  # of a PhysicsScene
        "Xform Scope SkelRoot Mesh Sphere Points ParticleField3DGaussianSplat Material Camera",
    ]


@pytest.mark.slow
def test_bake_settings_apply_to_everything_that_is_baked() -> None:
    code = (
        "import gf_usd.system.usd_schema as schema\n"
        "from gf_usd.readers.usd.implicit import IMPLICIT\n"
        "from pxr import Usd\n"
        "stage = Usd.Stage.CreateInMemory()\n"
        "for t in IMPLICIT:\n"
        "    if not stage.DefinePrim('/' + t, t).CanApplyAPI('GaussianFleshBakeAPI'):\n"
        "        print(t)\n"
    )
    assert output(code) == ""


def test_registration_after_the_first_use_of_schemas_says_what_to_do() -> None:
    done = python(
        "from pxr import Usd\n"
        "Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('MaterialBindingAPI')\n"
        "from gf_usd.core.errors import GfUsdError\n"
        "try:\n"
        "    from gf_usd.system import usd_schema\n"
        "    usd_schema.require_registered()\n"
        "except GfUsdError as error:\n"
        "    print(error)\n"
    )
    message, hint = done.stdout.strip().split("\n\n")
    assert message == (
        "the schema library gaussianFlesh was registered too late: USD had already read the schema "
        "definitions and has none for GaussianFleshParticlesAPI, GaussianFleshMaterialAPI, "
        "GaussianFleshBakeAPI, GaussianFleshHealthAPI, GaussianFleshSceneAPI, "
        "GaussianFleshAttachmentAPI"
    )
    assert hint == (
        "hint: import gf_usd.system.usd_schema before anything opens a stage, or start the program"
        f" with PXR_PLUGINPATH_NAME={ROOT / 'schemas' / 'gaussianFlesh'}"
    )


def test_the_environment_variable_makes_late_import_possible() -> None:
    code = (
        "from pxr import Usd\n"
        "d = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('GaussianFleshBakeAPI')\n"
        "import gf_usd.system.usd_schema\n"
        "print(len(d.GetPropertyNames()))\n"
    )
    assert output(code, PXR_PLUGINPATH_NAME=str(ROOT / "schemas" / "gaussianFlesh")) == "6"


@pytest.mark.parametrize("edited", [False, True])
def test_a_second_copy_must_be_the_same_version(tmp_path: Path, edited: bool) -> None:
    other = tmp_path / "gaussianFlesh"
    shutil.copytree(ROOT / "schemas" / "gaussianFlesh", other)
    if edited:
        definitions = other / "generatedSchema.usda"
        definitions.write_text(definitions.read_text("utf-8").replace("seed", "grain"), "utf-8")
    done = python(
        "from pxr import Plug\n"
        "Plug.Registry().GetPluginWithName('gaussianFlesh')\n"
        "import gf_usd.system.usd_schema\n",
        PXR_PLUGINPATH_NAME=str(other),
    )
    assert (done.returncode != 0) == edited
    if edited:
        assert f"already registered: {other} differs from" in done.stderr
        assert f"hint: remove {other} from PXR_PLUGINPATH_NAME" in done.stderr


def test_a_file_with_our_apis_reads_without_the_library(tmp_path: Path) -> None:
    path = tmp_path / "ours.usda"
    path.write_text(OUR_STAGE, "utf-8")
    lines = output(
        "from pxr import Usd, UsdPhysics\n"
        f"stage = Usd.Stage.Open({str(path)!r})\n"
        "body, rubber = stage.GetPrimAtPath('/Body'), stage.GetPrimAtPath('/Body/Rubber')\n"
        "d = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('GaussianFleshParticlesAPI')\n"
        "print(d, body.IsA('Points'), list(body.GetAttribute('gaussianFlesh:masses').Get()))\n"
        "print(*body.GetRelationship('gaussianFlesh:materials').GetTargets())\n"
        "print(rubber.GetAttribute('gaussianFlesh:law').Get(),\n"
        "      rubber.GetAttribute('physics:youngsModulus').Get(),\n"
        "      rubber.HasAPI(UsdPhysics.MaterialAPI))\n"
    ).splitlines()
    assert lines == ["None True [0.25, 0.5]", "/Body/Rubber", "neoHookean 1234.0 True"]


def test_the_reference_names_every_property() -> None:
    text = (ROOT / "docs" / "schema.md").read_text("utf-8")
    names = output(
        "import gf_usd.system.usd_schema as schema\n"
        "print(*[name for api in schema.APIS for name in schema.property_names(api)])\n"
    ).split()
    assert len(names) == 91 + 2 * len(law_parameters()) + len(law_internals())
    assert [name for name in names if f"| `{name}` |" not in text] == []
