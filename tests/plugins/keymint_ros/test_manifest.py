# SPDX-License-Identifier: Apache-2.0
"""``keymint_package.xml``: names, documents and authorities of a package."""

from __future__ import annotations

import pytest

from .workspaces import Workspace, diagnostic_of

_MANIFEST = "keymint_package.xml"


@pytest.mark.parametrize("name", ["talker", "robot1/talker", "/robot1/talker"])
def test_the_manifest_may_repeat_the_name(workspace: Workspace, name: str) -> None:
    assert workspace.edit(_MANIFEST, "<export>", f"<name>{name}</name><export>").load().name == "robot1/talker"


@pytest.mark.parametrize(
    ("parts", "code", "hint"),
    [
        ("<name>listener</name>", "name-mismatch", "<name>talker</name>"),
        ("<permissions><issuer_name>permision_ca</issuer_name></permissions>", "authority-unknown", "mean"),
        ("<permissions><issuer_name>identity_ca</issuer_name></permissions>", "signers-differ", "same"),
        ("<permisions/>", "schema", "did you mean 'permissions'?"),
        (
            "<identities><identity><identity_path>identites.xml</identity_path></identity></identities>",
            "file-missing",
            "did you mean 'identities.xml'?",
        ),
        (
            "<identities><identity><defaults_path>../x.xml</defaults_path></identity></identities>",
            "path-outside",
            "inside",
        ),
        (
            "<governances><governance><governance_path>/x</governance_path></governance></governances>",
            "path-outside",
            "inside",
        ),
        (
            "<governances><governance><defaults_path>x.xml</defaults_path></governance></governances>",
            "file-missing",
            "create it",
        ),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(workspace: Workspace, parts: str, code: str, hint: str) -> None:
    edited = workspace.edit(_MANIFEST, "<export>", f"{parts}<export>")
    diagnostic = diagnostic_of(edited.load, f"src/robot1/talker/{_MANIFEST}")
    assert diagnostic.code == code
    assert hint in diagnostic.help
