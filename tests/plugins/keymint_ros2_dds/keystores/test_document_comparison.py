# SPDX-License-Identifier: Apache-2.0
"""Documents of other tools are compared with rules, and with what is compiled from them."""

from __future__ import annotations

import pytest
from keymint_ros2_dds import build_type

from comarmor.errors import ComArmorError, Origin
from comarmor.rules import Effect
from keymint.api import ForeignDocuments, ImportedSubject, Proof, standard_claims
from keymint.ir import Rule, SubjectRules

DOCUMENT = b"""<dds><permissions><grant name="g"><subject_name>CN=/a</subject_name>
<validity><not_before>2020-01-01T00:00:00</not_before><not_after>2030-01-01T00:00:00</not_after></validity>
<allow_rule><domains><id>0</id></domains><publish><topics><topic>rt/x*</topic></topics></publish></allow_rule>
<default>DENY</default></grant></permissions></dds>"""


def subject(*names: str, document: bytes = DOCUMENT) -> ImportedSubject:
    rule = Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), names, (), False, Origin("policy.xml", 3))
    return ImportedSubject(SubjectRules("/a", (rule,)), document, "CN=/a")


def proofs(each: ImportedSubject) -> list[Proof]:
    compared = build_type.compare(each, "jazzy", 10_000, lambda: True)
    assert {claim.proof for claim in compared.ours} == {Proof.PROVEN}
    assert {claim.model for claim in compared.ours} == {"omg"}
    assert {claim.model for claim in compared.theirs} == {"omg", "cyclonedds-0.10", "fastdds-2.11"}
    return [claim.proof for claim in standard_claims(compared.theirs)]


def test_it_has_the_capability() -> None:
    assert isinstance(build_type, ForeignDocuments)


def test_the_same_meaning_and_another() -> None:
    assert proofs(subject("/x*")) == [Proof.PROVEN, Proof.PROVEN]
    assert proofs(subject("/x", "/x?*")) == [Proof.PROVEN, Proof.PROVEN]
    assert proofs(subject("/x")) == [Proof.COUNTEREXAMPLE, Proof.PROVEN]


def test_the_grant_of_another_subject_does_not_count() -> None:
    other = subject("/x*", document=DOCUMENT.replace(b"CN=/a", b"CN=/b"))
    assert proofs(other) == [Proof.COUNTEREXAMPLE, Proof.PROVEN]


def test_a_rule_that_not_every_vendor_reads_alike_is_a_warning() -> None:
    compared = build_type.compare(subject("/a\\*"), "jazzy", 10_000, lambda: True)
    assert ("portability-expression", "warning") in {(each.code, each.severity) for each in compared.diagnostics}


def test_an_unreadable_document() -> None:
    with pytest.raises(ComArmorError):
        build_type.compare(subject("/x", document=b"<dds>"), "jazzy", 10_000, lambda: True)
