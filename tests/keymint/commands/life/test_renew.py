# SPDX-License-Identifier: Apache-2.0
"""``keymint renew``."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from keymint_ros import package_type

from keymint.api import Issuance
from keymint.pki import certificates, keys, revocation_lists
from tests.conftest import NOW, Outcome, snapshot
from tests.keymint.stages.keystores import AUTHORITY_KEYS, IDENTITY_KEYS, content, public_key

DAY = 86_400
DUE = 250
"""Days after which certificates of a year are due."""
PACKAGES = ("talker", "robot1/listener")


def at(days: float) -> Mapping[str, str]:
    """The clock of a run, some days after the workspace was made."""
    return {"SOURCE_DATE_EPOCH": str(int(NOW + days * DAY))}


def moment(days: float) -> datetime:
    return datetime.fromtimestamp(NOW + days * DAY, UTC)


def certificate(ws: Path, name: str) -> x509.Certificate:
    return certificates.load((ws / "install/enclaves" / name / "cert.pem").read_bytes())


def renewed(outcome: Outcome) -> list[str]:
    return [each["subject"] for each in outcome.document["result"]["renewed"]]


def enclave(ws: Path, name: str) -> Mapping[str, tuple[int, int, bytes]]:
    return snapshot(ws / "install/enclaves" / name)


def shorten(ws: Path, name: str, length: str) -> None:
    """Give a package a validity of its own, in its certificate."""
    path = ws / "src" / name / "identities.xml"
    begin = datetime.fromtimestamp(NOW - DAY, UTC)
    validity = f"<validity><not_before>{begin:%Y-%m-%dT%H:%M:%S}</not_before><duration>{length}</duration></validity>"
    path.write_text(path.read_text().replace("<identity/>", f"<identity><cert>{validity}</cert></identity>"))


def install(keymint: Callable, ws: Path, env: Mapping[str, str] | None = None) -> None:
    for verb in ("build", "install"):
        outcome = keymint(verb, cwd=ws, env=env)
        assert outcome.code == 0, outcome.err


class TestDue:
    def test_a_state_says_why_and_a_long_time_is_said_to_be_cut(self, keymint: Callable, ws: Path) -> None:
        outcome = keymint("renew", "--state", "due", "--dry-run", "--json", cwd=ws, env=at(DUE))
        assert {each["why"] for each in outcome.document["result"]["renewed"]} <= {"certificate", "permissions"}
        assert all(each["ends"] and each["due"] for each in outcome.document["result"]["renewed"])
        assert "as requested" not in keymint("renew", "--state", "due", "--dry-run", cwd=ws, env=at(DUE)).out
        cut = "the time of --threshold is more than half of a validity; due after that half: /robot1/listener, /talker"
        assert cut in keymint("renew", "--threshold", "200d", cwd=ws).out
        assert "more than half" not in keymint("renew", "--threshold", "30d", cwd=ws).out

    def test_check_does_not_lead_to_a_renewal_that_changes_nothing(self, keymint: Callable, ws: Path) -> None:
        (longer,) = {
            each["help"]
            for each in keymint("check", "--within", "300d", "--json", cwd=ws, env=at(DUE)).document["diagnostics"]
            if each["code"] == "certificate-expires" and each["subject"] == "/talker"
        }
        assert "keymint renew talker" in longer
        outcome = keymint("check", "--within", "500d", "--no-prove", "--json", cwd=ws)
        found = [
            each for each in outcome.document["diagnostics"] if each["code"] in {"certificate-expires", "grant-expires"}
        ]
        assert found
        assert not [each for each in found if "renew" in each["help"]]

    def test_nothing_is_due_in_a_new_workspace(self, keymint: Callable, ws: Path) -> None:
        keymint("renew", cwd=ws)  # the workspace is a copy, whose files this run looks at
        before = snapshot(ws)
        outcome = keymint("renew", cwd=ws)
        assert (outcome.code, outcome.out.splitlines()[0]) == (
            0,
            "nothing is due; next is /robot1/listener, from 2027-09-11T21:36:00Z on",
        )
        assert snapshot(ws) == before

    def test_what_is_due_gets_new_dates_and_nothing_else(self, keymint: Callable, ws: Path) -> None:
        before = {name: certificate(ws, name) for name in PACKAGES}
        keys = {name: (ws / IDENTITY_KEYS[index]).read_bytes() for index, name in enumerate(PACKAGES)}
        authorities = {path: public_key(ws / path) for path in AUTHORITY_KEYS}
        governance = {name: enclave(ws, name)["governance.p7s"] for name in PACKAGES}
        outcome = keymint("renew", cwd=ws, env=at(DUE))
        assert outcome.code == 0, outcome.err
        for name in PACKAGES:
            old, new = before[name], certificate(ws, name)
            assert f"renewed /{name}: its certificate ends on 2028-01-14" in outcome.out
            assert (new.subject, new.issuer, new.public_key()) == (old.subject, old.issuer, old.public_key())
            assert new.serial_number != old.serial_number
            assert new.not_valid_before_utc == moment(DUE).replace(hour=0) - timedelta(days=1)
            length = new.not_valid_after_utc - new.not_valid_before_utc
            assert length == old.not_valid_after_utc - old.not_valid_before_utc
            assert enclave(ws, name)["governance.p7s"] == governance[name]
        assert {name: (ws / IDENTITY_KEYS[index]).read_bytes() for index, name in enumerate(PACKAGES)} == keys
        assert {path: public_key(ws / path) for path in AUTHORITY_KEYS} == authorities
        assert "deploy and restart before the old documents expire: /robot1/listener, /talker" in outcome.out
        for verb in ("check", "prove"):
            assert keymint(verb, cwd=ws, env=at(DUE)).code == 0
        status = keymint("status", "--json", cwd=ws, env=at(DUE)).document["result"]["packages"]
        assert {each["stale"] for each in status} == {None}

    def test_again_there_is_nothing_to_do(self, keymint: Callable, ws: Path) -> None:
        assert keymint("renew", cwd=ws, env=at(DUE)).code == 0
        before = snapshot(ws)
        outcome = keymint("renew", cwd=ws, env=at(DUE + 1))
        assert (outcome.code, renewed(keymint("renew", "--json", cwd=ws, env=at(DUE + 1)))) == (0, [])
        assert "nothing is due" in outcome.out
        assert snapshot(ws) == before

    def test_an_enclave_that_is_not_due_keeps_every_file(self, keymint: Callable, ws: Path) -> None:
        shorten(ws, "talker", "P30D")
        install(keymint, ws)
        before = enclave(ws, "robot1/listener"), snapshot(ws / "src/robot1"), snapshot(ws / "build/robot1")
        outcome = keymint("renew", "--json", cwd=ws, env=at(25))
        assert (outcome.code, renewed(outcome)) == (0, ["/talker"])
        [row] = outcome.document["result"]["renewed"]
        assert (row["why"], row["ends"][:10], row["until"][:10]) == ("certificate", "2027-02-13", "2027-03-10")
        assert before == (
            enclave(ws, "robot1/listener"), snapshot(ws / "src/robot1"), snapshot(ws / "build/robot1")
        )  # fmt: skip
        assert keymint("check", cwd=ws, env=at(25)).code == 0

    def test_the_earliest_document_decides(self, keymint: Callable, ws: Path) -> None:
        path = ws / "profile/package.defaults/permissions.xml"
        end = "<not_after>2028-01-14T00:00:00</not_after>"
        path.write_text(path.read_text().replace(end, "<duration>P20D</duration>"))
        install(keymint, ws)
        outcome = keymint("renew", "--json", cwd=ws, env=at(15))
        assert {each["why"] for each in outcome.document["result"]["renewed"]} == {"permissions"}
        assert len(outcome.document["result"]["renewed"]) == 2
        assert f"{moment(15 + 19):%Y-%m-%d}" in (ws / "install/enclaves/talker/permissions.xml").read_text()

    @pytest.mark.parametrize(
        ("threshold", "days", "count"), [("50%", 180, 0), ("50%", 183, 2), ("30d", 330, 0), ("30d", 335, 2)]
    )
    def test_the_threshold(self, keymint: Callable, ws: Path, threshold: str, days: int, count: int) -> None:
        outcome = keymint("renew", "--threshold", threshold, "--dry-run", "--json", cwd=ws, env=at(days))
        assert (outcome.code, len(renewed(outcome))) == (3 if count else 0, count)

    @pytest.mark.parametrize("threshold", ["0%", "100%", "66", "x", "-1d", "%"])
    def test_no_threshold(self, keymint: Callable, ws: Path, threshold: str) -> None:
        assert keymint("renew", "--threshold", threshold, cwd=ws).code == 2

    def test_dry_run_writes_nothing(self, keymint: Callable, ws: Path) -> None:
        before = snapshot(ws)
        outcome = keymint("renew", "--dry-run", cwd=ws, env=at(DUE))
        assert outcome.code == 3
        assert "would renew /talker" in outcome.out
        assert snapshot(ws) == before
        assert keymint("renew", "--dry-run", cwd=ws).code == 0

    def test_an_expired_enclave_is_renewed(self, keymint: Callable, ws: Path) -> None:
        assert keymint("renew", cwd=ws, env=at(500)).code == 0
        assert keymint("check", cwd=ws, env=at(500)).code == 0

    def test_a_date_that_a_wrong_clock_wrote_is_taken_back(self, keymint: Callable, ws: Path) -> None:
        assert keymint("renew", "talker", cwd=ws, env=at(2000)).code == 0
        assert keymint("check", cwd=ws, env=at(10)).code == 3
        assert keymint("renew", "talker", cwd=ws, env=at(10)).code == 0
        assert keymint("check", cwd=ws, env=at(10)).code == 0


class TestNamed:
    def test_a_named_package_is_renewed_in_any_case(self, keymint: Callable, ws: Path) -> None:
        others = enclave(ws, "robot1/listener")
        outcome = keymint("renew", "/talker", cwd=ws, env=at(10))
        assert outcome.code == 0
        assert "renewed /talker: as requested; now in force until 2028-01-24" in outcome.out
        assert "next is /talker" not in outcome.out  # that was the date of what is replaced
        assert enclave(ws, "robot1/listener") == others

    def test_twice_on_one_day_gives_the_same(self, keymint: Callable, ws: Path) -> None:
        assert keymint("renew", "talker", cwd=ws, env=at(10)).code == 0
        before = snapshot(ws)
        assert keymint("renew", "talker", cwd=ws, env=at(10.1)).code == 0
        assert snapshot(ws) == before

    @pytest.mark.parametrize("options", [(), ("--dry-run",)])
    def test_what_began_today_is_not_renewed_again(self, keymint: Callable, ws: Path, options: tuple[str, ...]) -> None:
        before = enclave(ws, "talker")
        outcome = keymint("renew", "talker", *options, cwd=ws)
        stays = "/talker: nothing to renew: a new certificate would have the same dates"
        assert (outcome.code, outcome.out.splitlines()[0]) == (0, f"{stays}; in force until 2028-01-14T00:00:00Z")
        assert "renewed" not in outcome.out
        assert "updated" not in outcome.out
        result = keymint("renew", "talker", "--json", *options, cwd=ws).document["result"]
        assert (result["renewed"], result["unchanged"]) == ([], ["/talker"])
        assert enclave(ws, "talker") == before

    def test_of_two_one_is_renewed(self, keymint: Callable, ws: Path) -> None:
        assert keymint("renew", "talker", cwd=ws, env=at(10)).code == 0
        outcome = keymint("renew", *PACKAGES, "--json", cwd=ws, env=at(10))
        assert (renewed(outcome), outcome.document["result"]["unchanged"]) == (["/robot1/listener"], ["/talker"])

    def test_an_unknown_package(self, keymint: Callable, ws: Path) -> None:
        outcome = keymint("renew", "talkr", cwd=ws)
        assert outcome.code == 1
        assert "did you mean 'talker'?" in outcome.err

    def test_a_package_that_is_not_installed(self, keymint: Callable, ws: Path) -> None:
        shutil.rmtree(ws / "install/enclaves/talker")
        outcome = keymint("renew", "talker", "--json", cwd=ws)
        assert (outcome.code, outcome.codes()) == (1, ["enclave-missing"])
        assert renewed(keymint("renew", "--json", cwd=ws, env=at(DUE))) == ["/robot1/listener"]


class TestKeys:
    def test_rekey_makes_new_keys_of_what_is_due(self, keymint: Callable, ws: Path) -> None:
        shorten(ws, "talker", "P30D")
        install(keymint, ws)
        before = [(ws / path).read_bytes() for path in IDENTITY_KEYS]
        old = certificate(ws, "talker")
        assert renewed(keymint("renew", "--rekey", "--json", cwd=ws, env=at(25))) == ["/talker"]
        after = [(ws / path).read_bytes() for path in IDENTITY_KEYS]
        assert (after[0] != before[0], after[1] == before[1]) == (True, True)
        assert certificate(ws, "talker").public_key() != old.public_key()
        assert (ws / "install/enclaves/talker/key.pem").read_bytes() == after[0]
        assert keymint("check", cwd=ws, env=at(25)).code == 0

    def test_rekey_is_the_way_back_for_a_barred_key(self, keymint: Callable, ws: Path) -> None:
        stolen = certificate(ws, "talker")
        assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=ws).code == 0
        assert not (ws / "install/enclaves/talker").exists()
        refused = keymint("renew", "talker", "--json", cwd=ws)
        assert (refused.code, refused.codes()) == (1, ["key-barred"])
        assert keymint("renew", cwd=ws, env=at(DUE)).code == 0
        assert not (ws / "install/enclaves/talker").exists()
        outcome = keymint("renew", "--rekey", "talker", cwd=ws, env=at(DUE))
        assert outcome.code == 0, outcome.err
        assert "'keymint revoke" not in outcome.err, "its former key was revoked before"
        assert certificate(ws, "talker").public_key() != stolen.public_key()
        assert certificate(ws, "talker").subject != stolen.subject
        assert keymint("check", cwd=ws, env=at(DUE)).code == 0

    @pytest.fixture
    def robot(self, keymint: Callable, ws: Path) -> Path:
        """A workspace where the key of /talker is on the robot."""
        key = ec.derive_private_key(11, ec.SECP256R1()).public_key()
        for file, document in package_type.with_issuance(Issuance(public_key=keys.public_to_pem(key))).items():
            (ws / "src/talker" / file).write_bytes(document)
        (ws / IDENTITY_KEYS[0]).unlink()
        install(keymint, ws)
        return ws

    def test_a_key_elsewhere_gets_a_new_certificate(self, keymint: Callable, robot: Path) -> None:
        old = certificate(robot, "talker")
        outcome = keymint("renew", cwd=robot, env=at(DUE))
        assert outcome.code == 0, outcome.err
        assert certificate(robot, "talker").public_key() == old.public_key()
        assert certificate(robot, "talker").serial_number != old.serial_number
        assert not (robot / "install/enclaves/talker/key.pem").exists()
        assert "the key is not here: 'keymint bundle' carries the new documents to /talker" in outcome.out

    def test_a_new_key_elsewhere_needs_a_person(self, keymint: Callable, robot: Path) -> None:
        before = enclave(robot, "talker")
        outcome = keymint("renew", "--rekey", "--json", cwd=robot, env=at(DUE))
        assert (outcome.code, renewed(outcome)) == (3, ["/robot1/listener"])
        assert "request-needed" in outcome.codes()
        assert enclave(robot, "talker") == before


class TestAuthorities:
    END = 365 * 10

    def test_a_due_authority_is_reported_and_not_renewed(self, keymint: Callable, ws: Path) -> None:
        before = snapshot(ws / "public")
        days = self.END - 200
        outcome = keymint("renew", "--json", cwd=ws, env=at(days))
        assert outcome.code == 3
        assert outcome.codes().count("authority-due") == 2
        assert snapshot(ws / "public") == before
        due = outcome.document["result"]["authorities_due"]
        assert {each["authority"]: each["subjects"] for each in due} == {
            "identity_ca": ["/robot1/listener", "/talker"],
            "permissions_ca": ["/robot1/listener", "/talker"],
        }
        end = certificates.load((ws / "public/identity_ca.cert.pem").read_bytes()).not_valid_after_utc
        assert certificate(ws, "talker").not_valid_after_utc == end

    def test_what_only_its_authority_shortens_is_not_issued_again_and_again(self, keymint: Callable, ws: Path) -> None:
        days = self.END - 200
        assert keymint("renew", cwd=ws, env=at(days)).code == 3
        before = {name: enclave(ws, name) for name in PACKAGES}
        for later in (days + 1, days + 150, days + 190):
            outcome = keymint("renew", "--json", cwd=ws, env=at(later))
            assert (outcome.code, renewed(outcome)) == (3, [])
        assert {name: enclave(ws, name) for name in PACKAGES} == before

    def test_no_authority_is_due_while_it_cuts_nothing(self, keymint: Callable, ws: Path) -> None:
        outcome = keymint("renew", "--json", cwd=ws, env=at(self.END - 400))
        assert (outcome.code, outcome.document["result"]["authorities_due"]) == (0, [])

    def test_an_authority_that_ends_soon_is_due(self, keymint: Callable, ws: Path) -> None:
        assert keymint("renew", cwd=ws, env=at(self.END - 400)).code == 0
        outcome = keymint("renew", "--threshold", "500d", "--dry-run", "--json", cwd=ws, env=at(self.END - 399))
        assert "authority-due" in outcome.codes()

    def test_an_authority_that_the_profile_changed_is_not_renewed_on_the_way(self, keymint: Callable, ws: Path) -> None:
        path = ws / "profile/profile.defaults/authorities.xml"
        path.write_text(
            re.sub("<not_after>.*</not_after>", "<not_after>2047-01-01T00:00:00</not_after>", path.read_text())
        )
        before = snapshot(ws)
        outcome = keymint("renew", "--json", cwd=ws, env=at(DUE))
        assert (outcome.code, outcome.codes()) == (1, ["authority-changed"])
        assert snapshot(ws) == before


class TestWithoutTheKeysOfAuthorities:
    @pytest.mark.parametrize(("options", "code", "severity"), [((), 1, "error"), (("--dry-run",), 3, "warning")])
    def test_what_is_due_is_told_and_waits(
        self, keymint: Callable, ws: Path, options: tuple[str, ...], code: int, severity: str
    ) -> None:
        (ws / AUTHORITY_KEYS[0]).unlink()
        before = content(ws)
        outcome = keymint("renew", "--json", *options, cwd=ws, env=at(DUE))
        assert (outcome.code, renewed(outcome)) == (code, [])
        waiting = outcome.document["result"]["waiting"]
        assert [each["subject"] for each in waiting] == ["/robot1/listener", "/talker"]
        assert [each["severity"] for each in outcome.document["diagnostics"]] == [severity]
        assert (
            "/talker not renewed, a key for it is not here: its certificate ends on"
            in keymint("renew", *options, cwd=ws, env=at(DUE)).out
        )
        assert content(ws) == before

    def test_what_another_authority_signs_does_not_wait(self, keymint: Callable, ws: Path) -> None:
        profile, source = ws / "profile/authorities.xml", ws / "src/talker/identities.xml"
        other = '<authority name="other_ca"><cert><issuer_name></issuer_name></cert></authority>'
        profile.write_text(profile.read_text().replace("</authorities>", f"{other}</authorities>"))
        issuer = "<identity><cert><issuer_name>other_ca</issuer_name></cert></identity>"
        source.write_text(source.read_text().replace("<identity/>", issuer))
        assert keymint("build", cwd=ws).code == 0
        assert keymint("install", cwd=ws).code == 0
        (ws / "private/other_ca.key.pem").unlink()
        outcome = keymint("renew", "--json", cwd=ws, env=at(DUE))
        assert (outcome.code, renewed(outcome)) == (1, ["/robot1/listener"])
        assert [each["subject"] for each in outcome.document["result"]["waiting"]] == ["/talker"]

    def test_a_list_that_waits_is_not_said_to_be_renewed(self, keymint: Callable, ws: Path) -> None:
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
        assert keymint("crl", "--refresh", "--valid-for", "30d", cwd=ws).code == 0
        (ws / "private/identity_ca.key.pem").unlink()
        for options, code in (((), 1), (("--dry-run",), 3)):
            outcome = keymint("renew", *options, cwd=ws, env=at(25))
            assert (outcome.code, "renew the" in outcome.out, "renewed the" in outcome.out) == (code, False, False)
            assert "revocation list of identity_ca not renewed, its key is not here: " in outcome.out

    def test_nothing_is_needed_while_nothing_is_due(self, keymint: Callable, ws: Path) -> None:
        for path in AUTHORITY_KEYS:
            (ws / path).unlink()
        assert keymint("renew", cwd=ws).code == 0


class TestLists:
    def test_a_list_that_is_due_is_issued_again_for_everyone(self, keymint: Callable, ws: Path) -> None:
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
        path = ws / "public/identity_ca.crl.pem"
        whole = revocation_lists.load(path.read_bytes(), None)
        assert keymint("renew", "--json", cwd=ws, env=at(100)).document["result"]["lists"] == []
        shorter(ws, timedelta(days=30))
        install(keymint, ws)
        outcome = keymint("renew", "--json", cwd=ws, env=at(25))
        assert (outcome.code, renewed(outcome)) == (0, [])
        [row] = outcome.document["result"]["lists"]
        assert (row["authority"], row["why"]) == ("identity_ca", "revocation list")
        new = revocation_lists.load(path.read_bytes(), None)
        assert new.number > whole.number
        assert new.next_update - moment(25) == timedelta(days=30)
        for name in PACKAGES:
            assert (ws / "install/enclaves" / name / "crl.pem").read_bytes() == path.read_bytes()
        assert keymint("check", cwd=ws, env=at(25)).code == 0


def shorter(ws: Path, length: timedelta) -> None:
    """Replace the revocation list by one with another number that ends sooner."""
    from keymint.pki import keys

    path = ws / "public/identity_ca.crl.pem"
    present = revocation_lists.load(path.read_bytes(), None)
    authority = certificates.load((ws / "public/identity_ca.cert.pem").read_bytes())
    issuer = certificates.Issuer(authority, keys.from_pem((ws / AUTHORITY_KEYS[0]).read_bytes()))
    path.write_bytes(
        revocation_lists.issue(issuer, present.revocations, present.number + 1, moment(0), moment(0) + length)
    )


class TestDefects:
    def test_one_defect_does_not_keep_the_others_from_being_renewed(self, keymint: Callable, ws: Path) -> None:
        path = ws / "src/talker/permissions.xml"
        path.write_text(path.read_text().replace("<ros_publish/>", "<ros_publsh/>"))
        before = enclave(ws, "talker")
        outcome = keymint("renew", "--json", cwd=ws, env=at(DUE))
        assert (outcome.code, renewed(outcome)) == (1, ["/robot1/listener"])
        assert any(each["file"].endswith("src/talker/permissions.xml") for each in outcome.document["diagnostics"])
        assert enclave(ws, "talker") == before
        assert certificate(ws, "robot1/listener").not_valid_after_utc > moment(DUE + 300)

    def test_a_named_package_with_a_defect_changes_nothing(self, keymint: Callable, ws: Path) -> None:
        path = ws / "src/talker/permissions.xml"
        path.write_text(path.read_text().replace("<ros_publish/>", "<ros_publsh/>"))
        before = snapshot(ws)
        assert keymint("renew", "talker", "robot1/listener", cwd=ws, env=at(DUE)).code == 1
        assert snapshot(ws) == before

    def test_changed_sources_are_not_deployed_by_a_renewal(self, keymint: Callable, ws: Path) -> None:
        path = ws / "src/talker/permissions.xml"
        path.write_text(path.read_text().replace("/chatter", "/chatter2"))
        before = enclave(ws, "talker")
        outcome = keymint("renew", "--no-prove", "--json", cwd=ws, env=at(DUE))
        assert (outcome.code, renewed(outcome)) == (1, ["/robot1/listener"])
        assert "sources-changed" in outcome.codes()
        assert enclave(ws, "talker") == before

    def test_documents_that_permit_more_than_the_policy_are_not_renewed(self, keymint: Callable, ws: Path) -> None:
        policy = ws.parent / "policy.xml"
        policy.write_text(policy.read_text().replace("<permissions><ros_subscribe/>", "<permissions><ros_publish/>"))
        before = enclave(ws, "robot1/listener")
        outcome = keymint("renew", "--json", cwd=ws, env=at(DUE))
        assert (outcome.code, renewed(outcome)) == (1, ["/talker"])
        assert enclave(ws, "robot1/listener") == before

    @pytest.mark.parametrize("lost", [(".keymint",), (".keymint", "build")])
    def test_without_the_record_or_the_builds(self, keymint: Callable, ws: Path, lost: tuple[str, ...]) -> None:
        for each in lost:
            shutil.rmtree(ws / each)
        outcome = keymint("renew", "--json", cwd=ws, env=at(DUE))
        assert outcome.code == 0, outcome.out
        assert len(renewed(outcome)) == 2
        assert keymint("check", cwd=ws, env=at(DUE)).code == 0


def test_zenoh_a_renewed_router_makes_no_other_package_stale(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    made = keymint("provision", policy, "-w", "z", "--transport", "zenoh", "--no-prove")
    assert made.code == 0, made.err
    ws = tmp_path / "z"
    before = {name: enclave(ws, name) for name in PACKAGES}
    outcome = keymint("renew", "zenoh_router", cwd=ws, env=at(10))
    assert outcome.code == 0, outcome.err
    assert {name: enclave(ws, name) for name in PACKAGES} == before
    result = keymint("status", "--json", cwd=ws, env=at(10)).document["result"]
    assert {each["stale"] for each in (*result["packages"], *result["shared"])} == {None}
    assert keymint("check", cwd=ws, env=at(10)).code == 0


class TestDuringARollover:
    """While a second keystore is staged, a renewal renews it as well."""

    def test_the_second_keystore_stays_in_step(self, keymint: Callable, ws: Path) -> None:
        replace = ("authority", "replace", "identity_ca")
        assert keymint(*replace, cwd=ws).code == 0
        staged = ws / "install.next/enclaves/talker/cert.pem"
        before = certificates.load(staged.read_bytes())
        outcome = keymint("renew", "talker", cwd=ws, env=at(DUE))
        assert outcome.code == 0, outcome.err
        assert "deploy install.next/ as well, which was staged by 'authority replace': /talker" in outcome.out
        after = certificates.load(staged.read_bytes())
        assert after.not_valid_after_utc == certificate(ws, "talker").not_valid_after_utc > before.not_valid_after_utc
        outcome = keymint(*replace, "--phase", "end", cwd=ws, env=at(DUE))
        assert outcome.code == 0, outcome.err
        assert (ws / "install/enclaves/talker/cert.pem").read_bytes() == certificates.to_pem(after)
        assert keymint("check", cwd=ws, env=at(DUE)).code == 0

    def test_what_it_cannot_sign_is_deferred(self, keymint: Callable, ws: Path) -> None:
        assert keymint("authority", "replace", "identity_ca", cwd=ws).code == 0
        (ws / "private/identity_ca.next.key.pem").rename(ws / "elsewhere.pem")
        outcome = keymint("renew", "talker", cwd=ws, env=at(DUE))
        assert (outcome.code, certificate(ws, "talker").not_valid_after_utc > moment(DUE + 200)) == (3, True)
        assert "warning: the second keystore is deferred" in outcome.err
        assert "'keymint authority replace identity_ca' brings it up to date" in outcome.err
        (ws / "elsewhere.pem").rename(ws / "private/identity_ca.next.key.pem")
        for more in ((), ("--phase", "end")):
            assert keymint("authority", "replace", "identity_ca", *more, cwd=ws, env=at(DUE)).code == 0
