# SPDX-License-Identifier: Apache-2.0
"""An install space written by Keymint, in real participants: they behave as the policy decides."""

from __future__ import annotations

import shutil
import time
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import DeniedError, ProbeEndpoint, RefusedError, System

from .probe_commands import await_rejection
from .provisioning import enclave

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

POLICY = """\
<profiles>
  <profile name="talker">
    <attachment>/talker</attachment>
    <ros_topic qualifier="ALLOW">
      <attachments><attachment>/chatter</attachment><attachment>/log/*</attachment></attachments>
      <permissions><ros_publish/></permissions>
    </ros_topic>
    <ros_topic qualifier="DENY">
      <attachment>/log/private</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
    <ros_service qualifier="ALLOW">
      <attachment>/add_two_ints</attachment>
      <permissions><ros_call/></permissions>
    </ros_service>
  </profile>
  <profile name="listener">
    <attachment>/listener</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment>
      <permissions><ros_subscribe/></permissions>
    </ros_topic>
    <ros_service qualifier="ALLOW">
      <attachment>/add_two_ints</attachment>
      <permissions><ros_execute/></permissions>
    </ros_service>
  </profile>
  <profile name="below the talker">
    <attachment>/talker/below</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/below</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""


@pytest.fixture(scope="module")
def install(provisioned: Callable[[str], Path]) -> Path:
    return provisioned(POLICY)


@pytest.fixture(scope="module")
def foreign(provisioned: Callable[[str], Path]) -> Path:
    """The same policy in a system with its own authorities."""
    return provisioned(POLICY)


@pytest.fixture
def copied(install: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Copy a single enclave to a folder that a test may change."""
    return lambda subject: shutil.copytree(enclave(install, subject), tmp_path / "enclave")


def test_talker_and_listener_exchange_samples(install: Path, system: System) -> None:
    reader = system.open(enclave(install, "/listener")).edge("subscribe", "rt/chatter")
    writer = system.open(enclave(install, "/talker")).edge("publish", "rt/chatter")
    for text in ("hello", "world"):
        writer.write(text)
        assert reader.read() == text


def test_client_and_server_exchange_request_and_reply(install: Path, system: System) -> None:
    client = system.open(enclave(install, "/talker"))
    server = system.open(enclave(install, "/listener"))
    ends: tuple[tuple[str, str, str], ...] = (
        ("publish", "subscribe", "rq/add_two_intsRequest"),
        ("subscribe", "publish", "rr/add_two_intsReply"),
    )
    for at_client, at_server, topic in ends:
        edges = {at_client: client.edge(at_client, topic), at_server: server.edge(at_server, topic)}
        edges["publish"].write(topic)
        assert edges["subscribe"].read() == topic


def test_an_enclave_works_as_a_single_copy(install: Path, system: System, copied: Callable[[str], Path]) -> None:
    reader = system.open(copied("/listener")).edge("subscribe", "rt/chatter")
    system.open(enclave(install, "/talker")).edge("publish", "rt/chatter").write("hello")
    assert reader.read() == "hello"


def test_a_writer_on_a_denied_topic_is_refused(install: Path, system: System) -> None:
    talker = system.open(enclave(install, "/talker"))
    talker.edge("publish", "rt/log/public")
    with pytest.raises(DeniedError):
        talker.edge("publish", "rt/log/private")


@pytest.mark.parametrize(
    ("subject", "direction", "topic"),
    [
        ("/talker", "subscribe", "rt/chatter"),
        ("/talker", "publish", "rt/elsewhere"),
        ("/talker", "publish", "rr/add_two_intsReply"),
        ("/listener", "publish", "rt/chatter"),
        ("/listener", "subscribe", "rt/log/public"),
        ("/talker/below", "publish", "rt/chatter"),
        ("/talker/below", "subscribe", "rt/chatter"),
    ],
)
def test_an_enclave_without_the_permission_is_refused(
    install: Path, system: System, subject: str, direction: str, topic: str
) -> None:
    participant = system.open(enclave(install, subject))
    with pytest.raises(DeniedError):
        participant.edge(direction, topic)


def test_a_partition_that_the_policy_does_not_name_is_refused(install: Path, system: System) -> None:
    with pytest.raises(DeniedError):
        system.open(enclave(install, "/talker")).edge("publish", "rt/chatter", ["elsewhere"])


def test_a_certificate_of_another_authority_cannot_join(
    foreign: Path, system: System, copied: Callable[[str], Path]
) -> None:
    folder = copied("/talker")
    for file in ("cert.pem", "key.pem"):
        shutil.copy(enclave(foreign, "/talker") / file, folder / file)
    with pytest.raises(RefusedError):
        system.open(folder)


@pytest.mark.parametrize("file", ["permissions.p7s", "governance.p7s"])
def test_documents_signed_by_another_authority_are_refused(
    foreign: Path, system: System, copied: Callable[[str], Path], file: str
) -> None:
    folder = copied("/talker")
    shutil.copy(enclave(foreign, "/talker") / file, folder / file)
    with pytest.raises(RefusedError):
        system.open(folder)


def test_a_complete_foreign_enclave_never_matches(install: Path, foreign: Path, system: System) -> None:
    reader = system.open(enclave(install, "/listener")).edge("subscribe", "rt/chatter")
    writer = system.open(enclave(foreign, "/talker")).edge("publish", "rt/chatter")
    assert rejected(reader, writer)
    writer.write("hello")
    assert reader.read(seconds=0.3) is None


@pytest.mark.parametrize(("thief", "owner"), [("/talker", "/talker/below"), ("/talker/below", "/talker")])
def test_the_permissions_of_another_enclave_are_refused(
    install: Path, system: System, copied: Callable[[str], Path], thief: str, owner: str
) -> None:
    folder = copied(thief)
    shutil.copy(enclave(install, owner) / "permissions.p7s", folder / "permissions.p7s")
    with pytest.raises(RefusedError):
        system.open(folder)


def test_edited_permissions_are_refused(system: System, copied: Callable[[str], Path]) -> None:
    signed = copied("/talker") / "permissions.p7s"
    content = signed.read_bytes()
    edited = content.replace(b"rt/chatter", b"rt/elsewhr")
    assert edited != content
    signed.write_bytes(edited)
    with pytest.raises(RefusedError):
        system.open(signed.parent)


def rejected(*edges: ProbeEndpoint) -> bool:
    """Wait until one end reports that it rejects the other; no end may match meanwhile."""
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        if any(await_rejection(edge, 0.05) for edge in edges):
            return True
    return False
