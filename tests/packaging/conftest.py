# SPDX-License-Identifier: Apache-2.0
"""The distribution, built once, and environments to install it into, all without network."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from email import message_from_bytes
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

CHECKOUT = Path(__file__).resolve().parents[2]
NOW = 1_800_000_000
"""The clock of the commands, as ``SOURCE_DATE_EPOCH``."""


def run(command: list[str | Path], cwd: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in an environment that hides the checkout from Python, and fixes the clock."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_", "ROS_"))}
    plain |= {"SOURCE_DATE_EPOCH": str(NOW), "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_CACHE_DIR": "1"}
    return subprocess.run(command, cwd=cwd, env=plain | (env or {}), capture_output=True, text=True, check=False)


def build(project: Path, folder: Path, *options: str) -> None:
    """Build a project's distributions with the tools of this environment."""
    done = run([sys.executable, "-m", "build", "--no-isolation", *options, "--outdir", folder, project], folder)
    assert done.returncode == 0, done.stdout + done.stderr


@dataclass(frozen=True)
class Environment:
    """A virtual environment that contains only the declared dependencies of the distribution."""

    folder: Path
    cwd: Path
    variables: dict[str, str] = field(default_factory=dict)

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    @property
    def site_packages(self) -> Path:
        return next(self.folder.glob("lib/python*/site-packages"))

    def pip(self, *arguments: str | Path) -> str:
        """Run pip for this environment, without an index."""
        done = run([sys.executable, "-m", "pip", "--python", self.python, *arguments], self.cwd)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def install(self, *arguments: str | Path) -> None:
        """Install distributions; their dependencies must be installed already, and Python compiles what it runs."""
        self.pip("install", "--quiet", "--no-index", "--no-build-isolation", "--no-compile", *arguments)

    def keymint(self, *arguments: str | Path, code: int = 0, cwd: Path | None = None) -> str:
        """Run the installed command, check its exit code, and return its output."""
        done = run([self.folder / "bin" / "keymint", *arguments], cwd or self.cwd, self.variables)
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout + done.stderr

    def report(self, *arguments: str | Path, code: int = 0) -> dict[str, Any]:
        """Run the installed command and return the document that ``--json`` printed."""
        document: dict[str, Any] = json.loads(self.keymint(*arguments, "--json", code=code))
        return document


def _needed(names: set[str]) -> Iterator[Distribution]:
    """Yield distributions of this environment and their dependencies, without extras."""
    seen: set[str] = set()
    todo = set(names)
    while todo:
        name = todo.pop()
        seen.add(name)
        found = distribution(name)
        yield found
        for text in found.requires or []:
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                todo |= {re.sub(r"[-_.]+", "-", requirement.name).lower()} - seen


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the distributed files of the checkout, so that building and editing do not affect each other."""
    folder = tmp_path_factory.mktemp("project")
    settings = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
    listed: list[str] = settings["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    for name in ("pyproject.toml", ".gitignore", *(entry.removeprefix("/") for entry in listed)):
        if (CHECKOUT / name).is_dir():
            made = shutil.ignore_patterns("__pycache__", ".*_cache", "generated")  # the last one by 'make docs'
            shutil.copytree(CHECKOUT / name, folder / name, ignore=made)
        else:
            shutil.copy2(CHECKOUT / name, folder / name)
    return folder


@pytest.fixture(scope="session")
def dist(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the source distribution, its wheel, and in ``direct/`` the wheel of the project."""
    folder = tmp_path_factory.mktemp("dist")
    (folder / "direct").mkdir()
    build(project, folder)
    build(project, folder / "direct", "--wheel")
    return folder


@pytest.fixture(scope="session")
def wheel(dist: Path) -> Path:
    """Return the wheel that ``pip install`` builds from the source distribution."""
    (found,) = dist.glob("*.whl")
    return found


@pytest.fixture(scope="session")
def new_environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Environment]:
    """Return a function that creates an environment with the given distributions and the dependencies."""

    def make(*names: str) -> Environment:
        home = tmp_path_factory.mktemp("environment")
        (home / "elsewhere").mkdir()
        environment = Environment(home / "venv", home / "elsewhere")
        venv.create(environment.folder, with_pip=False, symlinks=True)
        # Links to what this environment has take the place of downloads.
        for needed in _needed(dependencies(wheel) | set(names)):
            for top in {Path(file).parts[0] for file in needed.files or []} - {"..", "__pycache__"}:
                link = environment.site_packages / top
                if not link.exists():
                    link.symlink_to(Path(str(needed.locate_file(top))))
        return environment

    return make


@pytest.fixture(scope="session")
def installed(wheel: Path, new_environment: Callable[..., Environment]) -> Environment:
    """Return an environment with the wheel, and nothing else; who changes it changes it back."""
    environment = new_environment()
    environment.install(wheel)
    return environment


def dependencies(wheel: Path) -> set[str]:
    """Return the names of the declared dependencies of a wheel, without extras."""
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        requires = message_from_bytes(archive.read(metadata)).get_all("Requires-Dist", [])
    parsed = map(Requirement, requires)
    return {item.name for item in parsed if item.marker is None or item.marker.evaluate({"extra": ""})}
