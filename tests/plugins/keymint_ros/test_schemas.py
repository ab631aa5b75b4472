# SPDX-License-Identifier: Apache-2.0
"""Two independent validators accept the XSDs; the readers report an error for any broken document."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
import xmlschema
from lxml import etree

from comarmor.data import locate
from comarmor.errors import Diagnostic
from keymint.errors import KeymintError
from tests.effort import tries

from .workspaces import RULES, Workspace

SCHEMAS = sorted(
    path for owner in ("keymint_ros", "keymint_ros2_dds") for path in locate(owner, "schemas").glob("*.xsd")
)
_SCHEMA_OF = {
    "profile/keymint_profile.xml": "keymint_profile",
    "profile/authorities.xml": "authorities",
    "profile/policies.xml": "policies",
    "profile/profile.defaults/authorities.xml": "defaults_authorities",
    "profile/package.defaults/permissions.xml": "defaults_permissions",
    "profile/package.defaults/governance.xml": "source_governance_defaults",
    "profile/package.defaults/identities.xml": "defaults_identities",
    "keymint_package.xml": "keymint_package",
    "permissions.xml": "permissions",
    "governance.xml": "source_governance",
    "identities.xml": "identities",
}
_WORKSPACE = Workspace.new()


def _content(path: str) -> bytes:
    files = _WORKSPACE.profile if path.startswith("profile/") else _WORKSPACE.package
    return files[path.removeprefix("profile/")]


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.stem)
def test_both_validators_accept_a_schema(path: Path) -> None:
    assert xmlschema.XMLSchema10(str(path)).built
    etree.XMLSchema(file=str(path))


@pytest.mark.parametrize(("document", "schema"), _SCHEMA_OF.items())
def test_written_documents_are_valid_for_both_validators(document: str, schema: str) -> None:
    owner = "keymint_ros2_dds" if schema.startswith("source_") else "keymint_ros"
    path = str(locate(owner, "schemas") / f"{schema}.xsd")
    xmlschema.XMLSchema10(path).validate(_content(document).decode())
    assert etree.XMLSchema(file=path).validate(etree.fromstring(_content(document)))


def _mutated(content: bytes, seed: int) -> bytes:
    """Return a document with a few bytes, words or elements changed."""
    random_ = random.Random(seed)
    if seed % 2:
        mutated = bytearray(content)
        for _ in range(random_.randint(1, 4)):
            start = random_.randrange(len(mutated))
            mutated[start : start + random_.randint(0, 3)] = random_.choice(
                [b"", b"<", b"\0", b"&x;", b"{", b"\xff", b"9" * 40]
            )
        return bytes(mutated)
    root = etree.fromstring(content)
    elements = [element for element in root.iter() if isinstance(element.tag, str)]
    for _ in range(random_.randint(1, 3)):
        element = random_.choice(elements)
        parent = element.getparent()
        match random_.randrange(4):
            case 0:
                element.text = random_.choice(["", "{x}", "-1", "9" * 30, "../x", "\u00e4", "P1Y", "1e9"])
            case 1:
                element.set(
                    random_.choice(["name", "critical", "format", "origin"]), random_.choice(["", "x", ":", "1"])
                )
            case 2 if parent is not None:
                parent.remove(element)
            case _ if parent is not None:
                parent.append(element)
    return etree.tostring(root)


@pytest.mark.parametrize("document", _SCHEMA_OF)
def test_a_mutated_document_raises_only_diagnostics(document: str) -> None:
    for seed in range(tries(60, 120)):
        mutated = _mutated(_content(document), seed)
        space = "profile" if document.startswith("profile/") else "package"
        files = {**getattr(_WORKSPACE, space), document.removeprefix("profile/"): mutated}
        workspace = Workspace(**{"profile": _WORKSPACE.profile, "package": _WORKSPACE.package, space: files})
        for attempt in (workspace.load, lambda workspace=workspace: workspace.create(RULES)):
            for diagnostic in _diagnostics(attempt):
                assert "\n" not in str(diagnostic)
                assert diagnostic.where


def _diagnostics(attempt: Callable[[], object]) -> tuple[Diagnostic, ...]:
    try:
        attempt()
    except KeymintError as error:
        return error.diagnostics
    return ()
