# SPDX-License-Identifier: Apache-2.0
"""Packages, completed by the defaults of their profile, and their defects."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from unittest import mock

import pytest
from keymint_ros import package_type, permissions
from keymint_ros2_dds.settings import settings_of

from keymint.api import DomainRange, KeySpec
from keymint.errors import KeymintError

from . import workspaces
from .workspaces import RULES, Workspace

_MANIFEST = "keymint_package.xml"


def test_a_new_package_uses_only_defaults(workspace: Workspace) -> None:
    package = workspace.load()
    assert (package.name, package.subject) == ("robot1/talker", "/robot1/talker")
    assert (package.build_types, package.distro) == (("keymint_ros2_dds",), "jazzy")
    assert package.grant.rules == RULES
    assert package.grant.name == "/robot1/talker"
    assert package.identity.key == KeySpec("ec", "SECP256R1")
    assert str(package.identity.origin).startswith("/ws/profile/package.defaults/identities.xml:")


def test_a_package_without_governance_and_identities_has_the_defaults(workspace: Workspace) -> None:
    bare = workspace.without("governance.xml").without("identities.xml").load()
    full = workspace.load()
    assert bare.identity.subject_name == full.identity.subject_name
    (bare_rule,), (full_rule,) = (settings_of(each).domain_rules for each in (bare, full))
    assert bare_rule.topic_rules == full_rule.topic_rules
    assert str(bare.identity.origin).startswith("/ws/profile/package.defaults/identities.xml:")


def test_defaults_in_the_package_override_those_of_the_profile(workspace: Workspace) -> None:
    own = workspace.profile["package.defaults/permissions.xml"].replace(b"<id>0</id>", b"<id>9</id>")
    package = replace(workspace, package={**workspace.package, "package.defaults/permissions.xml": own}).load()
    assert package.grant.domains == (DomainRange(9, 9),)


def test_a_single_authority_need_not_be_named(workspace: Workspace) -> None:
    text = "<issuer_name>permissions_ca</issuer_name>"
    unnamed = workspace.edit("profile/package.defaults/permissions.xml", text, "").edit(
        "profile/package.defaults/governance.xml", text, ""
    )
    assert unnamed.load().grant.issuer == "permissions_ca"  # as the packages of 2018 name it
    others = unnamed.profile["authorities.xml"].replace(b"permissions_ca", b"documents_ca")
    with pytest.raises(KeymintError, match="no <issuer_name> names the authority that signs this"):
        replace(unnamed, profile={**unnamed.profile, "authorities.xml": others}).load()
    authorities = b'<profile><authorities><authority name="identity_ca"/></authorities></profile>'
    alone = replace(unnamed, profile={**unnamed.profile, "authorities.xml": authorities}).load()
    assert alone.grant.issuer == "identity_ca"


def test_the_manifest_may_name_the_issuer_of_the_certificate(workspace: Workspace) -> None:
    identities = "<identities><issuer_name>permissions_ca</issuer_name></identities></package>"
    named = workspace.edit(_MANIFEST, "</package>", identities)
    assert workspace.load().identity.issuer == "identity_ca"
    assert named.load().identity.issuer == "permissions_ca"
    own = named.edit(
        "identities.xml", "<identity/>", "<identity><cert><issuer_name>identity_ca</issuer_name></cert></identity>"
    )
    assert own.load().identity.issuer == "identity_ca"
    unknown = workspace.edit(_MANIFEST, "</package>", identities.replace("permissions_ca", "permissions"))
    with pytest.raises(KeymintError) as error:
        unknown.load()
    (diagnostic,) = error.value.diagnostics
    assert str(diagnostic.where).startswith("src/robot1/talker/keymint_package.xml:")
    assert diagnostic.help == "did you mean 'permissions_ca'?"


def test_the_defects_of_all_documents_are_reported_at_once(workspace: Workspace) -> None:
    broken = (
        workspace.edit("identities.xml", "<identity/>", "<identty/>")
        .edit("governance.xml", "<domain_rule/>", "<domain_rul/>")
        .edit("permissions.xml", "<attachment>", "<attachment x='y'>")
    )
    with pytest.raises(KeymintError) as error:
        broken.load()
    files = {found.where.file.rpartition("/")[2] for found in error.value.diagnostics if found.where}
    assert files == {"identities.xml", "governance.xml", "permissions.xml"}


_DNS = '<identity name="{}"/>'


@pytest.mark.parametrize(
    ("path", "old", "new", "code", "hint"),
    [
        ("identities.xml", "<identity/>", _DNS.format("listener"), "name-mismatch", "the name of the package"),
        (
            "identities.xml",
            "<identity/>",
            "<identity><cert><issuer_name>ca</issuer_name></cert></identity>",
            "authority-unknown",
            "",
        ),
        (
            "identities.xml",
            "<identity/>",
            "<identity><cert><issuer_name/></cert></identity>",
            "authority-unknown",
            "authorities are",
        ),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(
    workspace: Workspace, path: str, old: str, new: str, code: str, hint: str
) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.edit(path, old, new).load()
    diagnostic = error.value.diagnostics[0]
    assert diagnostic.code == code
    assert hint in diagnostic.help
    assert diagnostic.where
    assert diagnostic.where.file == f"src/robot1/talker/{path}"
    assert diagnostic.where.line > 0
    assert "\n" not in str(diagnostic)


def test_the_error_of_missing_permissions_names_the_command_that_creates_them(workspace: Workspace) -> None:
    with pytest.raises(KeymintError, match="keymint create robot1/talker"):
        workspace.without("permissions.xml").load()


@pytest.mark.parametrize(
    ("old", "new", "deferred"),
    [
        ("", "", True),
        ("/robot1/chatter", "/robot1/other", True),
        ('name="/robot1/talker"', 'name="mine"', False),
        ('"/robot1/talker">', '"/robot1/talker"><subject_name>CN=x</subject_name>', False),
        ('"/robot1/talker">', '"/robot1/talker"><domains><id>7</id></domains>', False),
    ],
)
def test_a_package_that_was_built_is_the_same_but_its_rules_are_read_later(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch, old: str, new: str, *, deferred: bool
) -> None:
    changed = workspace.edit("permissions.xml", old, new)
    usual = changed.load()
    with monkeypatch.context() as patch:
        patch.setattr(workspaces, "package_type", SimpleNamespace(load=partial(package_type.load, built=True)))
        read = mock.Mock(wraps=permissions.read)
        patch.setattr(permissions, "read", read)
        package = changed.load()
        assert read.called is not deferred
        assert package.grant.rules.rules == usual.grant.rules.rules
        assert package.grant.rules.rules is package.grant.rules.rules
        assert read.call_count == 1
    grant = replace(package.grant, rules=usual.grant.rules, edited=usual.grant.edited)
    assert replace(package, grant=grant) == usual


def test_a_folder_without_manifest_is_not_a_package(workspace: Workspace) -> None:
    with pytest.raises(KeymintError, match=_MANIFEST):
        workspace.without(_MANIFEST).load()


def test_an_incomplete_grant_is_reported_in_the_defaults(workspace: Workspace) -> None:
    text = "<subject_name>OU={unique},CN={common_name}</subject_name>"
    with pytest.raises(KeymintError) as error:
        workspace.edit("profile/package.defaults/permissions.xml", text, "").load()
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "grant-incomplete"
    assert diagnostic.where
    assert diagnostic.where.file == "/ws/profile/package.defaults/permissions.xml"
