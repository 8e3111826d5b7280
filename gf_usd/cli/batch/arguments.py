"""Makes the plan of a batch from the arguments of the command line."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gf_usd.batch.manifest import (
    OUT,
    SUFFIXES,
    Manifest,
    absolute,
    clean,
    clean_value,
    make_group,
    parse,
    read_manifest,
)
from gf_usd.batch.plan import (
    BatchPlan,
    is_bundle,
    make_plan,
    read_jobs,
    with_mapped_paths,
    with_output_folder,
)
from gf_usd.core.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """The arguments that determine the jobs, in addition to the manifest or the assets."""

    materials: str | None = None
    seeds: str | None = None
    settings: Mapping[str, Any] | None = None  # --particles, --frames and --set
    name: str | None = None
    out: Path | None = None
    timeout: float | None = None
    retries: int | None = None
    path_mapping: Path | None = None


def require_company(options: Mapping[str, Any], needed: str, there: object) -> None:
    """Raise UsageError for options that have no effect without another one.

    options : values by flag.
    there : the value of the flag `needed`.
    """
    for flag, value in options.items():
        if value and there is None:
            raise UsageError(f"{flag} is given without {needed}", f"give {needed}, or omit {flag}")


def plan_of(sources: Sequence[str], arguments: Arguments) -> BatchPlan:
    """The plan of a manifest, of the jobs of a bundle, or of assets.

    Raises UsageError, or InputError for a manifest that cannot be read.
    """
    timeout = arguments.timeout
    if timeout is not None and not timeout <= threading.TIMEOUT_MAX:
        raise UsageError(
            f"--timeout is {timeout:g}", f"give seconds, up to {threading.TIMEOUT_MAX:.2g}"
        )
    manifest_file = _manifest_among(sources)
    if manifest_file is not None and is_bundle(manifest_file):
        return _bundle(manifest_file, arguments)
    if arguments.path_mapping is not None:
        raise UsageError(
            "--path-mapping applies only to the jobs of a bundle", "give the bundle's jobs.json"
        )
    if manifest_file is not None:
        manifest = _overridden(read_manifest(manifest_file), arguments)
    else:
        manifest = _of_assets(sources, arguments)
    if arguments.out is not None:
        manifest = replace(manifest, out=absolute(arguments.out))
    if timeout is not None:
        manifest = replace(manifest, timeout=timeout)
    if arguments.retries is not None:
        manifest = replace(manifest, retries=arguments.retries)
    return make_plan(manifest)


def _manifest_among(sources: Sequence[str]) -> Path | None:
    """The manifest that is given in place of assets; None: assets are given.

    Raises UsageError for a manifest together with other files.
    """
    manifests = [source for source in sources if Path(source).suffix.lower() in SUFFIXES]
    if not manifests:
        return None
    if len(sources) > 1:
        raise UsageError(
            f"{len(sources)} files were given, but {manifests[0]} is a manifest",
            "give one manifest, or assets",
        )
    return Path(manifests[0])


def parse_settings(pairs: Sequence[str], named: Mapping[str, Any]) -> dict[str, Any]:
    """The options of all bakes.  Raises UsageError for a pair that is not NAME=VALUE.

    pairs : of --set; named : options with a flag of their own, None: not given.
    """
    settings = {key: value for key, value in named.items() if value is not None}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign or not name:
            raise UsageError(f"--set {pair}: the value is missing", "give --set NAME=VALUE")
        settings[name] = parse(name, text, f"--set {pair}")
    return settings


def _axes(arguments: Arguments) -> dict[str, list[Any]]:
    """The axes of the command line: its commas separate jobs, not variants."""
    axes: dict[str, list[Any]] = {}
    if arguments.materials is not None:
        axes["material"] = [part.strip() for part in arguments.materials.split(",")]
    if arguments.seeds is not None:
        axes["seed"] = [parse("seed", part, "--seed") for part in arguments.seeds.split(",")]
    return axes


def _of_assets(sources: Sequence[str], arguments: Arguments) -> Manifest:
    """A manifest of assets that the command line names."""
    group = make_group(
        sources, settings=arguments.settings or {},
        matrix={"material": ["rubber"], **_axes(arguments)}, name=arguments.name,
        folder=Path.cwd(), where="the command line",
    )  # fmt: skip
    out = absolute(arguments.out or Path(OUT))
    return Manifest(groups=(group,), folder=Path.cwd(), title=out.name, out=out)


def _overridden(manifest: Manifest, arguments: Arguments) -> Manifest:
    """A manifest whose settings and axes are replaced by those of the command line."""
    axes = {
        key: [clean_value(key, value, "the command line", Path.cwd()) for value in values]
        for key, values in _axes(arguments).items()
    }
    given = arguments.settings or {}
    settings = clean(given, "the command line", Path.cwd())
    fixed = {name.replace("-", "_") for name in given} - axes.keys()
    groups = []
    for group in manifest.groups:
        kept = {k: v for k, v in group.settings.items() if k not in fixed}
        own = {k: v for k, v in {**kept, **settings}.items() if k not in axes}
        matrix = {k: v for k, v in {**group.matrix, **axes}.items() if k not in fixed}
        groups.append(
            replace(group, settings=own, matrix=matrix, name=arguments.name or group.name)
        )
    return replace(manifest, groups=tuple(groups))


def _bundle(path: Path, arguments: Arguments) -> BatchPlan:
    """The jobs of a bundle, unchanged except for where and how they run."""
    fixed = (arguments.materials, arguments.seeds, arguments.settings or None, arguments.name)
    if any(value is not None for value in fixed):
        raise UsageError(
            f"{path} contains jobs whose options cannot be changed",
            "write the bundle again with other options",
        )
    plan = read_jobs(path)
    if arguments.path_mapping is not None:
        plan = with_mapped_paths(plan, arguments.path_mapping)
    if arguments.out is not None:
        plan = with_output_folder(plan, absolute(arguments.out))
    if arguments.timeout is not None:
        plan = replace(plan, timeout=arguments.timeout)
    return plan if arguments.retries is None else replace(plan, retries=arguments.retries)
