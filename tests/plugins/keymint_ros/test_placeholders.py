# SPDX-License-Identifier: Apache-2.0
"""Placeholders in the distinguished names of authorities and packages."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, strategies as st
from keymint_ros import certificate
from lxml import etree

from keymint.errors import KeymintError

from .workspaces import Workspace, diagnostic_of


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("CN={nme}", "did you mean 'name'?"),
        ("CN={unique}", "{name}"),
        ("CN={name", "{name}"),
        ("CN={name.__class__}", "{name}"),
    ],
)
def test_an_unknown_placeholder_of_an_authority_is_reported(workspace: Workspace, name: str, hint: str) -> None:
    path = "profile/profile.defaults/authorities.xml"
    edited = workspace.edit(path, "CN={name}", name)
    diagnostic = diagnostic_of(edited.load_profile, f"/ws/{path}")
    assert diagnostic.code == "placeholder-unknown"
    assert hint in diagnostic.help


@pytest.mark.parametrize(
    ("path", "old", "new", "hint"),
    [
        (
            "identities.xml",
            "<identity/>",
            "<identity><cert><subject_name>CN={subjct}</subject_name></cert></identity>",
            "did you mean 'subject'?",
        ),
        (
            "permissions.xml",
            '<grant name="/robot1/talker">',
            '<grant name="x"><subject_name>CN={nam}</subject_name>',
            "did you mean 'name'?",
        ),
    ],
)
def test_an_unknown_placeholder_of_a_package_is_reported(
    workspace: Workspace, path: str, old: str, new: str, hint: str
) -> None:
    edited = workspace.edit(path, old, new)
    diagnostic = diagnostic_of(edited.load, f"src/robot1/talker/{path}")
    assert diagnostic.code == "placeholder-unknown"
    assert hint in diagnostic.help


@pytest.mark.parametrize(
    ("template", "expected"),
    [
        ("OU={unique},CN={common_name}", "CN=/,OU={unique}"),
        ("O=a,CN={subject},OU={unique}", "CN=/,O=a,OU={unique}"),
        ("OU={unique},CN=root", "CN=root,OU={unique}"),
        ("OU=x,CN=/", "OU=x,CN=/"),
        ("OU=x,CN={name}", "OU=x,CN="),
    ],
)
def test_the_root_enclave_has_its_common_name_first_if_placeholders_give_it(template: str, expected: str) -> None:
    values = certificate.placeholder_values("/")
    assert certificate.expanded_name(template, values) == expected.format(**values)


VALUES = {"name": "{n}", "subject": "/n", "unique": "7"}
PARTS = ["{", "}", "{name}", "{subject}", "name", "sub", "ject", "{unique}", "!r", ":x", "CN=", ".x", "{{", " "]


@given(st.lists(st.sampled_from(PARTS), max_size=6).map("".join))
def test_braces_are_those_of_known_placeholders(name: str) -> None:
    element = etree.Element("subject_name")
    element.text = name
    found = list(re.finditer(r"\{([^{}]*)\}|[{}]", name))
    wrong = [each[0] for each in found if each[1] not in VALUES]
    if wrong:
        with pytest.raises(KeymintError, match=re.escape(f"unknown placeholder {wrong[0]!r}")):
            certificate.name_with_placeholders(element, VALUES)
    else:
        written = certificate.name_with_placeholders(element, VALUES) or ""
        expected = re.sub(r"\{(\w+)\}", lambda match: VALUES[match[1]], written)
        assert certificate.expanded_name(written, VALUES) == expected
