# SPDX-License-Identifier: Apache-2.0
"""Documents of another tool: kept while they mean what the sources say, compared with rules, made a source."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.keystores.foreign_documents import governance_source, is_same, not_kept

from comarmor.errors import ComArmorError, Origin
from comarmor.rules import Effect
from keymint.api import BuildOptions, ImportedSubject, Package, Proof, standard_claims
from keymint.ir import Rule, SubjectRules
from tests import sros2_keystore
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


# -- compared with rules, and with what is compiled from them

DOCUMENT = b"""<dds><permissions><grant name="g"><subject_name>CN=/a</subject_name>
<validity><not_before>2020-01-01T00:00:00</not_before><not_after>2030-01-01T00:00:00</not_after></validity>
<allow_rule><domains><id>0</id></domains><publish><topics><topic>rt/x*</topic></topics></publish></allow_rule>
<default>DENY</default></grant></permissions></dds>"""


def imported(*names: str, document: bytes = DOCUMENT) -> ImportedSubject:
    rule = Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), names, (), False, Origin("policy.xml", 3))
    return ImportedSubject(SubjectRules("/a", (rule,)), document, "CN=/a")


def proofs(each: ImportedSubject) -> list[Proof]:
    compared = build_type.keystores.compare(each, "jazzy", 10_000, lambda: True)
    assert {claim.proof for claim in compared.ours} == {Proof.PROVEN}
    assert {claim.model for claim in compared.ours} == {"omg"}
    assert {claim.model for claim in compared.theirs} == {"omg", "cyclonedds-0.10", "fastdds-2.11"}
    return [claim.proof for claim in standard_claims(compared.theirs)]


def test_the_same_meaning_and_another() -> None:
    assert proofs(imported("/x*")) == [Proof.PROVEN, Proof.PROVEN]
    assert proofs(imported("/x", "/x?*")) == [Proof.PROVEN, Proof.PROVEN]
    assert proofs(imported("/x")) == [Proof.COUNTEREXAMPLE, Proof.PROVEN]


def test_the_grant_of_another_subject_does_not_count() -> None:
    other = imported("/x*", document=DOCUMENT.replace(b"CN=/a", b"CN=/b"))
    assert proofs(other) == [Proof.COUNTEREXAMPLE, Proof.PROVEN]


def test_a_rule_that_not_every_vendor_reads_alike_is_a_warning() -> None:
    compared = build_type.keystores.compare(imported("/a\\*"), "jazzy", 10_000, lambda: True)
    assert ("portability-expression", "warning") in {(each.code, each.severity) for each in compared.diagnostics}


def test_an_unreadable_document() -> None:
    with pytest.raises(ComArmorError):
        build_type.keystores.compare(imported("/x", document=b"<dds>"), "jazzy", 10_000, lambda: True)


# -- governance as a source

GOVERNANCE = sros2_keystore.governance(3)


def test_the_source_has_what_the_document_says() -> None:
    source = governance_source(GOVERNANCE, "ca")
    assert source is not None
    text = source.decode()
    assert "<issuer_name>ca</issuer_name>" in text
    assert "<id>3</id>" in text
    assert "<rtps_protection_kind>SIGN</rtps_protection_kind>" in text
    assert "<topic_expression>*</topic_expression>" in text


def test_several_domain_rules_are_no_defaults() -> None:
    rule = GOVERNANCE[GOVERNANCE.index(b"        <domain_rule>") : GOVERNANCE.index(b"    </domain_access_rules>")]
    assert governance_source(GOVERNANCE.replace(rule, rule * 2), "ca") is None


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        (b"        ", b" ", True),
        (b"true", b"1", True),
        (b"<id>3</id>", b"<id>4</id>", False),
        (b"<rtps_protection_kind>SIGN", b"<rtps_protection_kind>NONE", False),
        (b"<enable_read_access_control>true", b"<enable_read_access_control>false", False),
        (b"<topic_expression>*", b"<topic_expression>rt/*", False),
        (b"<enable_liveliness_protection>true", b"<enable_liveliness_protection>false", False),
        (b"<data_protection_kind>ENCRYPT", b"<data_protection_kind>SIGN", False),
    ],
)
def test_documents_are_compared_by_what_they_mean(old: bytes, new: bytes, same: bool) -> None:
    assert old in GOVERNANCE
    assert is_same(GOVERNANCE, GOVERNANCE.replace(old, new)) is same
