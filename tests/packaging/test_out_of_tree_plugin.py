# SPDX-License-Identifier: Apache-2.0
"""The plugin in ``examples/out_of_tree_plugin``, installed with pip into a fresh environment, runs the stages."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509

from keymint.pki import smime

from .conftest import CHECKOUT, Environment

pytestmark = pytest.mark.xdist_group("packaging")

PLUGIN = CHECKOUT / "examples" / "out_of_tree_plugin"
OURS, THEIRS = "keymint_ros2_dds", "keymint_json"
ENCLAVE = Path("install/enclaves/talker")
FILES = {"access.json.p7s", "cert.pem", "key.pem", "identity_ca.cert.pem", "permissions_ca.cert.pem"}


@pytest.fixture(scope="module")
def environment(wheel: Path, new_environment: Callable[..., Environment]) -> Environment:
    """Return an environment with keymint and the plugin, both installed with pip."""
    environment = new_environment("hatchling")
    # The plugin's folder is copied, so that a build tool that leaves something behind leaves it there.
    source = shutil.copytree(PLUGIN, environment.folder.parent / "plugin", ignore=shutil.ignore_patterns("__pycache__"))
    environment.install(wheel)
    environment.install(source)
    environment.pip("check")
    return environment


@pytest.fixture(scope="module")
def workspace(environment: Environment) -> Path:
    """Return a workspace in which the plugin has built and installed ``/talker``, and the shipped one ``/listener``."""
    return make_workspace(environment, environment.cwd / "ws")


def make_workspace(environment: Environment, workspace: Path) -> Path:
    """Run the stages, and select the plugin for ``/talker``."""
    environment.keymint("init", workspace)
    environment.keymint("create", "--all", "-w", workspace)
    choose(workspace, "talker", THEIRS)
    environment.keymint("build", "-w", workspace)
    environment.keymint("install", "-w", workspace)
    return workspace


def choose(workspace: Path, package: str, build_type: str) -> None:
    """Edit a package's manifest as its user would."""
    manifest = workspace / "src" / package / "keymint_package.xml"
    text = manifest.read_text()
    assert text.count(f"<build_type>{OURS}</build_type>") == 1
    manifest.write_text(text.replace(OURS, build_type))


def state(folder: Path) -> dict[str, tuple[int, int, bytes]]:
    """Return the mode, modification time and content of every file and folder, except the recorded answers."""
    return {
        path.relative_to(folder).as_posix(): (
            path.lstat().st_mode,
            path.lstat().st_mtime_ns,
            path.read_bytes() if path.is_file() else b"",
        )
        for path in folder.rglob("*")
        if path.name != ".keymint" and not path.name.startswith("last-")
    }


def test_the_plugin_is_listed_with_its_version_and_location(environment: Environment) -> None:
    listed = environment.report("plugins")["result"]["plugins"]
    (mine,) = (plugin for plugin in listed if plugin["distribution"] == "keymint-json")
    assert mine["group"] == "keymint.build_types"
    assert mine["name"] == THEIRS
    assert mine["version"] == "0.1.0"
    assert mine["target"] == "keymint_json:build_type"
    assert Path(mine["location"]) == environment.site_packages
    assert mine["usable"] is True
    (line,) = (line for line in environment.keymint("plugins").splitlines() if THEIRS in line)
    assert {"keymint.build_types", "0.1.0", "keymint-json", "yes"} <= set(line.split())


def test_the_plugin_has_the_types_of_the_interface(tmp_path: Path) -> None:
    """The type checker compares the example with the protocol, member by member."""
    checked = (
        "from keymint.api import BuildType\nfrom keymint_json import build_type\nchecked: BuildType = build_type\n"
    )
    (tmp_path / "checked.py").write_text(checked)
    (tmp_path / "mypy.ini").write_text(f"[mypy]\nstrict = true\nmypy_path = {CHECKOUT}:{PLUGIN}\n")
    command = [sys.executable, "-m", "mypy", "--cache-dir", tmp_path / "cache", "checked.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_plugin_builds_and_installs(workspace: Path) -> None:
    enclave = workspace / ENCLAVE
    assert {path.name for path in enclave.iterdir()} == FILES
    assert (enclave / "key.pem").stat().st_mode & 0o777 == 0o600
    assert enclave.stat().st_mode & 0o777 == 0o700
    assert (workspace / "install/enclaves/listener/permissions.p7s").is_file(), "the shipped build type is used as well"

    signed = (enclave / "access.json.p7s").read_bytes()
    authority = (enclave / "permissions_ca.cert.pem").read_bytes()
    at = x509.load_pem_x509_certificate(authority).not_valid_before_utc
    document = json.loads(smime.verify(signed, authority, at=at))
    assert document["subject"] == "/talker"
    expressions = {
        (rule["effect"], permission, expression)
        for rule in document["rules"]
        for permission in rule["permissions"]
        for expression in rule["expressions"]
    }
    assert ("ALLOW", "ros_publish", "/chatter") in expressions
    assert ("ALLOW", "ros_subscribe", "/chatter") not in expressions


def test_check_is_clean(environment: Environment, workspace: Path) -> None:
    assert "checked 2 enclaves: no findings" in environment.keymint("check", "-w", workspace)


def test_a_second_run_writes_nothing(environment: Environment, workspace: Path) -> None:
    before = state(workspace)
    for verb in ("build", "install"):
        assert "nothing to do" in environment.keymint(verb, "-w", workspace)
    assert state(workspace) == before


@pytest.mark.parametrize("recorded", [True, False], ids=["recorded", "unrecorded"])
def test_a_flipped_byte_is_reported(environment: Environment, workspace: Path, recorded: bool, tmp_path: Path) -> None:
    copy = shutil.copytree(workspace, tmp_path / "ws", symlinks=True)
    if not recorded:  # a keystore whose record was lost is judged by what its files say
        (copy / ".keymint/state.json").unlink()
    for name in sorted(FILES):
        target = copy / ENCLAVE / name
        content = target.read_bytes()
        middle = len(content) // 2
        target.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
        report = environment.report("check", "-w", copy, code=3)
        places = {item["file"] for item in report["diagnostics"] if item["severity"] == "error"}
        assert target in {(environment.cwd / place).resolve() for place in places}
        target.write_bytes(content)
    environment.keymint("check", "-w", copy)


def test_a_changed_policy_is_signed_again(environment: Environment, tmp_path: Path) -> None:
    workspace = make_workspace(environment, tmp_path / "ws")
    enclave = workspace / ENCLAVE
    before = {path.name: path.read_bytes() for path in enclave.iterdir()}
    policy = workspace / "profile/comarmor.d/talker_listener.xml"
    text = policy.read_text()
    assert text.index("/talker") < text.index("/chatter") < text.index("/listener")
    policy.write_text(text.replace("/chatter", "/chat", 1))
    for verb in (["create", "--all"], ["build"], ["install"], ["check"]):
        environment.keymint(*verb, "-w", workspace)
    after = {path.name: path.read_bytes() for path in enclave.iterdir()}
    assert {name for name in before if before[name] != after[name]} == {"access.json.p7s"}
    assert b'"/chat"' in after["access.json.p7s"]


def test_without_the_plugin_its_packages_are_an_error(installed: Environment, workspace: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(workspace, tmp_path / "ws", symlinks=True)
    said = installed.keymint("build", "-w", copy, code=1)
    assert f"no build type '{THEIRS}' is installed" in said


BROKEN = {
    "major": (
        "class Type:\n    API = '1.0'\nbuild_type = Type()\n",
        (
            "the build type 'broken' (broken_plugin:build_type) implements version '1.0' of the plugin interface, "
            "this Keymint needs '3.0'"
        ),
        "install a version of broken-plugin for this Keymint, or change its code as docs/migrating-plugins.md says",
    ),
    "import": (
        "import there_is_no_such_module\n",
        (
            "the build type 'broken' (broken_plugin:build_type) fails to load: "
            "ModuleNotFoundError: No module named 'there_is_no_such_module'"
        ),
        "reinstall broken-plugin",
    ),
}


@pytest.mark.parametrize(("source", "message", "mend"), BROKEN.values(), ids=BROKEN)
def test_the_error_of_an_unusable_plugin_names_it(
    environment: Environment, workspace: Path, source: str, message: str, mend: str, tmp_path: Path
) -> None:
    broken = install_broken(environment, source, tmp_path)
    report = broken.report("plugins", code=1)
    (said,) = report["diagnostics"]
    assert (said["message"], said["help"]) == (message, mend)
    usable = {plugin["name"]: plugin["usable"] for plugin in report["result"]["plugins"]}
    assert usable.pop("broken") is False
    assert all(usable.values())

    copy = shutil.copytree(workspace, tmp_path / "ws", symlinks=True)
    choose(copy, "listener", "broken")
    before = state(copy)
    failed = broken.report("build", "-w", copy, code=1)
    assert [item["message"] for item in failed["diagnostics"]] == [message]
    assert state(copy) == before


def install_broken(environment: Environment, source: str, folder: Path) -> Environment:
    """Return the environment with another distribution, unpacked into its own folder."""
    (folder / "broken_plugin.py").write_text(source)
    metadata = folder / "broken_plugin-3.4.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-plugin\nVersion: 3.4\n")
    (metadata / "entry_points.txt").write_text("[keymint.build_types]\nbroken = broken_plugin:build_type\n")
    return Environment(environment.folder, environment.cwd, {"PYTHONPATH": os.fspath(folder)})
