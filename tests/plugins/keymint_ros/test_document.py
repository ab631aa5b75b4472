# SPDX-License-Identifier: Apache-2.0
"""Documents and the files that they name."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros import profile_type

from keymint.errors import KeymintError

from .workspaces import Workspace, diagnostic_of

_MANIFEST = "profile/keymint_profile.xml"


@pytest.mark.parametrize("path", ["keymint_profile.xml", "policies.xml", "profile.defaults/authorities.xml"])
def test_a_missing_file_is_reported(workspace: Workspace, path: str) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.without(f"profile/{path}").load_profile()
    assert path in str(error.value)
    assert error.value.diagnostics[0].where


def test_a_long_path_of_a_missing_file_is_cut_in_the_message(workspace: Workspace) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.edit(_MANIFEST, ">authorities.xml", f">{'a' * 3000}.xml").load_profile()
    assert error.value.diagnostics[0].code == "file-missing"
    assert len(str(error.value)) < 500


def test_identical_documents_of_two_profiles_are_reported_by_their_own_paths(workspace: Workspace) -> None:
    broken = {**workspace.profile, "authorities.xml": b"<profile/>"}
    for root in (Path("/one"), Path("/two")):
        with pytest.raises(KeymintError) as error:
            profile_type.load(root, broken)
        assert str(error.value.diagnostics[0].where) == f"{root}/authorities.xml:1"


@pytest.mark.parametrize(
    ("old", "new", "code", "hint"),
    [
        (">authorities.xml", ">authorties.xml", "file-missing", "did you mean 'authorities.xml'?"),
        (">authorities.xml", ">../authorities.xml", "path-outside", "inside the same folder"),
        (">authorities.xml", ">/etc/passwd", "path-outside", "inside the same folder"),
        (">policies.xml", ">a/../policies.xml", "path-outside", "inside the same folder"),
        ("<profile", "<!DOCTYPE x>\n<profile", "xml-doctype", "remove it"),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(
    workspace: Workspace, old: str, new: str, code: str, hint: str
) -> None:
    edited = workspace.edit(_MANIFEST, old, new)
    diagnostic = diagnostic_of(edited.load_profile, f"/ws/{_MANIFEST}")
    assert diagnostic.code == code
    assert hint in diagnostic.help
