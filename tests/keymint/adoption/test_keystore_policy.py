# SPDX-License-Identifier: Apache-2.0
"""A policy is learned from a keystore only if it is proven to mean what the documents mean."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_sros2 import policy_type as sros2

from comarmor.errors import Diagnostic, Severity
from keymint.adoption.keystore_files import found_in
from keymint.adoption.keystore_policy import Learning, learned_from
from keymint.api import DocumentComparison, FoundKeystore, KeystoreFiles, Relation
from keymint.errors import KeymintError
from keymint.examine.adopted_documents import unclear_rights
from keymint.stages.proof_results import ProofEffort
from tests import sros2_keystore
from tests.conftest import installed_plugins

POLICY = """<policy version="0.2.0"><enclaves><enclave path="/a"><profiles><profile ns="/" node="a">
<topics publish="ALLOW"><topic>x</topic></topics></profile></profiles></enclave></enclaves></policy>"""
EFFORT = ProofEffort(lambda: 0.0, 10_000)
LEARNING = Learning(build_type.keystores, "keymint_ros2_comarmor", "jazzy", "p.xml", EFFORT)


@pytest.fixture
def keystore(tmp_path: Path) -> tuple[KeystoreFiles, FoundKeystore]:
    sros2_keystore.make(tmp_path / "ks", POLICY)
    _, _, files, found = found_in(installed_plugins(), tmp_path / "ks", "ks", datetime(2026, 6, 1, tzinfo=UTC))
    return files, found


class Stand:
    """Plugins with another policy type."""

    def __init__(self, policy_type: object) -> None:
        self._policy_type = policy_type

    def policy_type(self, name: str) -> object:
        del name
        return self._policy_type


class Comparer:
    """A reader of keystores that finds something else than the real one."""

    def __init__(self, result: DocumentComparison | None = None, **changes: Any) -> None:
        self._real = build_type.keystores
        self._result, self._changes = result, changes

    def granted(self, *arguments: Any) -> object:
        return replace(self._real.granted(*arguments), **self._changes)

    def compared(self, task: Any) -> DocumentComparison:
        return self._result or self._real.compared(task)


def learned(keystore: tuple[KeystoreFiles, FoundKeystore], plugins: object = None, reader: object = None) -> Any:
    learning = replace(LEARNING, reader=reader) if reader else LEARNING
    return learned_from(plugins or installed_plugins(), *keystore, learning, unclear_rights(keystore[1]))


def test_what_is_learned(keystore) -> None:
    document, granted, diagnostics = learned(keystore)
    assert b"<attachment>/x</attachment>" in document
    assert [each.rules.subject for each in granted] == ["/a"]
    assert diagnostics == ()
    assert "PRIVATE" not in repr((granted, diagnostics))


def test_a_policy_that_means_something_else_is_not_returned(keystore) -> None:
    other = sros2_keystore.permissions(
        sros2_keystore.enclaves_of(POLICY.replace("<topic>x", "<topic>y")),
        ("2026-01-01T00:00:00", "2030-01-01T00:00:00"),
    )
    with pytest.raises(KeymintError, match=r"not proven to mean .*: it does not permit publish 'rt/x'"):
        learned(keystore, reader=Comparer(document=other))
    unknown = DocumentComparison(Relation.UNKNOWN, reason="not decided in time")
    with pytest.raises(KeymintError, match="not decided in time"):
        learned(keystore, reader=Comparer(unknown))


def test_a_policy_type_that_cannot_do_it(keystore) -> None:
    with pytest.raises(KeymintError, match="cannot write rules"):
        learned(keystore, Stand(sros2))


def test_findings_on_the_keystore_are_warnings_unless_they_concern_trust(keystore) -> None:
    files, found = keystore
    finding = Diagnostic("adopt-key-mismatch", Severity.ERROR, "is not the key of the certificate beside it")
    assert [each.severity for each in learned((files, replace(found, diagnostics=(finding,))))[2]] == [Severity.WARNING]
    doubled = replace(found, diagnostics=(replace(finding, code="adopt-doubled"),))
    with pytest.raises(KeymintError, match="is not the key"):
        learned((files, doubled))
