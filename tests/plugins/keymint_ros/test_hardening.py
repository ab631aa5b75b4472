# SPDX-License-Identifier: Apache-2.0
"""Edits of profiles and packages that were taken over: only what changes is edited."""

from __future__ import annotations

import difflib
from dataclasses import replace

import pytest
from keymint_ros import package_type, profile_type

from keymint.api import AdoptedSources, KeySpec, WorkspaceProfile
from keymint.errors import KeymintError
from keymint.ir import SubjectRules

from .workspaces import REQUEST, ROOT, Workspace

UNIQUE = "<subject_name>OU={unique},CN={common_name}</subject_name>"


def profile_of(workspace: Workspace) -> WorkspaceProfile:
    return profile_type.load(ROOT, workspace.profile)


def added(before: bytes, after: bytes) -> list[str]:
    lines = difflib.ndiff(before.decode().splitlines(), after.decode().splitlines())
    return [line[0] + line[1:].strip() for line in lines if line[0] in "+-"]


def adopted(workspace: Workspace, subject_name: str = "") -> dict[str, bytes]:
    validity = workspace.load().identity.validity
    sources = AdoptedSources(
        SubjectRules("/robot1/talker", ()), subject_name, validity, validity, (), KeySpec("ec", curve="SECP256R1"),
        {"permissions.xml": b"signed"},
    )  # fmt: skip
    return dict(package_type.adopted_sources(profile_of(workspace), sources))


@pytest.mark.parametrize("name", ["", "CN=/robot1/talker"])
def test_a_unique_name_is_the_only_change(workspace: Workspace, name: str) -> None:
    files = adopted(workspace, name)
    changed = package_type.with_unique_name(profile_of(workspace), "robot1/talker", files)
    assert sorted(changed) == ["identities.xml", "permissions.xml"]
    for file, content in changed.items():
        lines = added(files[file], content)
        assert [line for line in lines if line[0] == "+"] == ["+" + UNIQUE]
        assert len(lines) == (2 if name else 1)


def test_what_is_kept_is_beside_the_sources(workspace: Workspace) -> None:
    files = adopted(workspace)
    assert files["adopted.permissions.xml"] == b"signed"
    loaded = replace(workspace, package=files).load()
    assert loaded.kept == {"permissions.xml": b"signed"}
    period, before = loaded.identity.validity, workspace.load().identity.validity
    assert (period.not_before, period.not_after) == (before.not_before, before.not_after)


def test_other_forms_are_not_edited(workspace: Workspace) -> None:
    files = {**adopted(workspace), "identities.xml": b"<package><identities><identity/></identities></package>"}
    with pytest.raises(KeymintError, match="does not edit") as caught:
        package_type.with_unique_name(profile_of(workspace), "robot1/talker", files)
    assert caught.value.diagnostics[0].code == "harden-by-hand"


def test_another_authority_signs(workspace: Workspace) -> None:
    one = Workspace.new(replace(REQUEST, authority="ca"))
    assert [each.name for each in profile_of(one).authorities] == ["ca"]
    changed = profile_type.with_own_signer(profile_of(one), "ca")
    assert sorted(changed) == ["authorities.xml", "package.defaults/governance.xml", "package.defaults/permissions.xml"]
    after = replace(one, profile={**one.profile, **changed})
    assert [each.name for each in profile_of(after).authorities] == ["ca", "permissions_ca"]
    assert after.load().grant.issuer == "permissions_ca"
    assert after.load().identity.issuer == "ca"


def test_what_a_comment_says_is_not_edited(workspace: Workspace) -> None:
    files = adopted(workspace, "CN=/robot1/talker")
    comment = b"<cert><!-- was\n <validity> <subject_name>CN=/old</subject_name> -->"
    identities = files["identities.xml"].replace(b"<cert>", comment)
    assert identities != files["identities.xml"]
    files["identities.xml"] = identities
    changed = package_type.with_unique_name(profile_of(workspace), "robot1/talker", files)
    lines = added(identities, changed["identities.xml"])
    assert [line[0] for line in lines] == ["-", "+"]
    assert lines[1] == "+" + UNIQUE

    one = Workspace.new(replace(REQUEST, authority="ca"))
    shown = b"<defaults><!-- <issuer_name>ca</issuer_name> -->"
    defaults = {path: content.replace(b"<defaults>", shown) for path, content in one.profile.items()}
    one = replace(one, profile=defaults)
    changed = profile_type.with_own_signer(profile_of(one), "ca")
    assert replace(one, profile={**defaults, **changed}).load().grant.issuer == "permissions_ca"


@pytest.mark.parametrize("encoding", ["iso-8859-1", "utf-16"])
def test_other_encodings_are_not_edited(workspace: Workspace, encoding: str) -> None:
    files = adopted(workspace)
    text = files["identities.xml"].decode().replace("UTF-8", encoding).replace("<cert>", "<cert><!-- é -->")
    with pytest.raises(KeymintError, match="does not edit"):
        package_type.with_unique_name(
            profile_of(workspace), "robot1/talker", {**files, "identities.xml": text.encode(encoding)}
        )
