# SPDX-License-Identifier: Apache-2.0
"""Sizes and settings that vendors do not support."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from keymint_ros2_dds import build_type, vendor_limits

from benchmarks import navigation
from comarmor.errors import Severity
from keymint.api import KeySpec
from keymint.errors import KeymintError
from keymint.pki import smime
from tests.plugins.keymint_ros2_dds.builds import CHATTER, LENIENT, STRICT, build, codes
from tests.plugins.keymint_ros2_dds.packages import package, rule


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("navigation") / "policy.xml"
    path.write_text(navigation.policy())
    return path


def test_the_policy_of_a_navigation_stack_fits(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    """One enclave for a dozen nodes: 70 kB before, and vendors were seen to fail at 67 kB."""
    outcome = keymint("provision", policy, "-w", "ws", "--json")
    assert outcome.code == 0
    assert {"compile-unproven", "rewriting-unproven"}.isdisjoint(outcome.codes())
    enclave = tmp_path / "ws/install/enclaves/navigation"
    signed, content = ((enclave / name).read_bytes() for name in ("permissions.p7s", "permissions.xml"))
    assert len(set(re.findall(b"<topic>(.*)</topic>", content))) > 600
    assert len(signed) < 60_000
    assert smime.unwrap(signed).content == content, "what is signed is what lies beside it"
    assert content.count(b"\n") > content.count(b"<topic>"), "a line for each"
    (said,) = (found for found in outcome.document["diagnostics"] if found["code"] == "size-permissions")
    (size,) = re.findall(r"about ([\d,]+) bytes", said["message"])
    assert abs(int(size.replace(",", "")) - len(signed)) < 200
    assert vendor_limits.TIGHT < len(signed) < vendor_limits.BROKEN

    why = keymint("why", "/navigation", "ros_publish", "/cmd_vel_smoothed", "-w", "ws", "-i", "omg", "--json")
    (transport,) = why.document["result"]["transports"]
    line = content.splitlines()[transport["rule"]["line"] - 1]
    assert line == b"<publish>", "the criterion that decides, as in a document with blanks"


@pytest.mark.parametrize(
    "key", [KeySpec("ec", "SECP384R1"), KeySpec("rsa", size=3072), KeySpec("rsa", size=4096)], ids=str
)
def test_keys_that_a_vendor_refuses(key):
    loaded = package(CHATTER)
    odd = replace(loaded, identity=replace(loaded.identity, key=key))
    with pytest.raises(KeymintError) as caught:
        build_type.build(odd, STRICT)
    assert codes(caught.value.diagnostics) == ["portability-key"]
    assert codes(build_type.build(odd, LENIENT).diagnostics) == ["portability-key"]


def test_rsa_with_2048_bits_is_fine():
    loaded = package(CHATTER)
    rsa = replace(loaded, identity=replace(loaded.identity, key=KeySpec("rsa", size=2048)))
    assert build_type.build(rsa, STRICT).diagnostics == ()


def test_a_large_document_is_a_warning_that_says_why():
    many = rule(
        "ALLOW", "ros_topic", "ros_publish", *(f"/robot/topic_number_{n * n * 7919}" for n in range(1300)), line=21
    )
    (found,) = build(CHATTER, many).diagnostics
    assert (found.code, found.severity, found.where.line) == ("size-permissions", Severity.WARNING, 21)
    assert "ALLOW ros_topic" in found.message


@pytest.mark.parametrize(
    ("subject", "name", "accepted"),
    [
        ("/", "CN=/", False),
        ("/", "CN=/,OU=x1", True),
        ("/", "CN=root", True),
        ("/talker", "CN=/talker", True),
    ],
)
def test_the_root_enclave_needs_a_name_of_its_own(subject: str, name: str, accepted: bool) -> None:
    loaded = package(CHATTER, subject=subject, name=name)
    found = list(vendor_limits.check_root_name(loaded, allow_vendor_specific=False))
    assert [each.code for each in found] == ([] if accepted else ["portability-root-name"])
    lenient = vendor_limits.check_root_name(loaded, allow_vendor_specific=True)
    assert [each.severity for each in lenient] == ([] if accepted else [Severity.WARNING])
    kept = vendor_limits.check_root_name(replace(loaded, kept={"permissions.xml": b"x"}), allow_vendor_specific=False)
    assert [each.severity for each in kept] == ([] if accepted else [Severity.WARNING])
