# SPDX-License-Identifier: Apache-2.0
"""Findings on an installed governance that opens topics or protects less than its sources."""

from __future__ import annotations

import pytest
from keymint_ros2_dds import build_type

from comarmor.errors import Diagnostic
from keymint.api import Package
from keymint.pki import smime
from tests.plugins.keymint_ros2_dds.builds import CHATTER
from tests.plugins.keymint_ros2_dds.enclaves import authority, inspection, installed
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed, package, protection

TALKER = package(CHATTER)


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    return installed(TALKER)


def edited(files: dict[str, bytes], old: str, new: str) -> tuple[list[Diagnostic], bytes]:
    """Return the findings on an enclave whose governance was edited and signed again, and what is signed."""
    ca = authority("permissions_ca")
    content = smime.read(files["governance.p7s"], ca.pem).content
    assert old.encode() in content
    signed = smime.sign(content.replace(old.encode(), new.encode(), 1), ca.certificate, ca.key)
    return findings(TALKER, {**files, "governance.p7s": signed}), signed


def findings(loaded: Package, files: dict[str, bytes]) -> list[Diagnostic]:
    return [each for each in build_type.check(inspection(loaded, files)) if each.code.startswith("governance")]


def test_what_was_just_installed_has_none(files: dict[str, bytes]) -> None:
    assert findings(TALKER, files) == []


@pytest.mark.parametrize(
    ("tag", "old", "new", "scope"),
    [
        ("enable_join_access_control", "true", "false", ""),
        ("allow_unauthenticated_participants", "false", "true", ""),
        ("rtps_protection_kind", "SIGN", "NONE", ""),
        ("enable_read_access_control", "true", "false", " for "),
        ("metadata_protection_kind", "ENCRYPT", "SIGN", " for "),
        ("data_protection_kind", "ENCRYPT", "NONE", " for "),
    ],
)
def test_what_protects_less_is_found_with_its_line(
    files: dict[str, bytes], tag: str, old: str, new: str, scope: str
) -> None:
    (finding,), signed = edited(files, f"<{tag}>{old}<", f"<{tag}>{new}<")
    assert (finding.code, finding.severity, finding.subject) == ("governance-weaker", "error", "/talker")
    assert finding.message.startswith(f"{tag} is {new}{scope}")
    assert finding.message.endswith(f"but the sources require {old}")
    line = signed.splitlines()[finding.where.line - 1]
    assert f"<{tag}>".encode() in line or (scope and b"<topic_rule>" in line)


@pytest.mark.parametrize(
    ("tag", "old", "new"),
    [
        ("rtps_protection_kind", "SIGN", "ENCRYPT"),
        ("rtps_protection_kind", "SIGN", "ENCRYPT_WITH_ORIGIN_AUTHENTICATION"),
    ],
)
def test_what_protects_more_is_none(files: dict[str, bytes], tag: str, old: str, new: str) -> None:
    found, _ = edited(files, f"<{tag}>{old}<", f"<{tag}>{new}<")
    assert found == []


def test_an_expression_that_vendors_read_differently_is_unread(files: dict[str, bytes]) -> None:
    (finding,), _ = edited(files, "<topic_expression>*<", "<topic_expression>[[:nope:]]<")
    assert finding.code == "governance-unread"


def test_what_the_sources_open_is_found_without_the_document(files: dict[str, bytes]) -> None:
    open_ = domain_rule(protection(enable_write_access_control=False))
    loaded = governed(TALKER, domain_rules=(open_,))
    found = findings(loaded, installed(loaded))
    assert [(each.code, each.severity) for each in found] == [("governance-open", "warning")]
