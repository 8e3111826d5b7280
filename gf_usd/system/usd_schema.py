"""Registers the schema library gaussianFlesh with USD when this module is imported.

USD reads schema definitions once, at the first use of its registry, for example by opening a stage.
This module must therefore be imported before any stage is opened.  Where it is too late, files can
still be read, which does not need the definitions; code that writes or checks calls `require`
first, so that no API without attributes is applied.
"""

from __future__ import annotations

from pathlib import Path

from pxr import Plug, Sdf, Usd

from gf_usd.core.errors import GfUsdError, SchemaTooLate

NAMESPACE = "gaussianFlesh"
PARTICLES_API = "GaussianFleshParticlesAPI"
MATERIAL_API = "GaussianFleshMaterialAPI"
BAKE_API = "GaussianFleshBakeAPI"
HEALTH_API = "GaussianFleshHealthAPI"
SCENE_API = "GaussianFleshSceneAPI"
ATTACHMENT_API = "GaussianFleshAttachmentAPI"
APIS = (PARTICLES_API, MATERIAL_API, BAKE_API, HEALTH_API, SCENE_API, ATTACHMENT_API)

DEFINITIONS = "generatedSchema.usda"


def schema_path() -> Path:
    """The folder of the library, for the ``PXR_PLUGINPATH_NAME`` of other programs.

    A wheel has it inside the package, a source checkout next to it.

    Raises
    ------
    GfUsdError : the installation has no library.
    """
    package = Path(__file__).resolve().parent.parent
    candidates = [folder / "schemas" / NAMESPACE for folder in (package, package.parent)]
    for folder in candidates:
        if (folder / "plugInfo.json").is_file():
            return folder
    raise GfUsdError(
        f"the schema library {NAMESPACE} is missing: no plugInfo.json in "
        + " or ".join(str(folder) for folder in candidates),
        "install gf-usd again; from source, run tools/generate_schema.py",
    )


def register(folder: Path) -> None:
    """Register the library in ``folder`` and check that USD has its APIs.

    Raises
    ------
    GfUsdError : another version of the library is registered.
    SchemaTooLate : USD had read its schema definitions before this call.
    """
    Plug.Registry().RegisterPlugins(str(folder))
    _refuse_another_version(folder)
    registry = Usd.SchemaRegistry()
    missing = [name for name in APIS if registry.FindAppliedAPIPrimDefinition(name) is None]
    if missing:
        raise SchemaTooLate(
            f"the schema library {NAMESPACE} was registered too late: USD had already read the "
            f"schema definitions and has none for {', '.join(missing)}",
            "import gf_usd.system.usd_schema before anything opens a stage, or start the program"
            f" with PXR_PLUGINPATH_NAME={folder}",
        )


def _refuse_another_version(folder: Path) -> None:
    """USD keeps the first plugin of a name, so a second copy must have the same definitions."""
    plugin = Plug.Registry().GetPluginWithName(NAMESPACE)
    registered = Path(plugin.resourcePath) if plugin else folder
    if registered.resolve() == folder.resolve():
        return
    theirs, ours = registered / DEFINITIONS, folder / DEFINITIONS
    if not theirs.is_file() or theirs.read_bytes() != ours.read_bytes():
        raise GfUsdError(
            f"another version of the schema library {NAMESPACE} is already registered: "
            f"{registered} differs from {folder}",
            f"remove {registered} from PXR_PLUGINPATH_NAME, or replace it with {folder}",
        )


def property_names(api: str) -> tuple[str, ...]:
    """The attributes and relationships of gf-usd that the API ``api`` declares."""
    layer = Sdf.Layer.FindOrOpen(str(schema_path() / DEFINITIONS))
    return tuple(spec.name for spec in layer.GetPrimAtPath(f"/{api}").properties)


LATE: SchemaTooLate | None = None  # why the definitions are missing
try:
    register(schema_path())
except SchemaTooLate as error:
    LATE = error


def require_registered() -> None:
    """Raise SchemaTooLate where USD had read its definitions before this module was imported."""
    if LATE is not None:
        raise LATE
