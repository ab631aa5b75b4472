# SPDX-License-Identifier: Apache-2.0
"""The wheel, the source distribution and an editable install are complete, and find their data."""

from __future__ import annotations

import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Callable
from dataclasses import replace
from email import message_from_bytes
from pathlib import Path

import pytest

import keymint

from .conftest import Environment, build, run

pytestmark = pytest.mark.xdist_group("packaging")

PACKAGES = {
    "comarmor", "keymint", "keymint_comarmor", "keymint_ros", "keymint_ros2_comarmor", "keymint_ros2_dds",
    "keymint_ros2_sros2", "keymint_ros2_table", "keymint_ros2_zenoh", "keymint_xacml",
}  # fmt: skip
DIST_INFO = f"keymint_tools-{keymint.__version__}.dist-info"
POLICY = """<?xml version="1.0"?>
<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="p">
    <attachment>/robot/camera</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/image</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def tree(folder: Path) -> dict[str, bytes]:
    """Return the files below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_wheel_contains_only_the_packages(project: Path, wheel: Path) -> None:
    names = set(contents(wheel))
    assert {name.partition("/")[0] for name in names} == {*PACKAGES, DIST_INFO}
    assert {name for name in names if "/_data/" in name} == {
        f"{folder.name}/_data/{kind}/{name}"
        for kind in ("schemas", "templates")
        for folder in (project / kind).iterdir()
        for name in tree(folder)
    }
    assert {f"{package}/py.typed" for package in PACKAGES} <= names


def test_the_wheels_of_the_source_distribution_and_the_checkout_are_identical(dist: Path, wheel: Path) -> None:
    (direct,) = (dist / "direct").glob("*.whl")
    assert contents(wheel) == contents(direct)


def test_the_metadata_of_the_wheel(project: Path, wheel: Path) -> None:
    files = contents(wheel)
    said = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    metadata = message_from_bytes(files[f"{DIST_INFO}/METADATA"])
    assert metadata["Name"] == "keymint-tools"
    assert metadata["Version"] == keymint.__version__
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata["License-Expression"] == "Apache-2.0"
    assert files[f"{DIST_INFO}/licenses/LICENSE"] == (project / "LICENSE").read_bytes()
    registered = files[f"{DIST_INFO}/entry_points.txt"].decode()
    for group in said["entry-points"]:
        assert f"[{group}]" in registered
    assert "keymint = keymint.__main__:main" in registered


def test_every_folder_of_plugins_is_packaged(project: Path, wheel: Path) -> None:
    files = contents(wheel)
    for package in (path for path in (project / "plugins").iterdir() if (path / "__init__.py").exists()):
        assert (
            tree(package).items()
            <= {
                name.removeprefix(f"{package.name}/"): content
                for name, content in files.items()
                if name.startswith(f"{package.name}/")
            }.items()
        )


def test_the_source_distribution_contains_everything_that_make_test_needs(project: Path, dist: Path) -> None:
    (source,) = dist.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        names = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    for folder in (".ci", "tests", "examples", "benchmarks", "docs", "schemas", "templates", "plugins"):
        assert {f"{folder}/{name}" for name in tree(project / folder)} <= names
    assert {"Makefile", "requirements.lock", "LICENSE", "README.md", "CONTRIBUTING.md"} <= names


@pytest.mark.parametrize("kind", ["wheel", "source", "editable"])
def test_an_installation_works_elsewhere(
    kind: str,
    project: Path,
    dist: Path,
    installed: Environment,
    new_environment: Callable[..., Environment],
    tmp_path: Path,
) -> None:
    environment = replace(installed if kind == "wheel" else new_environment("hatchling"), cwd=tmp_path)
    before = tree(project)
    if kind == "source":
        environment.install(next(dist.glob("*.tar.gz")))
    if kind == "editable":
        environment.install("--editable", project)
    assert tree(project) == before
    environment.pip("check")
    (environment.cwd / "policy.xml").write_text(POLICY)
    done = run(
        [environment.python, "-P", "-m", "keymint", "provision", "policy.xml", "-w", "ws", "--json"], environment.cwd
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    assert (environment.cwd / "ws/install/enclaves/robot/camera/permissions.p7s").is_file()
    assert "no findings" in environment.keymint("check", "-w", "ws")
    script = "".join(f"import {module}; print({module}.__file__)\n" for module in PACKAGES)
    places = run([environment.python, "-P", "-c", script], environment.cwd).stdout.split()
    installed = {project, project / "plugins"} if kind == "editable" else {environment.site_packages}
    assert {Path(place).parent.parent for place in places} == installed


def test_an_incomplete_installation_is_reported(installed: Environment, tmp_path: Path) -> None:
    schemas = installed.site_packages / "keymint_ros/_data/schemas"
    (tmp_path / "policy.xml").write_text(POLICY)
    schemas.rename(schemas.with_name("gone"))
    try:
        said = installed.keymint("provision", "policy.xml", "-w", "ws", code=1, cwd=tmp_path)
    finally:
        schemas.with_name("gone").rename(schemas)
    assert "lacks the schemas of keymint_ros; reinstall Keymint from its checkout or wheel" in said


def test_the_distributions_are_built_reproducibly(project: Path, dist: Path, tmp_path: Path) -> None:
    build(project, tmp_path)
    assert tree(tmp_path) == {path.name: path.read_bytes() for path in dist.glob("*.*")}


def test_an_index_takes_the_distributions(dist: Path) -> None:
    done = run([sys.executable, "-m", "twine", "check", "--strict", *dist.glob("*.*")], dist)
    assert done.returncode == 0, done.stdout + done.stderr
