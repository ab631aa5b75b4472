# SPDX-License-Identifier: Apache-2.0
"""Which certificates Zenoh admits; tests/real/test_zenoh_admission.py compares with the library."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from keymint_ros2_zenoh import decision

from tests.plugins.keymint_ros2_zenoh.install_spaces import InstallSpace


@pytest.fixture
def space(tmp_path: Path) -> InstallSpace:
    return InstallSpace(tmp_path, {})


def refusal(space: InstallSpace, certificate: bytes, *, server: bool = False, days: float = 0) -> str:
    at = datetime.now(UTC) + timedelta(days=days)
    return decision.refusal(certificate, space.authority, at, server=server)


def test_a_node_and_a_router_are_admitted_in_their_roles_only(space: InstallSpace) -> None:
    node, router = space.issue("/talker")[0], space.issue("router", server=True)[0]
    assert refusal(space, node) == ""
    assert refusal(space, router, server=True) == ""
    assert refusal(space, node, server=True) == "its extended key usage lacks serverAuth"
    assert refusal(space, router) == "its extended key usage lacks clientAuth"


def test_time_authority_and_form_are_checked(space: InstallSpace, tmp_path: Path) -> None:
    node = space.issue("/talker")[0]
    assert "expired" in refusal(space, node, days=20)
    assert refusal(space, node, days=-2)
    assert refusal(InstallSpace(tmp_path, {}), node)
    assert refusal(space, b"no certificate")


def test_an_authority_that_the_file_brings_along_is_not_trusted(space: InstallSpace, tmp_path: Path) -> None:
    stranger = InstallSpace(tmp_path, {})
    assert refusal(space, stranger.issue("/talker")[0] + stranger.authority)


def test_only_the_first_common_name_counts(space: InstallSpace) -> None:
    certificate = x509.load_pem_x509_certificate(space.issue("/talker")[0])
    assert decision.common_name(certificate) == "/talker"


def test_hosts_are_compared_with_alternative_names_only(space: InstallSpace) -> None:
    router = x509.load_pem_x509_certificate(space.issue("robot.local", server=True)[0])
    assert decision.names_host(router, "LOCALHOST")
    assert not decision.names_host(router, "robot.local")
    assert not decision.names_host(router, "127.0.0.1")
    assert not decision.names_host(x509.load_pem_x509_certificate(space.issue("x")[0]), "localhost")


@pytest.mark.parametrize(
    ("name", "host", "fits"),
    [
        ("*.fleet.example", "robot1.fleet.example", True),
        ("*.Fleet.example", "Robot1.fleet.EXAMPLE", True),
        ("*.fleet.example", "deep.robot1.fleet.example", False),
        ("*.fleet.example", "fleet.example", False),
        ("*.local", "robot1.local", False),
        ("*.", "localhost", False),
        ("*", "localhost", False),
        ("r*.fleet.example", "robot1.fleet.example", False),
        ("robot1.*.example", "robot1.fleet.example", False),
        ("*.fleet.example.", "robot1.fleet.example", False),
        ("robot1.local.", "robot1.local", False),
    ],
)
def test_wildcards_of_hosts(space: InstallSpace, name: str, host: str, fits: bool) -> None:
    """As sessions of Zenoh 1.10.2 do, measured with these names for 127.0.0.1."""
    certificate = x509.load_pem_x509_certificate(space.issue("router", server=True, host=name)[0])
    assert decision.names_host(certificate, host) == fits
