# SPDX-License-Identifier: Apache-2.0
"""``keymint revoke``, ``issued`` and ``crl``: who is out, what the others get, and what is never lost."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography import x509

from comarmor.text import hexadecimal
from keymint.life.register import REASONS
from tests.conftest import NOW, snapshot

NAMES = ("robot1/listener", "talker")


def crl(path: Path) -> x509.CertificateRevocationList:
    return x509.load_pem_x509_crl(path.read_bytes())


def certificate(workspace: Path, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((workspace / f"install/enclaves/{name}/cert.pem").read_bytes())


def test_nothing_revoked_no_list(provisioned: Path, keymint) -> None:
    assert not list(provisioned.rglob("*crl*"))
    shown = keymint("crl", cwd=provisioned)
    assert (shown.code, shown.out) == (0, "no revocation list: nothing was ever revoked\n")
    issued = keymint("issued", "--json", cwd=provisioned).document["result"]["certificates"]
    assert [each["subject"] for each in issued] == [f"/{name}" for name in NAMES]
    assert [int(each["serial"], 16) for each in issued] == [certificate(provisioned, n).serial_number for n in NAMES]
    assert {(each["generation"], each["revoked"]) for each in issued} == {(0, None)}
    assert (provisioned / "private/register.sqlite3").stat().st_mode & 0o777 == 0o600


def test_superseded(provisioned: Path, keymint) -> None:
    before = snapshot(provisioned / "install")
    old = certificate(provisioned, "talker")
    outcome = keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    assert outcome.code == 0, outcome.err
    new = certificate(provisioned, "talker")
    assert new.serial_number != old.serial_number
    assert new.public_key() == old.public_key()
    assert new.subject != old.subject
    assert [each.oid for each in new.subject] == [each.oid for each in old.subject]
    lists = {path.read_bytes() for path in (provisioned / "install/enclaves").rglob("crl.pem")}
    assert lists == {(provisioned / "public/identity_ca.crl.pem").read_bytes()}
    assert [each.serial_number for each in crl(provisioned / "public/identity_ca.crl.pem")] == [old.serial_number]
    after = snapshot(provisioned / "install")
    changed = {name for name, content in after.items() if before.get(name) != content and "." in name}
    assert changed == {
        "enclaves/robot1/listener/crl.pem", "enclaves/talker/crl.pem", "enclaves/talker/cert.pem",
        "enclaves/talker/permissions.p7s", "enclaves/talker/permissions.xml",
    }  # fmt: skip
    assert "deploy and restart 1 enclave: /robot1/listener" in outcome.out
    for verb in ("check", "prove", "install", "verify"):
        arguments = ("-i", "omg") if verb == "verify" else ()
        assert keymint(verb, *arguments, cwd=provisioned).code == 0, verb
    subprocess.run(
        ["openssl", "verify", "-crl_check", "-attime", "1800000000", "-CAfile", "identity_ca.cert.pem",
         "-CRLfile", "crl.pem", "cert.pem"],
        cwd=provisioned / "install/enclaves/talker", check=True, capture_output=True,
    )  # fmt: skip


@pytest.mark.parametrize("reason", [each for each in REASONS if each != "superseded"])
def test_nothing_is_issued_for_a_key_that_was_given_up(provisioned: Path, keymint, reason: str) -> None:
    old = certificate(provisioned, "talker").serial_number
    outcome = keymint("revoke", "/talker", "--reason", reason, cwd=provisioned)
    assert outcome.code == 0, outcome.err
    assert not (provisioned / "install/enclaves/talker").exists()
    assert [each.serial_number for each in crl(provisioned / "install/enclaves/robot1/listener/crl.pem")] == [old]
    assert (provisioned / "private/identities/talker/key.pem").exists()
    before = snapshot(provisioned / "install")
    for verb in (("build",), ("install",), ("check",), ("prove",), ("verify", "-i", "omg"), ("install", "talker")):
        assert keymint(*verb, cwd=provisioned).code == 0, verb
    assert snapshot(provisioned / "install") == before
    rows = keymint("status", "--json", cwd=provisioned).document["result"]["packages"]
    assert {row["package"]: row["stage"] for row in rows} == {"talker": "revoked", "robot1/listener": "installed"}


def test_a_new_key_after_a_compromise(provisioned: Path, keymint) -> None:
    old = certificate(provisioned, "talker")
    keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned)
    assert keymint("build", "--rekey", "talker", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0
    new = certificate(provisioned, "talker")
    assert new.public_key() != old.public_key()
    assert new.subject != old.subject
    assert keymint("check", cwd=provisioned).code == 0
    assert (provisioned / "install/enclaves/talker/crl.pem").exists()


def test_the_former_key_of_a_new_one(provisioned: Path, keymint) -> None:
    rekeyed = keymint("renew", "--rekey", "talker", cwd=provisioned)
    key = certificate(provisioned, "talker").public_key()
    lost = keymint("revoke", "talker", "--reason", "key-compromise", "--dry-run", "--json", cwd=provisioned)
    assert (lost.code, lost.codes()) == (0, ["keys-given-up"])
    words = rekeyed.err.split("'keymint ")[1].split("'")[0].split()
    ended = keymint(*words, "--json", cwd=provisioned)
    assert (ended.code, ended.codes(), len(ended.document["result"]["revoked"])) == (0, [], 2)
    assert certificate(provisioned, "talker").public_key() == key
    assert keymint("check", cwd=provisioned).code == 0
    assert keymint("revoke", "talker", "--reason", "key-compromise", "--json", cwd=provisioned).codes() == []


def test_numbers_rise_and_revocations_stay(provisioned: Path, keymint) -> None:
    numbers, serials = [], []
    for _ in range(3):
        serials.append(certificate(provisioned, "talker").serial_number)
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned).code == 0
        found = crl(provisioned / "install/enclaves/talker/crl.pem")
        numbers.append(found.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number)
        assert {each.serial_number for each in found} == {*serials}
    assert numbers == [1, 2, 3]
    assert keymint("crl", "--refresh", cwd=provisioned).code == 0
    shown = keymint("crl", "--json", cwd=provisioned).document["result"]["lists"]
    assert [(each["number"], {int(one["serial"], 16) for one in each["revoked"]}) for each in shown] == [
        (4, {*serials})
    ]
    assert {one["subject"] for one in shown[0]["revoked"]} == {"/talker"}


def test_a_subject_whose_sources_are_gone(provisioned: Path, keymint, policy: Path) -> None:
    for path in sorted((provisioned / "src/talker").rglob("*"), reverse=True):
        path.unlink()
    (provisioned / "src/talker").rmdir()
    outcome = keymint("revoke", "talker", "--reason", "retired", cwd=provisioned)
    assert outcome.code == 0, outcome.err
    assert not (provisioned / "install/enclaves/talker").exists()
    assert len(crl(provisioned / "install/enclaves/robot1/listener/crl.pem")) == 1


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("nobody", "--reason", "retired"), 1, "/nobody never had a certificate here"),
        (("talke", "--reason", "retired"), 1, "did you mean"),
        (("talker",), 2, "--reason"),
        (("talker", "--reason", "stolen"), 2, "superseded"),
        (("../talker", "--reason", "retired"), 1, "is not a legal name"),
    ],
)
def test_bad_input_changes_nothing(
    provisioned: Path, keymint, arguments: tuple[str, ...], code: int, message: str
) -> None:
    before = snapshot(provisioned)
    outcome = keymint("revoke", *arguments, cwd=provisioned)
    assert outcome.code == code, outcome.err
    assert message in outcome.err
    assert snapshot(provisioned) == before


def test_a_dry_run_does_not_say_that_it_revoked(provisioned: Path, keymint) -> None:
    outcome = keymint("revoke", "talker", "--reason", "retired", "--dry-run", cwd=provisioned)
    assert outcome.out.startswith("would revoke /talker serial ")


def test_dry_run_changes_nothing(provisioned: Path, keymint) -> None:
    before = snapshot(provisioned)
    outcome = keymint("revoke", "talker", "--reason", "retired", "--dry-run", "--json", cwd=provisioned)
    assert outcome.code == 0, outcome.err
    assert outcome.document["result"]["restart"] == ["/robot1/listener"]
    assert snapshot(provisioned) == before


def test_twice(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "retired", cwd=provisioned)
    before = snapshot(provisioned)
    again = keymint("revoke", "talker", "--reason", "retired", cwd=provisioned)
    assert again.code == 0
    assert "nothing to do" in again.out
    other = keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned)
    assert other.code == 1
    assert "was revoked on 2027-01-15 already (retired)" in other.err
    assert snapshot(provisioned) == before


def test_check_and_prove_lead_from_a_revoked_enclave_to_a_new_key(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "retired", cwd=provisioned)
    for words, code in ((("check",), 0), (("check", "talker"), 0), (("prove", "talker"), 3)):
        outcome = keymint(*words, cwd=provisioned)
        assert outcome.code == code, outcome.err
        assert "certificate of /talker was revoked (retired)" in outcome.err
        assert "'keymint renew --rekey talker'" in outcome.err
        assert "keymint install" not in outcome.err


def test_the_register_is_restored_from_what_is_installed(provisioned: Path, keymint) -> None:
    register = provisioned / "private/register.sqlite3"
    before = keymint("issued", "--json", cwd=provisioned).document["result"]["certificates"]
    register.unlink()
    after = keymint("issued", "--json", cwd=provisioned).document["result"]["certificates"]
    unknown = {"rights": None, "issued": None}
    assert [each | unknown for each in after] == [each | unknown for each in before]
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned).code == 0


def test_a_lost_register_with_revocations_is_the_owners_decision(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned)
    before = crl(provisioned / "public/identity_ca.crl.pem")
    (provisioned / "private/register.sqlite3").unlink()
    for verb in (("issued",), ("revoke", "robot1/listener", "--reason", "superseded")):
        lost = keymint(*verb, cwd=provisioned)
        assert lost.code == 1
        assert "the register of issued certificates is missing, and /talker had been revoked" in lost.err
    assert (
        hexadecimal(before[0].serial_number) in keymint("crl", cwd=provisioned).out
    )  # to look at a list takes no register
    assert keymint("crl", "--rebuild", cwd=provisioned).code == 0
    assert keymint("revoke", "robot1/listener", "--reason", "superseded", cwd=provisioned).code == 0
    after = crl(provisioned / "public/identity_ca.crl.pem")
    assert {each.serial_number for each in after} > {each.serial_number for each in before}


def test_a_register_made_again_bars_the_keys_of_what_was_revoked(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned)
    key = (provisioned / "private/identities/talker/key.pem").read_bytes()
    (provisioned / "private/register.sqlite3").unlink()
    lost = keymint("check", cwd=provisioned)
    assert "enclave-missing" not in lost.err
    assert keymint("install", "talker", cwd=provisioned).code == 1
    assert keymint("crl", "--rebuild", cwd=provisioned).code == 0
    assert "was revoked" in keymint("check", "-v", cwd=provisioned).err
    keymint("install", "talker", cwd=provisioned)
    keymint("provision", "-f", cwd=provisioned)
    assert not (provisioned / "install/enclaves/talker").exists()
    again = keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned)
    assert "already (unspecified)" in again.err
    assert keymint("renew", "--rekey", "talker", cwd=provisioned).code == 0
    assert (provisioned / "private/identities/talker/key.pem").read_bytes() != key
    assert keymint("check", cwd=provisioned).code == 0


def test_lists_of_enclaves_alone_and_a_lost_register_are_told(provisioned: Path, keymint) -> None:
    register = provisioned / "private/register.sqlite3"
    old = register.read_bytes()
    keymint("revoke", "talker", "--reason", "retired", cwd=provisioned)
    register.write_bytes(old)
    (provisioned / "public/identity_ca.crl.pem").unlink()
    shown = keymint("crl", cwd=provisioned)
    assert "nothing was ever revoked" not in shown.out
    assert "'keymint crl --rebuild'" in shown.err
    register.unlink()
    assert keymint("crl", "--rebuild", cwd=provisioned).code == 0
    assert len([*crl(provisioned / "public/identity_ca.crl.pem")]) == 1


def test_check_tells_that_the_register_is_missing(provisioned: Path, keymint) -> None:
    (provisioned / "private/register.sqlite3").unlink()
    outcome = keymint("check", cwd=provisioned)
    assert outcome.code == 0
    assert "private/register.sqlite3: note: is missing: which certificates were issued" in outcome.err


def test_an_old_register_does_not_take_revocations_back(provisioned: Path, keymint) -> None:
    register = provisioned / "private/register.sqlite3"
    old = register.read_bytes()
    keymint("revoke", "talker", "--reason", "retired", cwd=provisioned)
    register.write_bytes(old)
    before = snapshot(provisioned)
    outcome = keymint("revoke", "robot1/listener", "--reason", "superseded", cwd=provisioned)
    assert outcome.code == 1
    assert "it is older than the list" in outcome.err
    assert snapshot(provisioned) == before


def test_a_list_in_an_enclave_is_not_removed_because_all_others_are_lost(provisioned: Path, keymint) -> None:
    register = provisioned / "private/register.sqlite3"
    old, stolen = register.read_bytes(), certificate(provisioned, "talker").serial_number
    keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned)
    register.write_bytes(old)
    (provisioned / "public/identity_ca.crl.pem").unlink()
    before = snapshot(provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert (outcome.code, "revokes certificates that the new list does not" in outcome.err) == (1, True)
    assert snapshot(provisioned) == before
    register.unlink()
    assert keymint("crl", "--rebuild", cwd=provisioned).code == 0
    found = crl(provisioned / "public/identity_ca.crl.pem")
    assert [each.serial_number for each in found] == [stolen]
    assert found.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number == 2


def test_an_old_register_does_not_hide_what_is_installed(provisioned: Path, keymint) -> None:
    register = provisioned / "private/register.sqlite3"
    old = register.read_bytes()
    assert keymint("renew", "--rekey", "talker", cwd=provisioned).code == 0
    stolen = certificate(provisioned, "talker").serial_number
    register.write_bytes(old)
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
    assert stolen in {each.serial_number for each in crl(provisioned / "public/identity_ca.crl.pem")}
    assert not (provisioned / "install/enclaves/talker").exists()


def test_the_key_of_an_expired_certificate_may_be_given_up(provisioned: Path, keymint) -> None:
    late = {"SOURCE_DATE_EPOCH": str(NOW + 400 * 86400)}
    assert keymint("renew", "talker", cwd=provisioned, env=late).code == 0
    names = ("talker", "robot1/listener")  # of which one expired
    superseded = keymint("revoke", *names, "--reason", "superseded", cwd=provisioned, env=late)
    assert superseded.code == 0
    assert "the last certificate of /robot1/listener expired on 2028-01-14" in superseded.err
    assert keymint("revoke", *names, "--reason", "key-compromise", cwd=provisioned, env=late).code == 0
    assert keymint("renew", cwd=provisioned, env=late).code == 0
    assert not [*(provisioned / "install/enclaves").rglob("cert.pem")]


def test_an_enclave_whose_key_moves_into_a_token_is_removed_as_well(provisioned: Path, keymint) -> None:
    identities, profile = provisioned / "src/talker/identities.xml", provisioned / "profile/keymint_profile.xml"
    key = "<key><pkcs11>pkcs11:token=robot;object=talker</pkcs11></key>"
    identities.write_text(identities.read_text().replace("<identity/>", f"<identity>{key}</identity>"))
    accepted = "<exceptions><token_keys/></exceptions></profile>"
    profile.write_text(profile.read_text().replace("</profile>", accepted))
    assert keymint("build", cwd=provisioned).code == 0
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
    assert not (provisioned / "install/enclaves/talker").exists()
    assert "waits for a request" in keymint("install", cwd=provisioned).out


def test_after_all_were_revoked_check_finds_nothing(provisioned: Path, keymint) -> None:
    assert keymint("revoke", *NAMES, "--reason", "retired", cwd=provisioned).code == 0
    assert keymint("check", cwd=provisioned).code == 0
    (provisioned / "install/public/stray.pem").touch()
    (provisioned / "install/enclaves/governance.xml").write_bytes(b"")
    outcome = keymint("check", "--json", cwd=provisioned)
    assert [code for code in outcome.codes() if code != "identity-revoked"] == ["file-changed", "file-unexpected"]
    (name,) = re.findall("'keymint renew --rekey ([^']+)' restores it", str(outcome.document["diagnostics"]))
    (provisioned / "install/public/stray.pem").unlink()
    assert keymint("renew", "--rekey", name, cwd=provisioned).code == 0
    assert keymint("check", cwd=provisioned).code == 0


def test_after_all_but_the_router_were_revoked_check_finds_nothing(keymint, policy: Path) -> None:
    transports = ("--transport", "dds", "--transport", "zenoh")
    assert keymint("provision", policy, "-w", "ws", *transports).code == 0
    assert keymint("revoke", *NAMES, "--reason", "retired", "-w", "ws").code == 0
    assert keymint("check", "-w", "ws").code == 0


def test_a_clock_that_was_ahead_leaves_no_list_that_begins_later(provisioned: Path, keymint) -> None:
    ahead = {"SOURCE_DATE_EPOCH": str(NOW + 10 * 86400)}
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned, env=ahead).code == 0
    assert "revocation-list-not-yet-valid" in keymint("check", "--json", cwd=provisioned).codes()
    assert keymint("install", cwd=provisioned).code == 0
    found = crl(provisioned / "install/enclaves/robot1/listener/crl.pem")
    assert found.last_update_utc.timestamp() < NOW
    assert found.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number == 2


def test_a_damaged_list_is_issued_again_on_request(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    path = provisioned / "public/identity_ca.crl.pem"
    before = crl(path)
    path.write_bytes(b"")
    assert "'keymint crl --refresh' issues it again" in keymint("install", cwd=provisioned).err
    assert keymint("crl", "--refresh", cwd=provisioned).code == 0
    assert {each.serial_number for each in crl(path)} == {each.serial_number for each in before}
    assert crl(path).extensions.get_extension_for_class(x509.CRLNumber).value.crl_number == 2


def test_an_authority_that_expired_issues_no_list(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    late = {"SOURCE_DATE_EPOCH": str(NOW + 4000 * 86400)}
    before = snapshot(provisioned)
    for words in (("crl", "--refresh"), ("install",), ("revoke", "talker", "--reason", "key-compromise")):
        outcome = keymint(*words, "--json", cwd=provisioned, env=late)
        assert (outcome.code, outcome.codes()) == (1, ["authority-not-in-force"]), words
    assert snapshot(provisioned) == before
    for name in ("identity_ca", "permissions_ca"):
        assert keymint("authority", "renew", name, "--flag-day", cwd=provisioned, env=late).code == 0
    assert keymint("renew", cwd=provisioned, env=late).code == 0
    assert keymint("check", cwd=provisioned, env=late).code == 0


def test_a_short_list_is_not_due_at_once(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    assert keymint("crl", "--refresh", "--valid-for", "12h", cwd=provisioned).code == 0
    assert keymint("renew", "--json", cwd=provisioned).document["result"]["lists"] == []
    later = {"SOURCE_DATE_EPOCH": str(NOW + 8 * 3600)}
    assert keymint("renew", "--json", cwd=provisioned, env=later).document["result"]["lists"] != []
    found = crl(provisioned / "install/enclaves/talker/crl.pem")
    assert found.next_update_utc.timestamp() == NOW + 20 * 3600


def test_no_list_expires_at_once(provisioned: Path, keymint) -> None:
    outcome = keymint("crl", "--refresh", "--valid-for", "0h", cwd=provisioned)
    assert (outcome.code, "shorter than an hour" in outcome.err) == (2, True)


def test_old_sources_are_refused(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    (provisioned / "src/talker/issuance.xml").unlink()
    assert keymint("build", cwd=provisioned).code == 0
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "the sources have generation 0, but generation 1 is the lowest that may be issued" in outcome.err


def test_distributions_that_read_no_list(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--distro", "foxy").code == 0
    outcome = keymint("revoke", "talker", "--reason", "retired", "-w", "ws")
    assert outcome.code == 0
    assert "nodes of foxy with the layout 'sros2' read no revocation list" in outcome.err
    assert not list((tmp_path / "ws/install").rglob("crl.pem"))


@pytest.mark.parametrize(
    ("reason", "fit"), [("superseded", "still match the new"), ("key-compromise", "would match a later")]
)
def test_the_subject_format_of_sros2_has_no_generation(keymint, policy: Path, reason: str, fit: str) -> None:
    assert keymint("provision", policy, "-w", "ws", "--subject-format", "sros2").code == 0
    outcome = keymint("revoke", "talker", "--reason", reason, "-w", "ws")
    assert outcome.code == 0
    assert f"the subject name has no generation: permissions signed before {fit}" in outcome.err


def test_narrower_rights(provisioned: Path, keymint, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/chatter<", "<attachment>/other<"))
    for verb in (("create", "--all"), ("build",)):
        assert keymint(*verb, cwd=provisioned).code == 0
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 0
    assert (
        "more than the policy, e.g. to publish 'rt/chatter'; whoever has its key may present them until" in outcome.err
    )
    assert "'keymint revoke talker --reason superseded' ends them" in outcome.err
    policy.write_text(policy.read_text().replace("<attachment>/other<", "<attachment>/*<"))
    for verb in (("create", "--all"), ("build",)):
        assert keymint(*verb, cwd=provisioned).code == 0
    wider = keymint("install", cwd=provisioned)
    assert wider.code == 0
    assert "more than the policy" not in wider.err


def test_earlier_rights_that_have_ended_are_no_news(provisioned: Path, keymint, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/chatter<", "<attachment>/other<"))
    for days, expected in ((400, False), (200, True)):
        shutil.copytree(provisioned, provisioned.with_name(str(days)))
        late = {"SOURCE_DATE_EPOCH": str(NOW + days * 86400)}
        outcome = keymint("provision", policy, "-w", provisioned.with_name(str(days)), "--json", env=late)
        assert ("rights-outlive" in outcome.codes()) == expected


@pytest.mark.parametrize("way", ["install", "provision", "profile"])
def test_narrower_rights_are_revoked_on_request(provisioned: Path, keymint, policy: Path, way: str) -> None:
    old = {name: certificate(provisioned, name).serial_number for name in NAMES}
    policy.write_text(policy.read_text().replace("<attachment>/chatter<", "<attachment>/other<"))
    if way == "profile":
        profile = provisioned / "profile/keymint_profile.xml"
        profile.write_text(profile.read_text().replace("</profile>", "<revoke_superseded/></profile>"))
    if way == "provision":
        outcome = keymint("provision", policy, "-w", provisioned, "--revoke-superseded")
    else:
        for verb in (("create", "--all"), ("build",)):
            assert keymint(*verb, cwd=provisioned).code == 0
        outcome = keymint("install", *(["--revoke-superseded"] if way == "install" else []), cwd=provisioned)
    assert outcome.code == 0, outcome.err
    assert "more than the policy" not in outcome.err
    found = crl(provisioned / "install/enclaves/talker/crl.pem")
    assert {each.serial_number for each in found} == set(old.values())
    for name in NAMES:
        assert certificate(provisioned, name).serial_number != old[name]
        permissions = (provisioned / f"install/enclaves/{name}/permissions.xml").read_text()
        assert "other" in permissions
    assert keymint("check", cwd=provisioned).code == 0
    assert "nothing to do" in keymint("install", cwd=provisioned).out


def test_install_completes_a_list_that_was_not_written(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    revoked = {each.serial_number for each in crl(provisioned / "public/identity_ca.crl.pem")}
    (provisioned / "public/identity_ca.crl.pem").unlink()
    assert keymint("install", cwd=provisioned).code == 0
    found = crl(provisioned / "install/enclaves/robot1/listener/crl.pem")
    assert {each.serial_number for each in found} == revoked
    assert found.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number == 2


def test_a_new_authority_begins_without_a_list(provisioned: Path, keymint) -> None:
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    assert keymint("install", "--new-authority", "identity_ca", cwd=provisioned).code == 0
    assert not list(provisioned.rglob("*crl.pem"))
    assert keymint("check", cwd=provisioned).code == 0


@pytest.mark.parametrize("reason", ["superseded", "retired"])
def test_on_zenoh_the_revoked_name_has_no_rights(keymint, policy: Path, tmp_path: Path, reason: str) -> None:
    made = keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "zenoh")
    assert made.code == 0, made.err
    router = tmp_path / "ws/install/zenoh/router.json5"
    own = '"cert_common_names": ["/talker"]'
    assert own in router.read_text()
    outcome = keymint("revoke", "talker", "--reason", reason, "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert own not in router.read_text()
    assert "deploy ws/install/zenoh/router.json5, ws/install/zenoh/router.json5.p7s" in outcome.out
    for verb in ("check", "prove"):
        done = keymint(verb, "-w", "ws")
        assert done.code == 0, (verb, done.out, done.err)


def test_a_router_is_revoked_like_a_robot(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh").code == 0
    outcome = keymint("revoke", "zenoh_router", "--reason", "superseded", "-w", "ws")
    assert outcome.code == 0, outcome.err
    for session in (tmp_path / "ws/install/enclaves").rglob("session.json5"):
        assert '"zenoh_router.1"' in session.read_text() or "/zenoh_router.1" in session.read_text()
    for verb in ("check", "prove"):
        done = keymint(verb, "-w", "ws")
        assert done.code == 0, (verb, done.out, done.err)


def test_a_shorter_list_is_counted_by_check_and_renewed(provisioned: Path, keymint) -> None:
    assert keymint("crl", "--valid-for", "30d", cwd=provisioned).code == 2
    keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned)
    assert keymint("crl", "--refresh", "--valid-for", "30d", cwd=provisioned).code == 0
    assert keymint("check", cwd=provisioned).code == 0
    soon = keymint("check", "--within", "40d", cwd=provisioned)
    assert soon.code == 3
    assert "the revocation list expires on 2027-02-14" in soon.err
    later = {"SOURCE_DATE_EPOCH": str(1_800_000_000 + 25 * 86400)}
    assert keymint("renew", cwd=provisioned, env=later).code == 0
    after = crl(provisioned / "install/enclaves/talker/crl.pem")
    assert after.next_update_utc.isoformat() == "2027-03-11T08:00:00+00:00"
    assert len(after) == 1


def test_a_pruned_enclave_is_not_revoked_and_that_is_said(provisioned: Path, keymint) -> None:
    for path in sorted((provisioned / "src/talker").rglob("*"), reverse=True):
        path.unlink()
    (provisioned / "src/talker").rmdir()
    outcome = keymint("install", "--prune", "--no-prove", cwd=provisioned)
    assert outcome.code == 0
    assert "the certificate of the removed enclave /talker remains valid until 2028-01-14" in outcome.err
    assert keymint("revoke", "talker", "--reason", "retired", cwd=provisioned).code == 0
    assert len(crl(provisioned / "install/enclaves/robot1/listener/crl.pem")) == 1


@pytest.mark.parametrize("reason", ["superseded", "retired"])
def test_sources_that_are_made_again_go_on_with_the_generation(
    provisioned: Path, keymint, policy: Path, reason: str
) -> None:
    keymint("revoke", "talker", "--reason", reason, cwd=provisioned)
    for path in sorted((provisioned / "src/talker").rglob("*"), reverse=True):
        path.unlink()
    (provisioned / "src/talker").rmdir()
    again = keymint("provision", policy, "-w", provisioned)
    assert again.code == 0, again.err
    assert "<generation>1</generation>" in (provisioned / "src/talker/issuance.xml").read_text()
    if reason == "retired":
        assert not (provisioned / "install/enclaves/talker").exists()
        assert keymint("renew", "--rekey", "talker", cwd=provisioned).code == 0
    assert (provisioned / "install/enclaves/talker/cert.pem").exists()
    assert keymint("check", cwd=provisioned).code == 0


def test_documents_are_built_as_they_were(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--no-optimise").code == 0
    permissions = tmp_path / "ws/install/enclaves/talker/permissions.xml"
    before = permissions.read_text()
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    after = permissions.read_text()
    assert after != before
    assert len(after) == len(before)  # the digest in the subject name alone
    assert "nothing to do" in keymint("build", "--no-optimise", "-w", "ws").out


def advice(err: str, verb: str) -> list[str]:
    """Return the words of the command in the help of an error."""
    (command,) = {each for each in re.findall("'keymint ([^']*)'", err) if each.startswith(verb)}
    return command.split()


def test_advice_after_the_sources_lost_their_generation_is_followed(provisioned: Path, keymint) -> None:
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned).code == 0
    (provisioned / "src/talker/issuance.xml").unlink()
    assert keymint("build", cwd=provisioned).code == 0
    refused = keymint("install", cwd=provisioned)
    assert (refused.code, "is the lowest that may be issued" in refused.err) == (1, True)
    outcome = keymint(*advice(refused.err, "revoke"), cwd=provisioned)
    assert outcome.code == 0, outcome.err
    assert keymint("check", cwd=provisioned).code == 0


def test_advice_after_a_key_was_given_up_is_followed_even_if_nothing_but_the_register_knows_it(
    provisioned: Path, keymint
) -> None:
    """It was a circle: nothing to renew, so install; its key is barred, so renew."""
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
    sources, register = provisioned / "private/identities/talker/key.pem", provisioned / "private/register.sqlite3"
    key = sources.read_bytes()
    issuance = (provisioned / "src/talker/issuance.xml").read_bytes()
    assert keymint("renew", "--rekey", "talker", cwd=provisioned).code == 0
    sources.write_bytes(key)
    (provisioned / "src/talker/issuance.xml").write_bytes(issuance)
    shutil.rmtree(provisioned / "install/enclaves/talker")
    shutil.rmtree(provisioned / ".keymint")
    assert register.exists()
    said = keymint("install", cwd=provisioned)
    outcome = keymint(*advice(said.out + said.err, "renew"), cwd=provisioned)
    assert outcome.code == 0, outcome.err
    assert keymint("check", cwd=provisioned).code == 0


class TestAnOlderRegister:
    """It was restored from a backup made before a revocation, and the list in the public space is lost as well."""

    @pytest.fixture
    def restored(self, provisioned: Path, keymint) -> Path:
        register = provisioned / "private/register.sqlite3"
        old = register.read_bytes()
        assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
        register.write_bytes(old)
        (provisioned / "public/identity_ca.crl.pem").unlink()
        return provisioned

    def test_certifies_no_key_whose_generation_it_does_not_know(self, restored: Path, keymint) -> None:
        shutil.rmtree(restored / "install")
        before = snapshot(restored)
        refused = keymint("install", cwd=restored)
        assert (refused.code, "[register-outdated]" in refused.err) == (1, True), refused.err
        assert "gave /talker the generation 1 in src/talker/issuance.xml: it is older" in refused.err
        assert snapshot(restored) == before
        (restored / "private/register.sqlite3").unlink()
        assert keymint(*advice(refused.err, "crl"), cwd=restored).code == 0
        assert keymint("install", cwd=restored).code == 0
        assert not (restored / "install/enclaves/talker").exists()

    def test_certifies_no_key_beside_a_list_that_other_enclaves_have(self, restored: Path, keymint) -> None:
        (restored / "src/talker/issuance.xml").unlink()
        assert keymint("build", cwd=restored).code == 0
        refused = keymint("install", "talker", cwd=restored)
        assert (refused.code, "revocations in install/enclaves/robot1/listener/crl.pem" in refused.err) == (1, True)
        assert not (restored / "install/enclaves/talker").exists()

    def test_is_not_made_again_without_the_list_that_enclaves_have(self, restored: Path, keymint) -> None:
        (restored / "src/talker/issuance.xml").unlink()
        (restored / "private/register.sqlite3").unlink()
        assert keymint("build", cwd=restored).code == 0
        refused = keymint("install", "talker", cwd=restored)
        assert (refused.code, "[register-lost]" in refused.err) == (1, True), refused.err

    def test_is_made_again_with_all_lists_though_one_is_older(self, provisioned: Path, keymint) -> None:
        """The list in the public space is from the backup as well."""
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned).code == 0
        public, register = provisioned / "public/identity_ca.crl.pem", provisioned / "private/register.sqlite3"
        before = {each: each.read_bytes() for each in (public, register)}
        (first,) = {each.serial_number for each in crl(public)}
        assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
        latest = {each.serial_number for each in crl(public)}
        assert first in latest
        assert len(latest) == 2
        for path, content in before.items():
            path.write_bytes(content)
        register.unlink()
        assert keymint("crl", "--rebuild", cwd=provisioned).code == 0
        assert keymint("install", cwd=provisioned).code == 0
        assert {each.serial_number for each in crl(public)} == latest
        assert not (provisioned / "install/enclaves/talker").exists()


@pytest.mark.parametrize("kind", [("--distro", "foxy"), ("--transport", "zenoh"), ("--transport", "dds")])
def test_an_enclave_that_reads_no_list_is_not_stale_afterwards(keymint, policy: Path, kind: tuple[str, str]) -> None:
    assert keymint("provision", policy, "-w", "ws", *kind).code == 0
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    status = keymint("status", "-w", "ws", "--json").document["result"]
    assert [each["stale"] for each in status["packages"] if each["stale"]] == []


@pytest.mark.parametrize("which", [NAMES[:1], NAMES])
def test_prove_and_report_say_which_were_revoked_and_ask_for_no_package(keymint, provisioned: Path, which) -> None:
    assert keymint("revoke", *which, "--reason", "retired", cwd=provisioned).code == 0
    outcome = keymint("prove", "--json", cwd=provisioned)
    assert (outcome.code, [each for each in outcome.codes() if each != "assumption"]) == (
        0,
        ["identity-revoked"] * len(which),
    )
    assert keymint("report", "-o", "audit.json", cwd=provisioned).code == 0
    codes = [each["code"] for each in json.loads((provisioned / "audit.json").read_text())["findings"]]
    assert codes.count("identity-revoked") == len(which)
    assert "subjects-uncreated" not in codes
