# SPDX-License-Identifier: Apache-2.0
"""Profiles: authorities and their hierarchy, policies, and defects."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros import profile_type

from keymint.errors import KeymintError

from .workspaces import ROOT, Workspace

_AUTHORITIES = "profile/authorities.xml"
_DEFAULTS = "profile/profile.defaults/authorities.xml"
_MANIFEST = "profile/keymint_profile.xml"
_CERT = "<cert>\n        <issuer_name></issuer_name>"
_PERIOD = "<not_after>2036-11-17T00:00:00</not_after>"


def test_an_authority_that_issues_itself_is_self_signed(workspace: Workspace) -> None:
    own = workspace.edit(_AUTHORITIES, "<issuer_name></issuer_name>", "<issuer_name>identity_ca</issuer_name>")
    assert own.load_profile().authorities[0].certificate.issuer == ""


def test_the_policy_may_lie_outside_of_the_workspace(workspace: Workspace) -> None:
    for text, path in (("../../fleet", "/fleet"), ("/opt/policy.xml", "/opt/policy.xml"), ("x/y", "/ws/profile/x/y")):
        (source,) = workspace.edit("profile/policies.xml", ">comarmor.d<", f">{text}<").load_profile().policies
        assert source.path == Path(path)
        assert str(source.origin) == "/ws/profile/policies.xml:7"


def test_a_profile_gets_another_policy(workspace: Workspace) -> None:
    files = profile_type.with_policy(workspace.profile, "../../my fleet.xml")
    (source,) = profile_type.load(ROOT, {**workspace.profile, **files}).policies
    assert source.path == Path("/my fleet.xml")
    assert list(files) == ["policies.xml"]
    assert profile_type.with_policy({**workspace.profile, **files}, "../../my fleet.xml") == {}
    assert profile_type.with_policy({**workspace.profile, **files}, "comarmor.d") == {
        "policies.xml": workspace.profile["policies.xml"]
    }


def test_a_path_that_keymint_would_not_write_was_edited(workspace: Workspace) -> None:
    edited = workspace.edit("profile/policies.xml", ">comarmor.d<", ">comarmor\u009bd<")
    with pytest.raises(KeymintError) as caught:
        profile_type.with_policy(edited.profile, "other")
    (diagnostic,) = caught.value.diagnostics
    assert (diagnostic.code, diagnostic.where and diagnostic.where.file) == ("policies-edited", "policies.xml")


def test_policies_that_were_edited_are_not_replaced(workspace: Workspace) -> None:
    edited = workspace.edit("profile/policies.xml", "</policies>", "<!-- mine --></policies>")
    with pytest.raises(KeymintError) as error:
        profile_type.with_policy(edited.profile, "other")
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "policies-edited"
    assert str(diagnostic.where) == "policies.xml:7"
    assert profile_type.with_policy(edited.profile, "comarmor.d") == {}


def test_a_profile_is_recognised_by_its_manifest(workspace: Workspace) -> None:
    assert profile_type.recognises(workspace.profile)
    assert not profile_type.recognises({"other.xml": b""})


def _issuer(name: str) -> tuple[str, str]:
    return "<issuer_name></issuer_name>", f"<issuer_name>{name}</issuer_name>"


@pytest.mark.parametrize(
    ("path", "old", "new", "code", "hint"),
    [
        (_AUTHORITIES, *_issuer("identty_ca"), "authority-unknown", "did you mean 'identity_ca'?"),
        (_AUTHORITIES, 'name="permissions_ca"', 'name="Identity_CA"', "authority-doubled", "its own"),
        (_AUTHORITIES, 'name="identity_ca"', 'name="../ca"', "schema", ""),
        (_AUTHORITIES, "<issuer_name>", "<isuer_name>", "xml-syntax", ""),
        (_AUTHORITIES, "<issuer_name></issuer_name>", "<isuer_name/>", "schema", "did you mean 'issuer_name'?"),
        (_AUTHORITIES, "<cert>", '<cert x="y">', "schema", ""),
        (_MANIFEST, ">jazzy", ">jazy", "distro-unknown", "did you mean 'jazzy'?"),
        (_MANIFEST, ">sros2", ">sros", "schema", "did you mean 'sros2'?"),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(
    workspace: Workspace, path: str, old: str, new: str, code: str, hint: str
) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.edit(path, old, new).load_profile()
    diagnostic = error.value.diagnostics[0]
    assert diagnostic.code == code
    assert hint in diagnostic.help
    assert diagnostic.where
    assert diagnostic.where.file == f"/ws/{path}"
    assert diagnostic.where.line > 0
    assert "\n" not in str(diagnostic)


def test_a_cycle_of_issuers_is_an_error(workspace: Workspace) -> None:
    cycle = workspace.edit(_AUTHORITIES, *_issuer("permissions_ca")).edit(_AUTHORITIES, *_issuer("identity_ca"))
    with pytest.raises(KeymintError, match="identity_ca <- permissions_ca <- identity_ca") as error:
        cycle.load_profile()
    assert error.value.diagnostics[0].where
