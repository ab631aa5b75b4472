# SPDX-License-Identifier: Apache-2.0
"""A workspace for Zenoh from the policy to the installed files, through the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from keymint_ros2_zenoh.documents.read import read

ENCLAVES = ("listener", "talker", "zenoh_router")


@pytest.fixture
def ws(keymint: Callable, tmp_path: Path) -> Path:
    """Return a workspace with the example policy, installed for Zenoh."""
    folder = tmp_path / "ws"
    for arguments in (["init", folder, "--transport", "zenoh"], ["create", "--all"], ["build"], ["install"]):
        where = [] if arguments[0] == "init" else ["-w", folder]
        assert keymint(*arguments, *where).code == 0
    return folder


def certificate(ws: Path, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((ws / "install/enclaves" / name / "cert.pem").read_bytes())


def test_the_files_of_the_enclaves(ws: Path) -> None:
    common = {"cert.pem", "key.pem", "identity_ca.cert.pem"}
    for name in ENCLAVES:
        files = {path.name for path in (ws / "install/enclaves" / name).iterdir()}
        assert files == (common if name == "zenoh_router" else common | {"session.json5"})
        assert (ws / "install/enclaves" / name / "key.pem").stat().st_mode & 0o777 == 0o600
    session = read((ws / "install/enclaves/talker/session.json5").read_bytes(), "session.json5")
    assert session.tls.connect_certificate == str(ws / "install/enclaves/talker/cert.pem")


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


def test_a_second_run_changes_nothing(ws: Path, keymint: Callable) -> None:
    before = {path: path.read_bytes() for path in ws.rglob("*") if path.is_file()}
    for verb in ("build", "install"):
        assert keymint(verb, "-w", ws).code == 0
    assert {path: path.read_bytes() for path in ws.rglob("*") if path.is_file()} == before
