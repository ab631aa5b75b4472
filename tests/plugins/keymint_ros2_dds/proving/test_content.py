"""What was proven of the bytes of a document is not proven again in a run; what was not is asked again."""

from __future__ import annotations

from unittest import mock

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.proving import Content, content, prove_content

from keymint.api import BuildOptions, DomainRange, Proof
from tests.plugins.keymint_ros2_dds.packages import package, rule

LOADED = package(rule("ALLOW", "ros_topic", "ros_publish", "/once"))


def asked(document: bytes, loaded=LOADED, **fields) -> Content:
    usual = {
        "content": document,
        "file": "permissions.xml",
        "offset": 0,
        "subject_name": "CN=/talker,OU=x1",
        "rules": loaded.permissions.rules,
        "distro": "jazzy",
        "domains": loaded.permissions.domains,
        "states": 1000,
        "go_on": lambda: True,
    }
    return Content(**{**usual, **fields})


@pytest.fixture
def document() -> bytes:
    content._proven.clear()
    return build_type.build(LOADED, BuildOptions()).documents["permissions.xml"]


def test_what_was_built_is_known_when_it_is_installed(document: bytes) -> None:
    with mock.patch.object(content, "prove_document", side_effect=AssertionError("asked again")):
        claims = prove_content(asked(document))
    assert {claim.proof for claim in claims} == {Proof.PROVEN}


@pytest.mark.parametrize(
    "fields",
    [
        {"rules": package(rule("ALLOW", "ros_topic", "ros_publish", "/other")).permissions.rules},
        {"subject_name": "CN=/talker,OU=x2"},
        {"domains": (DomainRange(0, 1),)},
        {"distro": "ardent"},
        {"content": b""},
    ],
    ids=lambda fields: next(iter(fields)),
)
def test_another_question_is_asked(document: bytes, fields) -> None:
    altered = document.replace(b"rt/once", b"rt/twice")
    other = asked(document, **{**fields, **({"content": altered} if "content" in fields else {})})
    assert {claim.proof for claim in prove_content(other)} != {Proof.PROVEN}


def test_models_are_asked_each(document: bytes) -> None:
    assert {claim.model for claim in prove_content(asked(document), models=("omg",))} == {"omg"}


def test_what_was_refuted_is_not_remembered(document: bytes) -> None:
    wrong = asked(document.replace(b"rt/once", b"rt/twice"))
    known = dict(content._proven)
    assert any(claim.proof is Proof.COUNTEREXAMPLE for claim in prove_content(wrong))
    assert content._proven == known
