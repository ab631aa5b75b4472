# SPDX-License-Identifier: Apache-2.0
"""Documents of another tool are kept for as long as they mean what the sources say."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.keystores.kept_documents import not_kept

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.api import BuildOptions, Package
from keymint.ir import Rule
from tests.plugins.keymint_ros2_dds.packages import package

XML = "permissions.xml"


def built(subject: Package, **kept: bytes) -> bytes:
    documents = {name.replace("_", "."): content for name, content in kept.items()}
    return build_type.build(replace(subject, kept=documents), BuildOptions()).documents[XML]


@pytest.fixture
def subject() -> Package:
    rule = Rule(
        Effect.ALLOW, "ros_topic", ("ros_publish",), ("/chatter",), (), audit=False, origin=Origin("policy.xml", 1)
    )
    return package(rule)


@pytest.fixture
def other(subject: Package) -> bytes:
    """The same document, written in another way."""
    return built(subject).replace(b"  ", b"\t")


def test_a_document_with_the_same_meaning_is_kept_to_the_last_byte(subject: Package, other: bytes) -> None:
    assert other != built(subject)
    assert built(subject, permissions_xml=other) == other


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"<not_after>2", b"<not_after>3", "it is valid from"),
        (b"<default>DENY", b"<default>ALLOW", "it allows by default"),
        (b"<subject_name>", b"<subject_name>X", "it is for"),
        (b"<topic>rt/", b"<topic>rt/x", "it "),
        (b"</permissions>", b"", "XML"),
    ],
)
def test_another_document_is_not(subject: Package, other: bytes, old: bytes, new: bytes, reason: str) -> None:
    assert old in other
    changed = other.replace(old, new, 1)
    assert built(subject, permissions_xml=changed) == built(subject)
    assert not_kept(subject, XML, changed)
    assert reason in not_kept(subject, XML, changed) or reason == "XML"


def test_a_governance_is_compared_by_its_rules(subject: Package) -> None:
    def governance(kept: bytes) -> bytes:
        return build_type.build(replace(subject, kept={"governance.xml": kept}), BuildOptions()).documents[
            "governance.xml"
        ]

    ours = build_type.build(subject, BuildOptions()).documents["governance.xml"]
    same = ours.replace(b"  ", b"\t")
    assert governance(same) == same != ours
    assert governance(ours.replace(b"ENCRYPT", b"NONE", 1)) == ours
    assert governance(b"no document") == ours
