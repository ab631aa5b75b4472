# SPDX-License-Identifier: Apache-2.0
"""Workspaces of the tool of 2018, from the command line: nothing of them is edited, and openssl verifies the result."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography import x509

from keymint.pki import smime
from tests.conftest import snapshot

from .workspace_of_2018 import PACKAGES, write, write_build

IN_2018 = {"SOURCE_DATE_EPOCH": "1530000000"}
"""2018-06-26, when the certificates of the published workspace were valid."""


def provisioned(keymint, ws: Path, env: dict[str, str] | None = None, *build: str) -> None:
    """Run each stage in a workspace that ``init`` never saw."""
    for arguments in (("create", "--all"), ("build", *build), ("install",)):
        outcome = keymint(*arguments, "-w", ws, env=env)
        assert outcome.code == 0, outcome.err


def verified(enclave: Path, at: str = "1800000000") -> None:
    """Let openssl verify the certificate and the documents of an enclave, at a time in seconds."""
    chain = ["openssl", "verify", "-attime", at, "-CAfile", "identity_ca.cert.pem", "cert.pem"]
    commands = [chain] + [
        ["openssl", "smime", "-verify", "-attime", at, "-in", f"{name}.p7s", "-CAfile", "permissions_ca.cert.pem"]
        for name in ("permissions", "governance")
    ]
    for command in commands:
        done = subprocess.run(command, cwd=enclave, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr


def own_files(ws: Path) -> dict[str, bytes]:
    """Return the files of the owner, except the permissions that ``create`` generates, as it did in 2018."""
    return {
        str(path.relative_to(ws)): path.read_bytes()
        for space in ("profile", "src")
        for path in sorted((ws / space).rglob("*"))
        if (path.is_file() and not path.name.startswith("permissions.xml")) or path.match("*.defaults/*")
    }


def test_every_element_of_then_loads_and_openssl_verifies(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws)
    before, old = own_files(ws), (ws / "src/talker/permissions.xml").read_bytes()
    provisioned(keymint, ws)
    assert own_files(ws) == before
    assert (ws / "src/talker/permissions.xml.2018").read_bytes() == old
    for name in PACKAGES:
        verified(ws / "install" / "enclaves" / name)
    assert keymint("check", "-w", ws).code == 0
    assert not keymint("create", "--all", "-w", ws).err

    root, identity, permissions = (
        x509.load_pem_x509_certificate((ws / "public" / f"{name}.cert.pem").read_bytes())
        for name in ("root_ca", "identity_ca", "permissions_ca")
    )
    constraints = [each.extensions.get_extension_for_class(x509.BasicConstraints) for each in (root, identity)]
    assert [(each.critical, each.value.ca, each.value.path_length) for each in constraints] == [
        (True, True, 1),
        (True, True, 0),
    ]
    assert permissions.serial_number == 3
    serials = {root.serial_number, identity.serial_number}
    assert len(serials) == 2
    assert min(serials) > 1 << 32
    assert keymint("build", "-w", ws).out.startswith("nothing to do")


def test_what_the_former_permissions_said_and_the_policy_does_not(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws)
    outcome = keymint("create", "talker", "-w", ws)
    assert outcome.code == 0
    lost, gained = outcome.err.splitlines()
    assert lost.startswith(
        "ws/src/talker/permissions.xml:2: warning: the permissions of 2018 said ALLOW ros_publish '/anything', which "
        "the policy does not say (they are kept as permissions.xml.2018;"
    )
    assert "did not say ALLOW ros_publish '/chatter' and 1 more, which the policy says" in gained


def test_the_published_workspace_as_it_is(keymint, reference: Path, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    shutil.copytree(reference / "ppac" / "keymint_ws", ws, copy_function=shutil.copyfile)
    subprocess.run(["chmod", "-R", "u+w", ws], check=True)
    before = own_files(ws)
    created = keymint("create", "--all", "-w", ws, env=IN_2018)
    provisioned(keymint, ws, IN_2018)
    assert own_files(ws) == before
    assert created.err == ""
    for name in ("talker", "listener"):
        verified(ws / "install" / "enclaves" / name, IN_2018["SOURCE_DATE_EPOCH"])
    outcome = keymint("check", "-w", ws, "--json", env=IN_2018)
    notes = {"node-cannot-start", "parameter-client-cannot-start"}
    assert (outcome.code, [each for each in outcome.codes() if each not in notes]) == (3, ["authority-shared"])


def test_a_committed_build_space_is_neither_signed_nor_replaced_unasked(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws)
    write_build(ws)
    stale = snapshot(ws / "build")
    assert keymint("create", "--all", "-w", ws).code == 0
    outcome = keymint("build", "-w", ws, "--json")
    assert outcome.codes() == ["build-foreign"] * len(PACKAGES)
    assert outcome.document["diagnostics"][-1]["help"] == f"'keymint build -f talker -w {ws}' replaces it"
    assert keymint("install", "-w", ws).code != 0
    assert {path: state for path, state in snapshot(ws / "build").items() if path in stale} == stale
    assert not (ws / "install" / "enclaves").exists()

    provisioned(keymint, ws, None, "-f")
    verified(ws / "install" / "enclaves" / "talker")
    assert b"stale" not in b"".join(path.read_bytes() for path in (ws / "install").rglob("*") if path.is_file())


def test_the_defaults_that_were_linked_are_those_of_the_profile_also_after_a_move(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws, link="/elsewhere/keymint_ws/profile/package.defaults")
    provisioned(keymint, ws)
    verified(ws / "install" / "enclaves" / "listener")


def test_defaults_that_are_linked_inside_the_workspace_are_those_of_the_package(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws, link=str(ws / "shared"))
    shutil.copytree(ws / "profile" / "package.defaults", ws / "shared")
    edited(ws, "shared/identities.xml", "2033", "2031")
    provisioned(keymint, ws)
    certificate = x509.load_pem_x509_certificate((ws / "install/enclaves/talker/cert.pem").read_bytes())
    assert certificate.not_valid_after_utc.year == 2031


@pytest.mark.parametrize(("target", "what"), [("other.defaults", "outside the workspace"), ("lost", "no folder")])
def test_defaults_that_are_linked_from_elsewhere_are_refused(keymint, tmp_path: Path, target: str, what: str) -> None:
    ws, other = tmp_path / "ws", tmp_path / "other.defaults"
    write(ws, link=str(tmp_path / target))
    shutil.copytree(ws / "profile" / "package.defaults", other)
    outcome = keymint("create", "--all", "-w", ws)
    assert outcome.code == 1
    assert f"package.defaults: error: is a link to '{target}', which is {what} (remove it, so" in outcome.err


def edited(ws: Path, path: str, old: str, new: str) -> None:
    text = (ws / path).read_text()
    assert old in text
    (ws / path).write_text(text.replace(old, new, 1))


def authority_of_2018(ws: Path, name: str) -> bytes:
    """Write an authority whose name has the RDNs of the profile in another order; return its certificate."""
    subject = f"/C=US/ST=CA/O=Acme/emailAddress=acme@acme.acme/CN={name}"
    key, file = ws / f"private/{name}.key.pem", ws / f"public/{name}.cert.pem"
    for path in (key, file):
        path.parent.mkdir(exist_ok=True)
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", key,
         "-days", "5000", "-subj", subject, "-out", file],
        check=True, capture_output=True,
    )  # fmt: skip
    key.chmod(0o600)
    key.parent.chmod(0o700)
    return file.read_bytes()


def test_an_authority_whose_rdns_stand_in_another_order_is_used_as_it_is(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws)
    made = {name: authority_of_2018(ws, name) for name in ("root_ca", "permissions_ca")}
    provisioned(keymint, ws)
    assert {name: (ws / f"public/{name}.cert.pem").read_bytes() for name in made} == made
    verified(ws / "install/enclaves/talker")
    identity = x509.load_pem_x509_certificate((ws / "public/identity_ca.cert.pem").read_bytes())
    assert identity.issuer == x509.load_pem_x509_certificate(made["root_ca"]).subject
    for verb in ("check", "prove"):
        outcome = keymint(verb, "-w", ws)
        assert outcome.code == 0, outcome.err
    assert keymint("install", "-w", ws).out.startswith("nothing to do")
    for key in (ws / "private").glob("*_ca.key.pem"):
        key.rename(key.with_suffix(".away"))
    assert keymint("install", "-w", ws).code == 0
    (ws / "public/permissions_ca.cert.pem").unlink()  # restored from the enclaves
    (ws / "private/permissions_ca.key.away").rename(ws / "private/permissions_ca.key.pem")
    assert keymint("install", "-w", ws).code == 0
    assert (ws / "public/permissions_ca.cert.pem").read_bytes() == made["permissions_ca"]


def test_its_renewal_says_what_to_write_first(keymint, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    write(ws)
    before = authority_of_2018(ws, "permissions_ca")
    provisioned(keymint, ws)
    outcome = keymint("authority", "renew", "permissions_ca", "--flag-day", "-w", ws)
    name = "C=US,ST=CA,O=Acme,emailAddress=acme@acme.acme,CN=permissions_ca"
    assert (outcome.code, f"write <subject_name>{name}</subject_name>" in outcome.err) == (1, True), outcome.err
    assert (ws / "public/permissions_ca.cert.pem").read_bytes() == before
    edited(ws, "profile/authorities.xml", "<serial_number>3<", f"<subject_name>{name}</subject_name><serial_number>3<")
    assert keymint("authority", "renew", "permissions_ca", "--flag-day", "-w", ws).code == 0
    after = x509.load_pem_x509_certificate((ws / "public/permissions_ca.cert.pem").read_bytes())
    assert after.subject == x509.load_pem_x509_certificate(before).subject
    assert after.public_key() == x509.load_pem_x509_certificate(before).public_key()
    assert keymint("check", "-w", ws).code == 0


def test_a_package_that_is_new_has_the_signer_of_then(keymint, tmp_path: Path) -> None:
    """The template of 2018 named permissions_ca in each package."""
    ws = tmp_path / "ws"
    write(ws)
    assert keymint("create", "/robot2/talker", "-w", ws).code == 0
    provisioned(keymint, ws)
    verified(ws / "install/enclaves/robot2/talker")
    edited(ws, "profile/authorities.xml", 'name="permissions_ca"', 'name="other_ca"')
    outcome = keymint("build", "robot2/talker", "-w", ws)
    assert (outcome.code, "no <issuer_name> names the authority" in outcome.err) == (1, True)


# -- what was installed then -------------------------------------------------------------------------------------------


def installed_then(keymint, root: Path, distro: str) -> Path:
    """Return a workspace of 2018 whose nodes have documents of that time: nothing of Keymint's record is left."""
    write(root)
    (root / "profile/authorities.xml").write_text(
        '<profile><authorities><authority name="permissions_ca"/></authorities></profile>'
    )
    edited(root, "profile/package.defaults/identities.xml", ">identity_ca<", ">permissions_ca<")
    edited(root, _PROFILE, "</export>", f"<layout>flat</layout><distro>{distro}</distro></export>")
    provisioned(keymint, root)
    edited(root, _PROFILE, f"<layout>flat</layout><distro>{distro}</distro></export>", "</export>")
    for path in (
        ".keymint",
        "build",
        "private/register.sqlite3",
    ):
        (shutil.rmtree if (root / path).is_dir() else Path.unlink)(root / path)
    for path in root.rglob("keystore.*sh"):
        path.unlink()
    for path in root.rglob(".gitignore"):
        path.unlink()
    return root


def asked(keymint, ws: Path) -> list[dict[str, object]]:
    """Create, build and install; return the diagnostics."""
    found: list[dict[str, object]] = []
    for arguments in (("create", "--all"), ("build",), ("install",)):
        outcome = keymint(*arguments, "-w", ws, "--json")
        assert outcome.code == 0, outcome.out
        found += outcome.document["diagnostics"]
    return found


def test_documents_with_partitions_are_those_of_ardent(keymint, tmp_path: Path) -> None:
    ws = installed_then(keymint, tmp_path / "ws", "ardent")
    before = {path: smime.signed_content(path.read_bytes()) for path in ws.glob("install/**/permissions.p7s")}
    assert b"<partition>rt" in b"".join(before.values())
    found = asked(keymint, ws)
    assert {each["code"] for each in found} == {"distro-unnamed"}
    assert "<layout>flat</layout><distro>ardent</distro>" in str(found[0]["help"])
    assert {path: smime.signed_content(path.read_bytes()) for path in ws.glob("install/**/permissions.p7s")} == before
    assert keymint("check", "-w", ws, "--json").codes() == ["authority-shared"]
    for verb in ("prove", "status"):
        assert keymint(verb, "-w", ws).code == 0
    assert keymint("install", "-w", ws).out.startswith("nothing to do")
    edited(ws, _PROFILE, "</export>", "<layout>flat</layout><distro>ardent</distro></export>")
    assert asked(keymint, ws) == []


@pytest.mark.parametrize(("distro", "layout"), [("jazzy", "flat"), ("jazzy", "sros2"), ("ardent", "flat")])
def test_new_documents_that_give_other_rights_are_said(keymint, tmp_path: Path, distro: str, layout: str) -> None:
    """Nothing tells Crystal from Jazzy but its nodes; and of Ardent somebody wrote another distribution."""
    ws = installed_then(keymint, tmp_path / "ws", "ardent" if distro == "jazzy" else "crystal")
    edited(ws, _PROFILE, "</export>", f"<layout>{layout}</layout><distro>{distro}</distro></export>")
    found = asked(keymint, ws)
    assert {each["code"] for each in found} <= {"rights-changed", "rights-outlive"}
    said = [each for each in found if each["code"] == "rights-changed"]
    assert {each["subject"] for each in said} == {f"/{name}" for name in PACKAGES}
    assert "only the former ones permit to subscribe" in str(said[0]["message"])
    assert "only the new ones to subscribe" in str(said[0]["message"])
    assert [each for each in asked(keymint, ws) if each["code"] == "rights-changed"] == []  # said once


def test_new_documents_that_give_the_same_rights_cause_no_warning(keymint, tmp_path: Path) -> None:
    ws = installed_then(keymint, tmp_path / "ws", "crystal")
    edited(ws, _PROFILE, "</export>", "<layout>flat</layout><distro>crystal</distro></export>")
    assert asked(keymint, ws) == []


_PROFILE = "profile/keymint_profile.xml"
_DEFAULTS = "profile/profile.defaults/authorities.xml"
_MANIFEST = "src/talker/keymint_package.xml"


@pytest.mark.parametrize(
    ("path", "old", "new", "error"),
    [
        (_DEFAULTS, "SHA256", "SHA224", "<hash_algorithm> is 'SHA224', expected SHA256 or SHA384 or SHA512"),
        (_DEFAULTS, "SECP256R1", "SECT571K1", "<curve> is 'SECT571K1', expected SECP256R1 or SECP384R1"),
        (
            _DEFAULTS,
            "<ec><curve>SECP256R1</curve></ec>",
            "<dsa><key_size>2048</key_size></dsa>",
            "<dsa> is not expected here, expected <ec> or <rsa>",
        ),
        (_DEFAULTS, "<path_length>1", "<path_length>-1", "<path_length> is '-1', expected 0 or more"),
        (_DEFAULTS, "<ca>true", "<ca>false", "<path_length> is given for a certificate that is not an authority's"),
        (_DEFAULTS, "critical='true'", "critical='false'", "must be critical and CA:TRUE for an authority"),
        (
            _MANIFEST,
            "<permission>",
            "<permission><permission_path>more.xml</permission_path></permission><permission>",
            "there are two elements <permission> in <permissions> (a package has one document of each part: move",
        ),
        (
            _MANIFEST,
            "<issuer_name>",
            "<issuer_name>root_ca</issuer_name><issuer_name>",
            "there are two elements <issuer_name> in <permissions> (a package has one authority that signs them",
        ),
        (
            "profile/policies.xml",
            "<config_dir>comarmor.d",
            "<config_dir>config.d",
            "<config_dir> names another folder than <profile_dir>, but includes are relative to the file that has them",
        ),
        (
            "src/talker/identities.xml",
            "</cert>",
            "<extensions><BasicConstraints critical='1'><ca>1</ca></BasicConstraints></extensions></cert>",
            "would make an identity an authority (leave it out for the default)",
        ),
    ],
)
def test_what_cannot_be_had_today_says_what_to_do(
    keymint, tmp_path: Path, path: str, old: str, new: str, error: str
) -> None:
    ws = tmp_path / "ws"
    write(ws)
    edited(ws, path, old, new)
    keymint("create", "--all", "-w", ws)
    keymint("build", "-w", ws)
    outcome = keymint("install", "-w", ws)
    found = "".join(keymint(verb, "-w", ws).err for verb in ("build", "install")) + outcome.err
    assert outcome.code != 0
    assert f"{path}:" in found
    assert error in found
    assert not (ws / "install" / "enclaves").exists()
