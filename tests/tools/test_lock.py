"""requirements.lock has what pyproject.toml requires, each file by its hash."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
PIN = re.compile(
    r"^([a-z0-9-]+)==(\S+)(?: ; .*?)? \\\n((?:    --hash=sha256:[0-9a-f]{64}.*\n)+)", re.M
)


def pins() -> dict[str, list[Version]]:
    """Versions by name; several where they depend on the Python."""
    found: dict[str, list[Version]] = {}
    for name, version, _ in PIN.findall((ROOT / "requirements.lock").read_text()):
        found.setdefault(name, []).append(Version(version))
    return found


def test_the_container_installs_the_pinned_versions() -> None:
    """By constraints that its own command makes of the lock: every pin, and nothing else."""
    text = (ROOT / "Containerfile").read_text()
    assert re.search(r"COPY .*\brequirements\.lock /src/", text)
    (command,) = re.findall(r"sed -n '(.*)' /src/requirements\.lock > /src/constraints\.txt", text)
    assert re.search(r"PIP_CONSTRAINT=/src/constraints\.txt \\\n +\S+/pip install ", text)
    lock = str(ROOT / "requirements.lock")
    made = subprocess.run(["sed", "-n", command, lock], capture_output=True, text=True, check=True)
    lines = [Requirement(line) for line in made.stdout.splitlines()]
    wanted = [(name, version) for name, version, _ in PIN.findall((ROOT / lock).read_text())]
    assert [(line.name, str(line.specifier)[2:]) for line in lines] == wanted


def test_every_line_is_a_pin_with_hashes() -> None:
    text = (ROOT / "requirements.lock").read_text()
    rest = PIN.sub("", re.sub(r"^#.*\n", "", text, flags=re.M))
    assert rest == ""
    assert "://" not in text


def test_what_the_project_asks_for_is_pinned() -> None:
    """After a change of dependencies: python tools/lock.py."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    requirements = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    for extra in project["project"]["optional-dependencies"].values():
        requirements += extra
    pinned = pins()
    for requirement in map(Requirement, requirements):
        name = canonicalize_name(requirement.name)
        if name == "gf-usd":
            continue
        assert name in pinned, f"{name} is not in requirements.lock: python tools/lock.py"
        assert all(version in requirement.specifier for version in pinned[name]), name
