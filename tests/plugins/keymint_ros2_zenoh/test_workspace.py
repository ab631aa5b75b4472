# SPDX-License-Identifier: Apache-2.0
"""A workspace for Zenoh from the policy to the installed files, through the command line."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from keymint_ros2_zenoh.documents.configuration_reader import read

from tests.conftest import CHECKOUT

ENCLAVES = ("listener", "talker", "zenoh_router")


@pytest.fixture
def ws(keymint: Callable, tmp_path: Path) -> Path:
    """Return a workspace with the example policy, installed for Zenoh."""
    folder = tmp_path / "ws"
    for arguments in (["init", folder, "--transport", "zenoh"], ["create", "--all"], ["build"], ["install"]):
        where = [] if arguments[0] == "init" else ["-w", folder]
        assert keymint(*arguments, *where).code == 0
    return folder


def router_file(ws: Path) -> bytes:
    return (ws / "install/zenoh/router.json5").read_bytes()


def subjects(ws: Path) -> list[str]:
    return [each.id for each in read(router_file(ws), "router.json5").access_control.subjects]


def certificate(ws: Path, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((ws / "install/enclaves" / name / "cert.pem").read_bytes())


def test_the_files_of_the_enclaves(ws: Path) -> None:
    common = {"cert.pem", "key.pem", "identity_ca.cert.pem"}
    for name in ENCLAVES:
        files = {path.name for path in (ws / "install/enclaves" / name).iterdir()}
        assert files == (common if name == "zenoh_router" else common | {"session.json5"})
        assert (ws / "install/enclaves" / name / "key.pem").stat().st_mode & 0o777 == 0o600
    session = read((ws / "install/enclaves/talker/session.json5").read_bytes(), "session.json5")
    assert session.connect_certificate == str(ws / "install/enclaves/talker/cert.pem")


def test_certificates_of_nodes_are_for_clients_and_that_of_the_router_for_servers(ws: Path) -> None:
    for name in ENCLAVES:
        usage = certificate(ws, name).extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        is_router = name == "zenoh_router"
        assert list(usage) == [ExtendedKeyUsageOID.SERVER_AUTH if is_router else ExtendedKeyUsageOID.CLIENT_AUTH]
    names = certificate(ws, "zenoh_router").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost"]


def test_check_and_status_have_nothing_to_say(ws: Path, keymint: Callable) -> None:
    assert keymint("check", "-w", ws).code == 0
    rows = keymint("status", "-w", ws, "--json").document["result"]["packages"]
    assert {row["package"]: row["stage"] for row in rows} == dict.fromkeys(ENCLAVES, "installed")
    assert not any(row["stale"] for row in rows)


@pytest.mark.parametrize(("verb", "code"), [("build", "layout-unsupported"), ("install", "layout-unknown")])
def test_a_layout_without_a_place_for_configurations(ws: Path, keymint: Callable, verb: str, code: str) -> None:
    profile = ws / "profile/keymint_profile.xml"
    profile.write_text(profile.read_text().replace("<layout>sros2<", "<layout>flat<"))
    outcome = keymint(verb, "-w", ws, "--json")
    assert outcome.code == 1
    assert {each["code"] for each in outcome.document["diagnostics"]} == {code}


def contents(ws: Path) -> dict[Path, bytes]:
    """Return all files but the recorded answers to commands."""
    return {path: path.read_bytes() for path in ws.rglob("*") if path.is_file() and not path.name.startswith("last-")}


def test_a_second_run_changes_nothing(ws: Path, keymint: Callable) -> None:
    before = contents(ws)
    for verb in ("build", "install"):
        assert keymint(verb, "-w", ws).code == 0
    assert contents(ws) == before


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_openssl_verifies_the_signature_of_the_router_file(ws: Path) -> None:
    options = ["-binary", "-no_check_time", "-inform", "DER", "-in", "install/zenoh/router.json5.p7s"]
    files = ["-content", "install/zenoh/router.json5", "-CAfile", "public/permissions_ca.cert.pem", "-out", os.devnull]
    subprocess.run(["openssl", "cms", "-verify", *options, *files], cwd=ws, capture_output=True, check=True)


def test_all_claims_are_proven(ws: Path, keymint: Callable) -> None:
    proof = keymint("prove", "-w", ws, "--json")
    assert proof.code == 0
    result = proof.document["result"]
    assert {each["subject"]: each["proof"] for each in result["enclaves"]} == dict.fromkeys(
        ("/listener", "/talker", "/zenoh_router"), "proven"
    )
    assert [each["proof"] for each in result["shared"]] == ["proven"]


def test_another_policy_changes_the_router_file_and_no_session(ws: Path, keymint: Callable) -> None:
    before, sessions = router_file(ws), {name: _session(ws, name) for name in ("talker", "listener")}
    policy = ws / "profile/comarmor.d/talker_listener.xml"
    policy.write_text(policy.read_text().replace("/chatter", "/gossip"))
    for arguments in (["create", "--all"], ["build"], ["install"]):
        assert keymint(*arguments, "-w", ws).code == 0
    assert router_file(ws) != before
    assert b"/gossip/" in router_file(ws)
    assert b"/chatter/" not in router_file(ws)
    assert {name: _session(ws, name) for name in sessions} == sessions
    assert keymint("check", "-w", ws).code == 0


def _session(ws: Path, name: str) -> bytes:
    return (ws / "install/enclaves" / name / "session.json5").read_bytes()


def test_a_removed_package_has_no_rights_left(ws: Path, keymint: Callable) -> None:
    assert subjects(ws) == ["/listener", "/talker"]
    shutil.rmtree(ws / "src/talker")
    assert keymint("build", "-w", ws).code == 0
    assert keymint("install", "-w", ws, "--prune").code == 0
    assert subjects(ws) == ["/listener"]
    assert not (ws / "install/enclaves/talker").exists()


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b'"default_permission": "deny"', b'"default_permission": "allow"', "zenoh-default"),
        (b', "cert_common_names": ["/talker"]', b"", "zenoh-wildcard-subject"),
        (b"{", b"{ // as before", "zenoh-signature"),
    ],
)
def test_an_altered_router_file_is_found(ws: Path, keymint: Callable, old: bytes, new: bytes, code: str) -> None:
    path = ws / "install/zenoh/router.json5"
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    found = keymint("check", "-w", ws, "--json")
    assert found.code == 3
    assert {code, "zenoh-signature"} <= set(found.codes())
    assert keymint("prove", "-w", ws).code == 3


def test_another_host_gives_the_router_another_certificate(ws: Path, keymint: Callable) -> None:
    defaults = ws / "profile/package.defaults/zenoh.xml"
    defaults.write_text(defaults.read_text().replace("<host>localhost<", "<host>10.0.0.7<"))
    for verb in ("build", "install"):
        assert keymint(verb, "-w", ws).code == 0
    names = certificate(ws, "zenoh_router").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(each) for each in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.7"]
    assert read(_session(ws, "talker"), "session.json5").connect == ("tls/10.0.0.7:7447",)
    assert keymint("check", "-w", ws).code == 0


def test_both_transports_share_an_enclave(keymint: Callable, tmp_path: Path) -> None:
    ws = tmp_path / "both"
    policy = CHECKOUT / "examples/fleet/fleet.xml"
    assert keymint("provision", policy, "-w", ws, "--transport", "dds", "--transport", "zenoh").code == 0
    files = {path.name for path in (ws / "install/enclaves/robot1/base").iterdir()}
    assert {"session.json5", "permissions.p7s", "governance.p7s", "cert.pem", "key.pem"} <= files
    assert keymint("check", "-w", ws).code == 0


def test_the_rule_that_is_left_out_for_all_is_noted_once(ws: Path, keymint: Callable) -> None:
    found = keymint("build", "-f", "-w", ws, "--json").document["diagnostics"]
    [note] = [each for each in found if each["code"] == "zenoh-infrastructure"]
    assert (Path(note["file"]).name, note["line"]) == ("graph.xml", 4)


def test_another_router_needs_another_package(ws: Path, keymint: Callable) -> None:
    """What happens between the steps that the message names is shown by status, with a name in each row."""
    defaults = ws / "profile/package.defaults/zenoh.xml"
    defaults.write_text(defaults.read_text().replace("<name>zenoh_router<", "<name>fleet/router<"))
    outcome = keymint("build", "-w", ws)
    assert outcome.code == 1
    assert f"remove the package's folder, then run 'keymint create --all -w {ws}'" in outcome.err
    shown = keymint("status", "-w", ws).out
    assert [line.split()[0] for line in shown.splitlines()[1:6]] == [
        "fleet/router", "listener", "talker", "zenoh_router", "shared",
    ]  # fmt: skip
    assert "talker: ws/profile/package.defaults/zenoh.xml:" in shown
    shutil.rmtree(ws / "src/zenoh_router")
    for verb in (["create", "--all"], ["build"], ["install", "--prune"], ["check"]):
        outcome = keymint(*verb, "-w", ws)
        assert outcome.code == 0, outcome.err
    assert [folder.name for folder in sorted((ws / "install/enclaves").iterdir())] == ["fleet", "listener", "talker"]


def test_zenoh_is_added_to_a_workspace_for_dds_as_its_page_says(keymint: Callable, tmp_path: Path) -> None:
    """The commands on the page lead to what a new workspace for both has; keys and documents for DDS stay."""
    text = (CHECKOUT / "docs/zenoh.md").read_text()
    [commands] = re.findall(r"## Add Zenoh .*?```sh\n(.*?)```", text, re.DOTALL)
    example = CHECKOUT / "examples/fleet"
    ws, new = tmp_path / "ws", tmp_path / "new"
    assert keymint("provision", example, "-w", ws).code == 0
    before = {path: path.read_bytes() for path in ws.rglob("*") if path.name in {"key.pem", "permissions.xml"}}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["/bin/sh", "-e"],
        input=commands,
        cwd=ws,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert before == {path: path.read_bytes() for path in before}
    assert keymint("provision", example, "-w", new, "--transport", "dds", "--transport", "zenoh").code == 0
    for folder in ("install", "build"):
        assert names(ws / folder) == names(new / folder)
    assert router_file(ws) == router_file(new).replace(bytes(new), bytes(ws))
    for verb in (
        ["check"],
        ["prove"],
        ["provision", example],
        ["init", ws, "--transport", "zenoh", "--transport", "dds"],
    ):
        outcome = keymint(*verb, *([] if verb[0] == "init" else ["-w", ws]))
        assert outcome.code == 0, outcome.err


def names(folder: Path) -> set[Path]:
    return {path.relative_to(folder) for path in folder.rglob("*")}
