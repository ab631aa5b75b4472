"""Packages: what they say, what their profile says by default, and what is wrong with them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from keymint.api import DomainRange, KeySpec
from keymint.errors import KeymintError

from .workspaces import RULES, Workspace

_MANIFEST = "keymint_package.xml"


@pytest.fixture
def workspace() -> Workspace:
    return Workspace.new()


def _manifest(parts: str) -> tuple[str, str, str]:
    return _MANIFEST, "<export>", f"{parts}<export>"


def test_a_new_package_is_all_defaults(workspace: Workspace) -> None:
    package = workspace.load()
    assert (package.name, package.subject) == ("robot1/talker", "/robot1/talker")
    assert (package.build_type, package.distro) == ("keymint_ros2_dds", "jazzy")
    assert package.permissions.rules == RULES
    assert package.permissions.grant_name == "/robot1/talker"
    assert package.identity.key == KeySpec("ec", "SECP256R1")
    assert str(package.identity.origin).startswith("/ws/profile/package.defaults/identities.xml:")


def test_an_identity_overrides_its_defaults(workspace: Workspace) -> None:
    package = workspace.edit(
        "identities.xml",
        "<identity/>",
        """<identity name="talker">
             <key><asymmetric_type><ec><curve>SECP384R1</curve></ec></asymmetric_type></key>
             <cert>
               <serial_number>42</serial_number>
               <issuer_name>permissions_ca</issuer_name>
               <subject_name>CN={subject},O={name}</subject_name>
               <extensions><extension name="subjectAltName">DNS:x.example</extension></extensions>
             </cert></identity>""",
    ).load()
    assert package.identity.key == KeySpec("ec", "SECP384R1")
    assert (package.identity.serial, package.identity.issuer) == (42, "permissions_ca")
    assert package.identity.subject_name == "CN=/robot1/talker,O=robot1/talker"
    (extension,) = package.identity.extensions
    assert (extension.name, extension.value, extension.critical) == ("subjectAltName", "DNS:x.example", False)
    assert str(extension.origin).startswith("src/robot1/talker/identities.xml:")


def test_a_governance_overrides_its_defaults_and_keeps_their_last_rule(workspace: Workspace) -> None:
    package = workspace.edit(
        "governance.xml",
        "<domain_rule/>",
        """<domain_rule>
             <rtps_protection_kind>NONE</rtps_protection_kind>
             <topic_access_rules>
               <ros_service_rule><service_expression>/add</service_expression>
                 <data_protection_kind>SIGN</data_protection_kind></ros_service_rule>
               <topic_rule><topic_expression>DCPS*</topic_expression>
                 <enable_read_access_control>false</enable_read_access_control></topic_rule>
             </topic_access_rules>
           </domain_rule>
           <domain_rule><domains><id_range><min>1</min><max>4</max></id_range></domains></domain_rule>""",
    ).load()
    first, second = package.governance.domain_rules
    assert (first.domains, first.rtps_protection_kind, first.discovery_protection_kind) == (
        (DomainRange(0, 0),),
        "NONE",
        "ENCRYPT",
    )
    assert [(rule.kind, rule.expression) for rule in first.topic_rules] == [
        ("ros_service", "/add"),
        ("topic", "DCPS*"),
        ("topic", "*"),
    ]
    service, raw, rest = first.topic_rules
    assert (service.data_protection_kind, service.metadata_protection_kind) == ("SIGN", "ENCRYPT")
    assert (raw.enable_read_access_control, raw.enable_write_access_control) == (False, True)
    assert str(rest.origin).startswith("/ws/profile/package.defaults/governance.xml:")
    assert second.domains == (DomainRange(1, 4),)


def test_a_package_without_governance_and_identities_has_the_defaults(workspace: Workspace) -> None:
    bare = workspace.without("governance.xml").without("identities.xml").load()
    full = workspace.load()
    assert bare.identity.subject_name == full.identity.subject_name
    assert bare.governance.domain_rules[0].topic_rules == full.governance.domain_rules[0].topic_rules
    assert str(bare.identity.origin).startswith("/ws/profile/package.defaults/identities.xml:")


def test_defaults_in_the_package_come_before_those_of_the_profile(workspace: Workspace) -> None:
    own = workspace.profile["package.defaults/permissions.xml"].replace(b"<id>0</id>", b"<id>9</id>")
    package = replace(workspace, package={**workspace.package, "package.defaults/permissions.xml": own}).load()
    assert package.permissions.domains == (DomainRange(9, 9),)


@pytest.mark.parametrize("name", ["talker", "robot1/talker", "/robot1/talker"])
def test_the_manifest_may_repeat_the_name(workspace: Workspace, name: str) -> None:
    assert workspace.edit(*_manifest(f"<name>{name}</name>")).load().name == "robot1/talker"


def test_one_authority_needs_no_mention(workspace: Workspace) -> None:
    text = "<issuer_name>permissions_ca</issuer_name>"
    silent = workspace.edit("profile/package.defaults/permissions.xml", text, "").edit(
        "profile/package.defaults/governance.xml", text, ""
    )
    with pytest.raises(KeymintError, match="no <issuer_name> names the authority that signs this"):
        silent.load()
    authorities = b'<profile><authorities><authority name="identity_ca"/></authorities></profile>'
    alone = replace(silent, profile={**silent.profile, "authorities.xml": authorities}).load()
    assert alone.permissions.issuer == "identity_ca"


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


_RANGE = "<domain_rule><domains><id_range><min>5</min><max>4</max></id_range></domains></domain_rule>"
_DNS = '<identity name="{}"/>'


@pytest.mark.parametrize(
    ("path", "old", "new", "code", "hint"),
    [
        (*_manifest("<name>listener</name>"), "name-mismatch", "<name>talker</name>"),
        (*_manifest("<permissions><issuer_name>permision_ca</issuer_name></permissions>"), "authority-unknown", "mean"),
        (*_manifest("<permissions><issuer_name>identity_ca</issuer_name></permissions>"), "signers-differ", "same"),
        (*_manifest("<permisions/>"), "schema", "did you mean 'permissions'?"),
        (
            *_manifest("<identities><identity><identity_path>identites.xml</identity_path></identity></identities>"),
            "file-missing",
            "did you mean 'identities.xml'?",
        ),
        (
            *_manifest("<identities><identity><defaults_path>../x.xml</defaults_path></identity></identities>"),
            "path-outside",
            "inside",
        ),
        (
            *_manifest("<governances><governance><governance_path>/x</governance_path></governance></governances>"),
            "path-outside",
            "inside",
        ),
        (
            *_manifest("<governances><governance><defaults_path>x.xml</defaults_path></governance></governances>"),
            "file-missing",
            "create it",
        ),
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
        (
            "identities.xml",
            "<identity/>",
            "<identity><cert><subject_name>CN={subjct}</subject_name></cert></identity>",
            "placeholder-unknown",
            "did you mean 'subject'?",
        ),
        ("governance.xml", "<domain_rule/>", _RANGE, "domain-range", "exchange"),
        (
            "governance.xml",
            "<domain_rule/>",
            "<domain_rule><rtps_protection_kind>SING</rtps_protection_kind></domain_rule>",
            "schema",
            "did you mean 'SIGN'?",
        ),
        (
            "permissions.xml",
            '<grant name="/robot1/talker">',
            '<grant name="x"><subject_name>CN={nam}</subject_name>',
            "placeholder-unknown",
            "did you mean 'name'?",
        ),
    ],
)
def test_a_defect_is_named_with_its_place_and_a_hint(
    workspace: Workspace, path: str, old: str, new: str, code: str, hint: str
) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.edit(path, old, new).load()
    found = error.value.diagnostics[0]
    assert found.code == code
    assert hint in found.help
    assert found.where
    assert found.where.file == f"src/robot1/talker/{path}"
    assert found.where.line > 0
    assert "\n" not in str(found)


def test_missing_permissions_are_to_be_created(workspace: Workspace) -> None:
    with pytest.raises(KeymintError, match="keymint create robot1/talker"):
        workspace.without("permissions.xml").load()


def test_a_folder_without_manifest_is_no_package(workspace: Workspace) -> None:
    with pytest.raises(KeymintError, match=_MANIFEST):
        workspace.without(_MANIFEST).load()


def test_an_incomplete_grant_names_the_defaults(workspace: Workspace) -> None:
    text = "<subject_name>OU={unique},CN={common_name}</subject_name>"
    with pytest.raises(KeymintError) as error:
        workspace.edit("profile/package.defaults/permissions.xml", text, "").load()
    (found,) = error.value.diagnostics
    assert found.code == "grant-incomplete"
    assert found.where
    assert found.where.file == "/ws/profile/package.defaults/permissions.xml"
