# SPDX-License-Identifier: Apache-2.0
"""The diagnostics about the claims of an import."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from keymint.api import Claim, Comparison, ImportedPolicy, ImportedSubject, Proof
from keymint.commands.exchange.import_policy import diagnostics_of, is_same, proofs_of
from keymint.errors import KeymintError
from keymint.ir import SubjectRules


def claim(model: str, proof: Proof = Proof.PROVEN) -> Claim:
    return Claim(model, "publish", (), "all names", proof, "" if proof is Proof.PROVEN else "the limit was reached")


def proof(theirs: Proof, ours: Proof, vendor: Proof = Proof.PROVEN) -> Comparison:
    claims = claim("standard", theirs), claim("vendor", vendor)
    return Comparison(claims, (claim("standard", ours),), ())


def proofs(theirs: Proof, ours: Proof, *, deviates: bool = False) -> Mapping[str, Comparison]:
    compared = proof(theirs, ours)
    reader = SimpleNamespace(compare=lambda *_arguments: compared)
    plugins = SimpleNamespace(build_type=lambda _name: SimpleNamespace(keystores=reader))
    run: Any = SimpleNamespace(plugins=plugins, setting=SimpleNamespace(monotonic=lambda: 0.0))
    tool: Any = SimpleNamespace(BUILD_TYPE="any", TOOL="Other")
    subject = ImportedSubject(SubjectRules("/a", ()), b"", "CN=/a", deviates)
    return proofs_of(run, tool, ImportedPolicy(b"", (subject,), ()), "jazzy")


def test_both_documents_must_be_proven_by_the_standard() -> None:
    yes, no = Proof.PROVEN, Proof.UNKNOWN
    assert is_same(proof(yes, yes))
    assert is_same(proof(yes, yes, no))
    assert not is_same(proof(no, yes))
    assert not is_same(proof(yes, no))


def test_what_is_unknown_is_an_error_unless_it_was_accepted() -> None:
    with pytest.raises(KeymintError) as refused:
        proofs(Proof.UNKNOWN, Proof.PROVEN)
    (found,) = refused.value.diagnostics
    assert found.code == "import-unproven"
    assert found.message.endswith("permits: standard, publish: the limit was reached")
    assert len(proofs(Proof.UNKNOWN, Proof.PROVEN, deviates=True)) == 1
    with pytest.raises(KeymintError):
        proofs(Proof.PROVEN, Proof.UNKNOWN, deviates=True)


def test_nothing_is_said_about_what_is_proven() -> None:
    assert list(diagnostics_of(proofs(Proof.PROVEN, Proof.PROVEN), "Other")) == []
