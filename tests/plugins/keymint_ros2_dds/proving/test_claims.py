# SPDX-License-Identifier: Apache-2.0
"""What was proven of the bytes of a document is not proven again in a run; what was not is asked again."""

from __future__ import annotations

from unittest import mock

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.proving.claims import prove_content

from keymint.api import BuildOptions, ComparisonTask, DomainRange, Proof
from tests.plugins.keymint_ros2_dds.packages import package, rule

LOADED = package(rule("ALLOW", "ros_topic", "ros_publish", "/once"))


def proven(document: bytes, *, models=None, **fields):
    usual = {
        "file": "permissions.xml",
        "offset": 0,
        "subject_name": "CN=/talker,OU=x1",
        "rules": LOADED.grant.rules,
        "distro": "jazzy",
        "domains": LOADED.grant.domains,
        "states": 1000,
        "go_on": lambda: True,
    }
    return prove_content(ComparisonTask(document, **{**usual, **fields}), models=models)


@pytest.fixture
def document() -> bytes:
    return build_type.build(LOADED, BuildOptions()).documents["permissions.xml"]


def test_what_was_built_is_known_when_it_is_installed(document: bytes) -> None:
    with mock.patch("keymint_ros2_dds.proving.claims.prove_document", side_effect=AssertionError("asked again")):
        claims = proven(document)
    assert {claim.proof for claim in claims} == {Proof.PROVEN}


@pytest.mark.parametrize(
    "fields",
    [
        {"rules": package(rule("ALLOW", "ros_topic", "ros_publish", "/other")).grant.rules},
        {"subject_name": "CN=/talker,OU=x2"},
        {"domains": (DomainRange(0, 1),)},
        {"distro": "ardent"},
    ],
    ids=lambda fields: next(iter(fields)),
)
def test_another_question_is_asked(document: bytes, fields) -> None:
    assert {claim.proof for claim in proven(document, **fields)} != {Proof.PROVEN}


def test_another_document_is_asked_about(document: bytes) -> None:
    assert {claim.proof for claim in proven(document.replace(b"rt/once", b"rt/twice"))} != {Proof.PROVEN}


def test_models_are_asked_each(document: bytes) -> None:
    assert {claim.model for claim in proven(document, models=("omg",))} == {"omg"}


def test_what_was_refuted_is_not_remembered(document: bytes) -> None:
    altered = document.replace(b"rt/once", b"rt/twice")
    assert any(claim.proof is Proof.COUNTEREXAMPLE for claim in proven(altered))
    with mock.patch("keymint_ros2_dds.proving.claims.prove_document", return_value=()) as prove:
        proven(altered)
    prove.assert_called_once()
