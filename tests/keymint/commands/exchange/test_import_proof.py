# SPDX-License-Identifier: Apache-2.0
"""The diagnostics about the claims of an import."""

from __future__ import annotations

from keymint.api import Claim, Comparison, Proof
from keymint.commands.exchange.import_policy import SubjectProof, diagnostics_of, unproven


def claim(model: str, proof: Proof = Proof.PROVEN) -> Claim:
    return Claim(model, "publish", (), "all names", proof, "" if proof is Proof.PROVEN else "the limit was reached")


def proof(theirs: Proof, ours: Proof, vendor: Proof = Proof.PROVEN, *, deviates: bool = False) -> SubjectProof:
    claims = claim("standard", theirs), claim("vendor", vendor)
    return SubjectProof("/a", deviates, Comparison(claims, (claim("standard", ours),), ()))


def test_both_documents_must_be_proven_by_the_standard() -> None:
    yes, no = Proof.PROVEN, Proof.UNKNOWN
    assert proof(yes, yes).is_same
    assert proof(yes, yes, no).is_same
    assert not proof(no, yes).is_same
    assert not proof(yes, no).is_same


def test_what_is_unknown_is_an_error_unless_it_was_accepted() -> None:
    (found,) = unproven([proof(Proof.UNKNOWN, Proof.PROVEN)], "Other")
    assert found.code == "import-unproven"
    assert found.message.endswith("permits: standard, publish: the limit was reached")
    assert unproven([proof(Proof.UNKNOWN, Proof.PROVEN, deviates=True)], "Other") == []
    assert len(unproven([proof(Proof.PROVEN, Proof.UNKNOWN, deviates=True)], "Other")) == 1


def test_nothing_is_said_about_what_is_proven() -> None:
    same = proof(Proof.PROVEN, Proof.PROVEN)
    assert unproven([same], "Other") == []
    assert list(diagnostics_of([same], "Other")) == []
