# SPDX-License-Identifier: Apache-2.0
"""What an authority decides about packages: planned into their sources, and what follows from it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from keymint_ros import RosPackageType, package_type

from keymint.api import Issuance
from keymint.errors import KeymintError
from keymint.life.package_issuance import plan_issuance
from keymint.pki import certificates, keys
from keymint.store.changes import Action
from tests.conftest import NOW, snapshot
from tests.keymint.stages.sessions import session_of

RENEWED = datetime.fromtimestamp(NOW, UTC).replace(hour=0, minute=0, second=0) + timedelta(days=100)
ROBOT = ec.derive_private_key(11, ec.SECP256R1())
ELSEWHERE = Issuance(public_key=keys.public_to_pem(ROBOT.public_key()))


def decide(ws: Path, name: str, issuance: Issuance) -> None:
    """Write what an authority decided about a package."""
    for file, content in package_type.with_issuance(issuance).items():
        (ws / "src" / name / file).write_bytes(content)


def certificate(ws: Path, name: str) -> x509.Certificate:
    return certificates.load((ws / "install/enclaves" / name / "cert.pem").read_bytes())


def reissue(keymint: Callable, ws: Path) -> None:
    for verb in ("build", "install"):
        outcome = keymint(verb, cwd=ws)
        assert outcome.code == 0, outcome.err


class TestPlan:
    def test_it_writes_one_file_of_each_package(self, ws: Path) -> None:
        session = session_of(ws)
        new = {"talker": Issuance(1), "robot1/listener": Issuance(renewed=RENEWED)}
        plan = plan_issuance(session, "revoke", new, "revoked")
        assert [(step.stage, step.package, step.action, step.detail) for step in plan.steps] == [
            ("revoke", "talker", Action.UPDATED, "revoked"),
            ("revoke", "robot1/listener", Action.UPDATED, "revoked"),
        ]
        assert [[*change.files] for step in plan.steps for change in step.changes] == [["issuance.xml"]] * 2
        after = session.after(plan)
        assert {name: after.issuance(name) for name in new} == new
        assert session.issuance("talker") == Issuance()
        assert not plan_issuance(after, "revoke", new).writes()

    def test_the_file_is_no_edit_of_the_owner(self, ws: Path) -> None:
        session = session_of(ws)
        state = session.after(plan_issuance(session, "revoke", {"talker": Issuance(1)})).state
        stamp = state.stamp("create", "talker")
        assert stamp
        assert "issuance.xml" in stamp.outputs

    def test_a_generation_never_falls(self, ws: Path) -> None:
        decide(ws, "talker", Issuance(2))
        with pytest.raises(KeymintError, match="has generation 2, and would fall to 1") as error:
            plan_issuance(session_of(ws), "revoke", {"talker": Issuance(1)})
        assert str(error.value.diagnostics[0].where).endswith("src/talker/issuance.xml")

    def test_a_fixed_serial_number_is_not_given_twice(self, ws: Path) -> None:
        path = ws / "src/talker/identities.xml"
        cert = "<identity><cert><serial_number>7</serial_number></cert></identity>"
        path.write_text(path.read_text().replace("<identity/>", cert))
        for new in (Issuance(1), Issuance(renewed=RENEWED)):
            with pytest.raises(KeymintError, match="give the serial number 7") as error:
                plan_issuance(session_of(ws), "renew", {"talker": new})
            assert "src/talker/identities.xml:" in str(error.value)
        plan_issuance(session_of(ws), "sign", {"talker": ELSEWHERE})

    def test_a_package_type_without_the_capability(self, ws: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A package type of a third party, made before there was the capability, goes on working."""
        for name in ("issuance", "with_issuance", "ISSUANCE"):
            monkeypatch.delattr(RosPackageType, name)
        session = session_of(ws)
        assert session.issuance("talker") == Issuance()
        with pytest.raises(KeymintError, match="can neither be renewed nor revoked"):
            plan_issuance(session, "renew", {"talker": Issuance(1)})


class TestDocuments:
    def test_generation_0_changes_no_byte(self, keymint: Callable, ws: Path) -> None:
        before = {name: found[2] for name, found in _installed(ws).items()}
        decide(ws, "talker", Issuance())
        reissue(keymint, ws)
        assert {name: found[2] for name, found in _installed(ws).items()} == before

    def test_certificate_and_grant_are_of_one_generation(self, keymint: Callable, ws: Path) -> None:
        before, others = certificate(ws, "talker"), _enclave(ws, "robot1/listener")
        assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
        after = certificate(ws, "talker")
        assert after.subject != before.subject
        assert after.public_key() == before.public_key()
        assert after.not_valid_after_utc == before.not_valid_after_utc
        assert keymint("check", cwd=ws).code == 0
        assert keymint("prove", cwd=ws).code == 0
        assert {**_enclave(ws, "robot1/listener"), "crl.pem": None} == {**others, "crl.pem": None}
        old = keymint("status", cwd=ws).out
        assert "build" not in old

    def test_renewal_moves_certificate_and_grant(self, keymint: Callable, ws: Path) -> None:
        before, others = certificate(ws, "talker"), _enclave(ws, "robot1/listener")
        old = (ws / "install/enclaves/talker/permissions.xml").read_text()
        decide(ws, "talker", Issuance(renewed=RENEWED))
        env = {"SOURCE_DATE_EPOCH": str(int(RENEWED.timestamp()) + 86_400)}
        for verb in ("build", "install", "check", "prove"):
            outcome = keymint(verb, cwd=ws, env=env)
            assert outcome.code == 0, outcome.err
        after = certificate(ws, "talker")
        assert after.subject == before.subject
        assert after.serial_number != before.serial_number
        assert after.not_valid_before_utc == RENEWED
        length = after.not_valid_after_utc - after.not_valid_before_utc
        assert length == before.not_valid_after_utc - before.not_valid_before_utc
        new = (ws / "install/enclaves/talker/permissions.xml").read_text()
        assert new != old
        assert f"{RENEWED:%Y-%m-%d}" in new
        assert f"{RENEWED + length:%Y-%m-%d}" in new
        assert _enclave(ws, "robot1/listener") == others


class TestKeyElsewhere:
    @pytest.fixture
    def robot(self, keymint: Callable, ws: Path) -> Path:
        """A workspace whose subject /talker has its key on the robot."""
        (ws / "private/identities/talker/key.pem").unlink()
        decide(ws, "talker", ELSEWHERE)
        reissue(keymint, ws)
        return ws

    def test_the_enclave_has_a_certificate_and_no_key(self, keymint: Callable, robot: Path) -> None:
        assert certificate(robot, "talker").public_key() == ROBOT.public_key()
        assert not (robot / "install/enclaves/talker/key.pem").exists()
        assert not (robot / "private/identities/talker/key.pem").exists()
        for verb in ("check", "prove"):
            outcome = keymint(verb, "--json", cwd=robot)
            assert outcome.code == 0, outcome.out
            assert [each for each in outcome.document["diagnostics"] if each["subject"] == "/talker"] == []
        assert "stale" not in keymint("status", cwd=robot).err

    def test_nothing_is_done_again(self, keymint: Callable, robot: Path) -> None:
        keymint("check", cwd=robot)  # which records what it proves
        before = snapshot(robot)
        reissue(keymint, robot)
        keymint("check", cwd=robot)
        assert snapshot(robot) == before

    def test_a_new_workspace_mints_no_key(self, keymint: Callable, created: Path) -> None:
        decide(created, "talker", ELSEWHERE)
        reissue(keymint, created)
        assert not (created / "private/identities/talker/key.pem").exists()
        assert (created / "private/identities/robot1/listener/key.pem").exists()
        assert certificate(created, "talker").public_key() == ROBOT.public_key()

    def test_renewing_the_key_here_is_refused(self, keymint: Callable, robot: Path) -> None:
        before = snapshot(robot)
        outcome = keymint("build", "--rekey", "talker", "--json", cwd=robot)
        assert outcome.code == 1
        assert outcome.codes() == ["key-elsewhere"]
        assert snapshot(robot) == before

    def test_a_certificate_for_another_key_is_found(self, keymint: Callable, robot: Path) -> None:
        decide(
            robot,
            "talker",
            Issuance(public_key=keys.public_to_pem(ec.generate_private_key(ec.SECP256R1()).public_key())),
        )
        for verb in ("check", "prove"):
            outcome = keymint(verb, "--json", cwd=robot)
            assert outcome.code != 0
            assert "key-mismatch" in outcome.codes()

    @pytest.mark.parametrize("owner", ["private/permissions_ca.key.pem", "private/identities/robot1/listener/key.pem"])
    def test_the_key_of_another_is_refused(self, keymint: Callable, ws: Path, owner: str) -> None:
        key = keys.from_pem((ws / owner).read_bytes())
        decide(ws, "talker", Issuance(public_key=keys.public_to_pem(key.public_key())))
        assert keymint("build", cwd=ws).code == 0
        before = _installed(ws)
        outcome = keymint("install", "--json", cwd=ws)
        assert outcome.code == 1
        assert {*outcome.codes()} & {"key-of-authority", "key-shared"}
        assert _installed(ws) == before

    def test_a_key_that_nothing_uses_is_reported(self, keymint: Callable, ws: Path) -> None:
        decide(ws, "talker", ELSEWHERE)
        reissue(keymint, ws)
        assert "key-unused" in keymint("check", "--json", cwd=ws).codes()
        assert (ws / "private/identities/talker/key.pem").exists()
        assert not (ws / "install/enclaves/talker/key.pem").exists()

    def test_zenoh(self, keymint: Callable, policy: Path, tmp_path: Path) -> None:
        made = keymint("provision", policy, "-w", "z", "--transport", "zenoh", "--no-prove")
        assert made.code == 0, made.err
        ws = tmp_path / "z"
        (ws / "private/identities/talker/key.pem").unlink()
        decide(ws, "talker", ELSEWHERE)
        reissue(keymint, ws)
        assert not (ws / "install/enclaves/talker/key.pem").exists()
        for verb in ("check", "prove"):
            outcome = keymint(verb, cwd=ws)
            assert outcome.code == 0, outcome.err
        router = (ws / "install/zenoh/router.json5").read_text()
        assert sorted(re.findall(r"cert_common_names.*?(/[\w./]+)", router)) == ["/robot1/listener", "/talker"]
        decide(
            ws, "talker", Issuance(0, None, keys.public_to_pem(ec.generate_private_key(ec.SECP256R1()).public_key()))
        )
        for verb in ("check", "prove"):
            assert "key-mismatch" in keymint(verb, "--json", cwd=ws).codes()


def _enclave(ws: Path, name: str) -> Mapping[str, tuple[int, int, bytes]]:
    return snapshot(ws / "install/enclaves" / name)


def _installed(ws: Path) -> Mapping[str, tuple[int, int, bytes]]:
    return snapshot(ws / "install")
