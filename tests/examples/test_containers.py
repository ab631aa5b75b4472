# SPDX-License-Identifier: Apache-2.0
"""The image and the compose file: their steps are scripts, which run here without a container."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

CHECKOUT = Path(__file__).resolve().parents[2]
EXAMPLE = CHECKOUT / "examples" / "containers"
DOCKERFILE = (CHECKOUT / "Dockerfile").read_text()
COMPOSE: dict[str, Any] = yaml.safe_load((EXAMPLE / "compose.yaml").read_text())
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
ROBOTS = ("talker", "listener")


def sent() -> set[str]:
    """Return what ``.dockerignore`` lets through to the build, as the files and folders that it lists."""
    lines = (CHECKOUT / ".dockerignore").read_text().splitlines()
    assert "*" in lines
    return {line[1:] for line in lines if line.startswith("!")}


def run(command: list[str | Path], **variables: str) -> str:
    done = subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def interpreter() -> Path:
    """Return a Python for the image, if possible one that every user may run."""
    system = Path("/usr/bin/python3")
    usable = [system, "-c", "import ensurepip, sys; sys.exit(sys.version_info < (3, 11))"]
    works = system.exists() and subprocess.run(usable, capture_output=True, check=False).returncode == 0
    return system if works else Path(sys.executable)


def as_user(command: list[str | Path], folder: Path) -> list[str | Path]:
    """Return a command that runs as a user who owns a folder and is not root, as in the image, if that is possible."""
    may_enter = all(each.stat().st_mode & stat.S_IXOTH for each in interpreter().resolve().parents)
    if os.geteuid() != 0 or not may_enter:
        return command
    for each in (folder, *folder.rglob("*")):
        os.chown(each, 1000, 1000)
    return ["setpriv", "--reuid=1000", "--regid=1000", "--clear-groups", *command]


def test_what_the_image_is_built_from_is_there() -> None:
    names = sent()
    assert all((CHECKOUT / name).exists() for name in names)
    settings = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
    wheel: list[str] = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    assert {Path(name).parts[0] for name in wheel} <= names
    assert {"pyproject.toml", "image.lock", ".ci/image", settings["project"]["readme"], "LICENSE"} <= names


def test_the_image_has_the_versions_that_the_tests_run_with() -> None:
    locked = {
        name: dict(re.findall(r"^([a-z0-9-]+)==(\S+)", (CHECKOUT / name).read_text(), re.MULTILINE))
        for name in ("requirements.lock", "image.lock")
    }
    assert locked["image.lock"].items() <= locked["requirements.lock"].items()
    settings = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
    needed = {re.split(r"[>=<]", each)[0] for each in settings["project"]["dependencies"]}
    assert needed <= locked["image.lock"].keys()


def test_the_image_runs_as_a_user_who_is_not_root() -> None:
    *_, last = re.split(r"^FROM .*$", DOCKERFILE, flags=re.MULTILINE)
    assert re.search(r"^USER keymint$", last, re.MULTILINE)
    assert "ENTRYPOINT" in last.partition("USER keymint")[2]


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """Yield a folder that every user may enter, unlike those of pytest."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        Path(name).chmod(0o755)
        yield Path(name)


def test_the_steps_of_the_image(tmp_path: Path, open_folder: Path) -> None:
    """``.ci/image`` makes a folder in which keymint runs, without the tools that built it, from what is sent alone."""
    reached = subprocess.run(
        [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", tmp_path / "probe", "click"],
        capture_output=True,
        check=False,
    )
    if reached.returncode != 0:
        pytest.skip("no package index is reached")
    context = tmp_path / "context"
    for name in sent():
        copy = shutil.copytree if (CHECKOUT / name).is_dir() else shutil.copy2
        (context / name).parent.mkdir(parents=True, exist_ok=True)
        copy(CHECKOUT / name, context / name)  # type: ignore[operator]
    folder = open_folder / "keymint"
    assert "keymint, version" in run([context / ".ci" / "image", folder], PYTHON=str(interpreter()))
    installed = {path.name.partition("-")[0] for path in folder.glob("lib/python*/site-packages/*")}
    assert {"keymint", "comarmor", "cryptography"} <= installed
    assert not {"hatchling", "pip", "setuptools", "pytest"} & installed
    workspace = open_folder / "volume"
    workspace.mkdir()
    policy = EXAMPLE.parent / "talker_listener" / "talker_listener.xml"
    shutil.copy2(policy, workspace)
    command = as_user(["env", "-C", workspace, "HOME=/nonexistent", folder / "bin" / "keymint"], workspace)
    run([*command, "provision", policy.name, "-w", "ws", "-q"])
    assert "no findings" in run([*command, "check", "-w", "ws"])


@pytest.fixture(scope="module")
def volumes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the commands of the compose file in the order of their dependencies; return the folder of the volumes."""
    folder = tmp_path_factory.mktemp("volumes")
    for name in COMPOSE["volumes"]:
        (folder / name).mkdir()
    for name in ("provision", *(f"{robot}_keystore" for robot in ROBOTS)):
        service = SERVICES[name]
        inside = {}
        for mount in service["volumes"]:
            source, target = mount.split(":")[:2]
            inside[target] = (EXAMPLE / source).resolve() if source.startswith(".") else folder / source
        words: list[str] = [*service["entrypoint"], *service["command"]]
        for target, source in inside.items():
            words = [re.sub(rf"^{target}(?=/|$)", str(source), word) for word in words]
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        run([*words], PATH=path)
    return folder


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_reads_its_own_enclave_alone(robot: str, volumes: Path) -> None:
    mounts = SERVICES[robot]["volumes"]
    assert mounts == [f"{robot}:/keystore:ro"]
    assert SERVICES[robot]["environment"]["ROS_SECURITY_ENCLAVE_OVERRIDE"] == f"/{robot}"
    assert SERVICES[robot]["environment"]["ROS_SECURITY_STRATEGY"] == "Enforce"
    assert [each.name for each in (volumes / robot / "enclaves").iterdir()] == [robot]
    assert (volumes / robot / "enclaves" / robot / "key.pem").stat().st_mode & 0o777 == 0o600
    (key,) = (path for path in (volumes / robot).rglob("*") if path.is_file() and b"PRIVATE KEY" in path.read_bytes())
    assert key.name == "key.pem"


def test_only_what_signs_mounts_the_authority() -> None:
    mounting = {
        name for name, service in SERVICES.items() if any(each.startswith("authority:") for each in service["volumes"])
    }
    assert mounting == {"provision"}
    steps = ("provision", *(f"{robot}_keystore" for robot in ROBOTS))
    assert {SERVICES[name]["network_mode"] for name in steps} == {"none"}
