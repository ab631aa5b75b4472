# SPDX-License-Identifier: Apache-2.0
"""Whom participants authenticate, by the models; ``tests/real/test_keystore_life.py`` compares them with vendors."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import TYPE_CHECKING

import pytest
from cryptography import x509
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, OMG, VARIATIONS, Variation
from keymint_ros2_dds.transports.enclave_model import Authentication, EnclaveModel

from keymint.api import Environment, InstalledEnclave
from keymint.api.graph import Column, Edge, Object
from tests.plugins.keymint_ros2_dds.enclaves import NOW, authority, installed, revoking
from tests.plugins.keymint_ros2_dds.packages import package, rule

if TYPE_CHECKING:
    from pathlib import Path

ALL = list(VARIATIONS.values())
RULES = (rule("ALLOW", "ros_topic", "ros_publish", "/a"),)
PUBLISH = Edge("/talker", "publish", Object("topic", "rt/a"))


def write(folder: Path, issuer: str = "identity_ca", **more: bytes) -> InstalledEnclave:
    folder.mkdir(exist_ok=True)
    for name, content in installed(package(*RULES), "sros2", identity=issuer).items():
        (folder / name).write_bytes(content)
    for name, content in more.items():
        (folder / f"{name}.pem").write_bytes(content)
    return InstalledEnclave("/talker", folder, "jazzy", folder.parent)


def serial(enclave: InstalledEnclave) -> int:
    return x509.load_pem_x509_certificate((enclave.folder / "cert.pem").read_bytes()).serial_number


def put(enclave: InstalledEnclave, name: str, content: bytes) -> None:
    (enclave.folder / name).write_bytes(content)


def refusal(enclave: InstalledEnclave, variation: Variation = OMG, now: datetime = NOW) -> str:
    return Authentication(enclave, now).refusal(variation.semantics)


@pytest.mark.parametrize("variation", ALL, ids=lambda each: each.name)
def test_a_revoked_participant_has_no_endpoint(tmp_path: Path, variation: Variation) -> None:
    enclave = write(tmp_path / "talker")
    environment = Environment(NOW, tmp_path)
    put(enclave, "crl.pem", revoking("identity_ca", serial(enclave) + 1))
    assert EnclaveModel(enclave, environment, 0).decide(variation, PUBLISH).allowed
    put(enclave, "crl.pem", revoking("identity_ca", serial(enclave)))
    model = EnclaveModel(enclave, environment, 0)
    decided = model.decide(variation, PUBLISH)
    assert (decided.allowed, decided.reason) == (False, "crl.pem revokes the certificate")
    assert model.admitted(variation, Column((PUBLISH,))) == b"\0"


@pytest.mark.parametrize(
    ("issuer", "days", "reason"),
    [
        ("", 0, "crl.pem is not a revocation list"),
        ("permissions_ca", 0, "the revocation list in crl.pem is by another authority"),
        ("identity_ca", 61, "the revocation list in crl.pem has expired"),
        ("identity_ca", -2, "the revocation list in crl.pem is not yet valid"),
    ],
)
def test_a_list_that_vendors_refuse(tmp_path: Path, issuer: str, days: int, reason: str) -> None:
    enclave = write(tmp_path / "talker", crl=revoking(issuer, 1) if issuer else b"")
    assert {refusal(enclave, each, NOW + timedelta(days=days)) for each in ALL} == {reason}


def test_a_distribution_before_humble_reads_no_list(tmp_path: Path) -> None:
    folder = write(tmp_path / "talker", crl=b"").folder
    assert refusal(InstalledEnclave("/talker", folder, "galactic", tmp_path)) == ""
    assert refusal(InstalledEnclave("/talker", folder, "humble", tmp_path))


@pytest.mark.parametrize(("days", "reason"), [(4000, "has expired"), (-400, "is not yet valid")])
def test_the_period_of_the_certificate(tmp_path: Path, days: int, reason: str) -> None:
    found = refusal(write(tmp_path / "talker"), OMG, NOW + timedelta(days=days))
    assert found == f"the certificate in cert.pem {reason}"


def test_row_21_cyclone_dds_trusts_the_first_authority_alone(tmp_path: Path) -> None:
    enclave = write(tmp_path / "talker")
    put(enclave, "identity_ca.cert.pem", authority("new_ca").pem + authority("identity_ca").pem)
    assert refusal(enclave, CYCLONEDDS_0_10) == "cert.pem is by no authority that is trusted"
    assert (refusal(enclave, FASTDDS_2_9), refusal(enclave, OMG)) == ("", "")
    put(enclave, "identity_ca.cert.pem", authority("identity_ca").pem + authority("new_ca").pem)
    assert {refusal(enclave, each) for each in ALL} == {""}


def test_row_22_fast_dds_reads_lists_among_the_authorities(tmp_path: Path) -> None:
    enclave = write(tmp_path / "talker")
    put(enclave, "identity_ca.cert.pem", authority("identity_ca").pem + revoking("identity_ca", serial(enclave)))
    assert refusal(enclave, FASTDDS_2_9) == "crl.pem revokes the certificate"
    assert (refusal(enclave, CYCLONEDDS_0_10), refusal(enclave, OMG)) == ("", "")
    model = EnclaveModel(enclave, Environment(NOW, tmp_path), 0)
    assert "row 22, lists-among-authorities" in model.deviation(FASTDDS_2_9, PUBLISH, allowed=False)


def test_row_23_cyclone_dds_reads_no_key_in_a_token(tmp_path: Path) -> None:
    enclave = write(tmp_path / "talker")
    put(enclave, "key.p11", b"pkcs11:token=robot;object=talker\n")
    assert {refusal(enclave, each) for each in ALL} == {""}  # Cyclone DDS finds its key beside it
    (enclave.folder / "key.pem").unlink()
    assert refusal(enclave, CYCLONEDDS_0_10) == "key.pem is missing, and key.p11 is not read"
    assert (refusal(enclave, FASTDDS_2_9), refusal(enclave, OMG)) == ("", "")
    model = EnclaveModel(enclave, Environment(NOW, tmp_path), 0)
    assert "row 23, no-keys-in-tokens" in model.deviation(CYCLONEDDS_0_10, PUBLISH, allowed=False)


def test_a_peer_is_refused_by_whoever_has_the_list(tmp_path: Path) -> None:
    revoked, environment = write(tmp_path / "revoked"), Environment(NOW, tmp_path)
    informed = write(tmp_path / "informed", crl=revoking("identity_ca", serial(revoked)))
    trusting = write(tmp_path / "trusting", crl=revoking("identity_ca", 1))
    bad, wary, naive = (EnclaveModel(each, environment, 0) for each in (revoked, informed, trusting))
    for each in ALL:
        assert [mine.refuses(other, each) for mine, other in ((wary, bad), (bad, wary), (naive, bad))] == [
            True,
            False,
            False,
        ]


def test_two_authorities_need_a_list_each(tmp_path: Path) -> None:
    newcomer, environment = (
        EnclaveModel(write(tmp_path / "new", "new_ca"), Environment(NOW, tmp_path), 0),
        Environment(NOW, tmp_path),
    )
    bundle = authority("identity_ca").pem + authority("new_ca").pem
    one = write(tmp_path / "one", crl=revoking("identity_ca", 1))
    put(one, "identity_ca.cert.pem", bundle)
    assert EnclaveModel(one, environment, 0).refuses(newcomer, FASTDDS_2_9)
    both = write(tmp_path / "both")
    put(both, "identity_ca.cert.pem", bundle + revoking("identity_ca", 1) + revoking("new_ca", 1))
    assert not EnclaveModel(both, environment, 0).refuses(newcomer, FASTDDS_2_9)
    put(both, "identity_ca.cert.pem", bundle + revoking("identity_ca", 1))
    assert EnclaveModel(both, environment, 0).refuses(newcomer, FASTDDS_2_9)
