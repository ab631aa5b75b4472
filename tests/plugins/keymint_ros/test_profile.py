"""Profiles: authorities and their hierarchy, policies, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros import profile_type

from keymint.api import KeySpec
from keymint.errors import KeymintError

from .workspaces import ROOT, Workspace

_AUTHORITIES = "profile/authorities.xml"
_DEFAULTS = "profile/profile.defaults/authorities.xml"
_MANIFEST = "profile/keymint_profile.xml"
_CERT = "<cert>\n        <issuer_name></issuer_name>"
_PERIOD = "<not_after>2036-11-17T00:00:00</not_after>"


@pytest.fixture
def workspace() -> Workspace:
    return Workspace.new()


def test_an_authority_overrides_its_defaults(workspace: Workspace) -> None:
    profile = workspace.edit(
        _AUTHORITIES,
        _CERT,
        """<cert>
             <subject_name>O=Acme, CN={name}</subject_name>
             <serial_number>17</serial_number>
             <issuer_name>permissions_ca</issuer_name>
             <hash_algorithm> SHA384 </hash_algorithm>
             <validity><not_before>2026-01-01T02:00:00+02:00</not_before><duration>P1Y</duration></validity>
             <extensions>
               <extension name="basicConstraints" critical="true">CA:TRUE, pathlen:0</extension>
               <extension name="nsComment">x</extension>
             </extensions>""",
    ).edit(
        _AUTHORITIES,
        "</cert>",
        """</cert><key>
             <asymmetric_type><rsa><key_size>3072</key_size></rsa></asymmetric_type>
             <encryption_algorithm>BestAvailableEncryption</encryption_algorithm>
             <password_env>CA_PASSWORD</password_env></key>""",
    )
    first, second = (authority.certificate for authority in profile.load_profile().authorities)
    assert (first.subject_name, first.serial, first.issuer) == ("O=Acme, CN=identity_ca", 17, "permissions_ca")
    assert first.hash_algorithm == "SHA384"
    assert first.key == KeySpec("rsa", size=3072, password_env="CA_PASSWORD")
    assert first.validity.not_before.isoformat() == "2026-01-01T00:00:00+00:00"
    assert first.validity.not_after.isoformat() == "2027-01-01T00:00:00+00:00"
    assert [(one.name, one.value, one.critical) for one in first.extensions] == [
        ("basicConstraints", "CA:TRUE, pathlen:0", True),
        ("nsComment", "x", False),
    ]
    assert [str(one.origin) for one in first.extensions] == [
        "/ws/profile/authorities.xml:15",
        "/ws/profile/authorities.xml:16",
    ]
    assert (second.subject_name, second.serial, second.key) == ("CN=permissions_ca", None, KeySpec("ec", "SECP256R1"))


def test_an_authority_that_issues_itself_is_self_signed(workspace: Workspace) -> None:
    own = workspace.edit(_AUTHORITIES, "<issuer_name></issuer_name>", "<issuer_name>identity_ca</issuer_name>")
    assert own.load_profile().authorities[0].certificate.issuer == ""


def test_a_date_without_zone_is_in_utc(workspace: Workspace) -> None:
    workspace = workspace.edit(_DEFAULTS, _PERIOD, "<not_after>2036-11-17T00:00:00.75Z</not_after>")
    validity = workspace.load_profile().authorities[0].certificate.validity
    assert validity.not_after.isoformat() == "2036-11-17T00:00:00+00:00"
    assert validity.not_before.tzinfo is not None


def test_the_policy_may_lie_outside_of_the_workspace(workspace: Workspace) -> None:
    for text, path in (("../../fleet", "/fleet"), ("/opt/policy.xml", "/opt/policy.xml"), ("x/y", "/ws/profile/x/y")):
        (source,) = workspace.edit("profile/policies.xml", ">comarmor.d<", f">{text}<").load_profile().policies
        assert source.path == Path(path)
        assert str(source.origin) == "/ws/profile/policies.xml:7"


def test_a_profile_is_bound_to_another_policy(workspace: Workspace) -> None:
    files = profile_type.with_policy(workspace.profile, "../../my fleet.xml")
    (source,) = profile_type.load(ROOT, {**workspace.profile, **files}).policies
    assert source.path == Path("/my fleet.xml")
    assert list(files) == ["policies.xml"]
    assert profile_type.with_policy({**workspace.profile, **files}, "../../my fleet.xml") == {}
    assert profile_type.with_policy({**workspace.profile, **files}, "comarmor.d") == {
        "policies.xml": workspace.profile["policies.xml"]
    }


def test_policies_that_were_edited_are_not_replaced(workspace: Workspace) -> None:
    edited = workspace.edit("profile/policies.xml", "</policies>", "<!-- mine --></policies>")
    with pytest.raises(KeymintError) as error:
        profile_type.with_policy(edited.profile, "other")
    (found,) = error.value.diagnostics
    assert found.code == "policies-edited"
    assert str(found.where) == "policies.xml:7"
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
        (_DEFAULTS, "CN={name}", "CN={nme}", "placeholder-unknown", "did you mean 'name'?"),
        (_DEFAULTS, "CN={name}", "CN={unique}", "placeholder-unknown", "{name}"),
        (_DEFAULTS, "CN={name}", "CN={name", "placeholder-unknown", "{name}"),
        (_DEFAULTS, "CN={name}", "CN={name.__class__}", "placeholder-unknown", "{name}"),
        (_DEFAULTS, _PERIOD, "<not_after>2020-01-01T00:00:00</not_after>", "validity-order", "end after"),
        (_DEFAULTS, _PERIOD, "<not_after>12026-01-01T00:00:00</not_after>", "date-invalid", "which means UTC"),
        (_DEFAULTS, _PERIOD, "<not_after>9999-12-31T23:59:59-14:00</not_after>", "date-invalid", "which means UTC"),
        (_DEFAULTS, _PERIOD, "<not_after>1940-12-31T23:59:59</not_after>", "date-invalid", "which means UTC"),
        (_DEFAULTS, _PERIOD, "<not_after>tomorrow</not_after>", "schema", ""),
        (_DEFAULTS, _PERIOD, "<duration>1 year</duration>", "duration-invalid", "P1Y"),
        (_DEFAULTS, _PERIOD, "<duration>-P1Y</duration>", "duration-invalid", "P1Y"),
        (_DEFAULTS, _PERIOD, "<duration>P9999Y</duration>", "duration-invalid", "P1Y"),
        (_DEFAULTS, _PERIOD, f"<duration>P{'9' * 60}D</duration>", "duration-invalid", "P1Y"),
        (_DEFAULTS, _PERIOD, "<duration>P0.5Y</duration>", "duration-invalid", "P1Y"),
        (_DEFAULTS, _PERIOD, "<duration>PT0S</duration>", "validity-order", "end after"),
        (_DEFAULTS, "<serial_number>", f"<serial_number>{1 << 159}", "serial-invalid", "random"),
        (_DEFAULTS, "<serial_number>", "<serial_number>0", "serial-invalid", "random"),
        (_DEFAULTS, "SHA256", "SHA1", "schema", "did you mean"),
        (_DEFAULTS, "SECP256R1", "SECP256K1", "schema", "did you mean 'SECP256R1'?"),
        (_DEFAULTS, "<password_env>", "<password_env>X", "key-password", "BestAvailableEncryption"),
        (_DEFAULTS, "NoEncryption", "BestAvailableEncryption", "key-password", "environment variable"),
        (
            _DEFAULTS,
            "<serial_number>",
            "<extensions>" + 2 * '<extension name="a">1</extension>' + "</extensions><serial_number>",
            "extension-doubled",
            "one element",
        ),
        (_MANIFEST, ">authorities.xml", ">authorties.xml", "file-missing", "did you mean 'authorities.xml'?"),
        (_MANIFEST, ">authorities.xml", ">../authorities.xml", "path-outside", "inside the same folder"),
        (_MANIFEST, ">authorities.xml", ">/etc/passwd", "path-outside", "inside the same folder"),
        (_MANIFEST, ">policies.xml", ">a/../policies.xml", "path-outside", "inside the same folder"),
        (_MANIFEST, ">jazzy", ">jazy", "distro-unknown", "did you mean 'jazzy'?"),
        (_MANIFEST, ">sros2", ">sros", "schema", "did you mean 'sros2'?"),
        (_MANIFEST, "<profile", "<!DOCTYPE x>\n<profile", "xml-doctype", "remove it"),
    ],
)
def test_a_defect_is_named_with_its_place_and_a_hint(
    workspace: Workspace, path: str, old: str, new: str, code: str, hint: str
) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.edit(path, old, new).load_profile()
    found = error.value.diagnostics[0]
    assert found.code == code
    assert hint in found.help
    assert found.where
    assert found.where.file == f"/ws/{path}"
    assert found.where.line > 0
    assert "\n" not in str(found)


def test_issuers_in_a_circle(workspace: Workspace) -> None:
    circle = workspace.edit(_AUTHORITIES, *_issuer("permissions_ca")).edit(_AUTHORITIES, *_issuer("identity_ca"))
    with pytest.raises(KeymintError, match="identity_ca <- permissions_ca <- identity_ca") as error:
        circle.load_profile()
    assert error.value.diagnostics[0].where


def test_a_missing_validity_is_asked_for_in_the_defaults(workspace: Workspace) -> None:
    files = dict(workspace.profile)
    files["profile.defaults/authorities.xml"] = b"<defaults/>"
    with pytest.raises(KeymintError) as error:
        profile_type.load(ROOT, files)
    (found,) = error.value.diagnostics
    assert found.code == "certificate-incomplete"
    assert found.where
    assert found.where.file == "/ws/profile/profile.defaults/authorities.xml"


@pytest.mark.parametrize("path", ["keymint_profile.xml", "policies.xml", "profile.defaults/authorities.xml"])
def test_a_missing_file_is_named(workspace: Workspace, path: str) -> None:
    with pytest.raises(KeymintError) as error:
        workspace.without(f"profile/{path}").load_profile()
    assert path in str(error.value)
    assert error.value.diagnostics[0].where


def test_profiles_with_equal_documents_name_their_own(workspace: Workspace) -> None:
    broken = {**workspace.profile, "authorities.xml": b"<profile/>"}
    for root in (Path("/one"), Path("/two")):
        with pytest.raises(KeymintError) as error:
            profile_type.load(root, broken)
        assert str(error.value.diagnostics[0].where) == f"{root}/authorities.xml:1"
