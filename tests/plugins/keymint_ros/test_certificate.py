# SPDX-License-Identifier: Apache-2.0
"""Certificates and keys in profile and package documents, completed by their defaults."""

from __future__ import annotations

import pytest
from keymint_ros import profile_type

from keymint.api import KeySpec
from keymint.errors import KeymintError

from .workspaces import ROOT, Workspace, diagnostic_of

_AUTHORITIES = "profile/authorities.xml"
_DEFAULTS = "profile/profile.defaults/authorities.xml"
_CERT = "<cert>\n        <issuer_name></issuer_name>"


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


def test_a_missing_validity_is_reported_in_the_defaults(workspace: Workspace) -> None:
    files = dict(workspace.profile)
    files["profile.defaults/authorities.xml"] = b"<defaults/>"
    with pytest.raises(KeymintError) as error:
        profile_type.load(ROOT, files)
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "certificate-incomplete"
    assert diagnostic.where
    assert diagnostic.where.file == "/ws/profile/profile.defaults/authorities.xml"


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


_URI = "pkcs11:token=ca;object=ca?pin-source=file:/run/pin"


@pytest.mark.parametrize(
    ("element", "key"),
    [
        (f"<pkcs11>{_URI}</pkcs11>", KeySpec("ec", "SECP256R1", uri=_URI)),
        (f"<pkcs11> {_URI} </pkcs11><pin_env>PIN</pin_env>", KeySpec("ec", "SECP256R1", uri=_URI, pin_env="PIN")),
        (
            f"<asymmetric_type><rsa><key_size>2048</key_size></rsa></asymmetric_type><pkcs11>{_URI}</pkcs11>",
            KeySpec("rsa", size=2048, uri=_URI),
        ),
    ],
)
def test_a_key_in_a_token(workspace: Workspace, element: str, key: KeySpec) -> None:
    profile = workspace.edit(_AUTHORITIES, "</cert>", f"</cert><key>{element}</key>").load_profile()
    assert [authority.certificate.key for authority in profile.authorities] == [key, KeySpec("ec", "SECP256R1")]


@pytest.mark.parametrize(
    ("element", "code", "hint"),
    [
        ("", "key-incomplete", "<pkcs11>"),
        ("<pin_env>PIN</pin_env>", "key-incomplete", "<pkcs11>"),
        (f"<pkcs11>{_URI}</pkcs11><password_env>PW</password_env>", "key-password", "<pin_env>"),
        (
            f"<pkcs11>{_URI}</pkcs11><encryption_algorithm>BestAvailableEncryption</encryption_algorithm>",
            "key-password",
            "<pin_env>",
        ),
    ],
)
def test_a_key_that_is_described_by_halves(workspace: Workspace, element: str, code: str, hint: str) -> None:
    edited = workspace.edit(_AUTHORITIES, "</cert>", f"</cert><key>{element}</key>")
    diagnostic = diagnostic_of(edited.load_profile, f"/ws/{_AUTHORITIES}")
    assert diagnostic.code == code
    assert hint in diagnostic.help


@pytest.mark.parametrize(
    ("old", "new", "code", "hint"),
    [
        ("<serial_number>", f"<serial_number>{1 << 159}", "serial-invalid", "random"),
        ("SHA256", "SHA1", "schema", "did you mean"),
        ("SECP256R1", "SECP256K1", "schema", "did you mean 'SECP256R1'?"),
        ("<password_env>", "<password_env>X", "key-password", "BestAvailableEncryption"),
        ("NoEncryption", "BestAvailableEncryption", "key-password", "environment variable"),
        ("<key>", "<key><pkcs11>pkcs11:token=ca</pkcs11>", "pkcs11-uri", "object="),
        ("<key>", "<key><pkcs11>pkcs11:token=ca;object=ca?pin-value=1</pkcs11>", "pkcs11-uri", "<pin_env>"),
        (
            "<serial_number>",
            "<extensions>" + 2 * '<extension name="a">1</extension>' + "</extensions><serial_number>",
            "extension-doubled",
            "one element",
        ),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(
    workspace: Workspace, old: str, new: str, code: str, hint: str
) -> None:
    edited = workspace.edit(_DEFAULTS, old, new)
    diagnostic = diagnostic_of(edited.load_profile, f"/ws/{_DEFAULTS}")
    assert diagnostic.code == code
    assert hint in diagnostic.help
