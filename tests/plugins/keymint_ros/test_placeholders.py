# SPDX-License-Identifier: Apache-2.0
"""Placeholders in the distinguished names of authorities and packages."""

from __future__ import annotations

import pytest
from keymint_ros import certificate

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
