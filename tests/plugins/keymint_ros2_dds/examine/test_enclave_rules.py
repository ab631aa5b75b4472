# SPDX-License-Identifier: Apache-2.0
"""Rules about the files of one enclave: revocation lists beside a certificate."""

from __future__ import annotations

import pytest
from cryptography import x509
from keymint_ros2_dds.examine.enclave_rules import EnclaveRules

from comarmor.text import hexadecimal
from keymint.pki import revocation_lists
from tests.plugins.keymint_ros2_dds.builds import CHATTER
from tests.plugins.keymint_ros2_dds.enclaves import NOW, authority, installed, revoking
from tests.plugins.keymint_ros2_dds.packages import package


@pytest.fixture(scope="module")
def identity() -> bytes:
    return installed(package(CHATTER))["cert.pem"]


def serial(identity: bytes) -> int:
    return x509.load_pem_x509_certificate(identity).serial_number


def problem(crl: bytes, identity: bytes) -> str:
    """Return the finding on a list beside a certificate; empty if there is none."""
    chains = {"identity": authority("identity_ca").pem, "permissions": b""}
    rules = EnclaveRules({"cert.pem": identity, "crl.pem": crl}, "install/talker", "restore it", "/talker", chains)
    found = list(rules.revocation_list())
    assert {(each.code, str(each.where)) for each in found} <= {("revocation-list", "install/talker/crl.pem")}
    return "".join(each.message for each in found)


def test_a_list_that_does_not_name_the_certificate_has_no_problem(identity: bytes) -> None:
    assert problem(revoking("identity_ca", serial(identity) + 1), identity) == ""


def test_a_revoked_certificate_is_named_with_date_and_reason(identity: bytes) -> None:
    own = serial(identity)
    text = problem(revoking("identity_ca", own), identity)
    assert text.startswith(f"revokes the certificate beside it, serial number {hexadecimal(own)}, since 20")
    assert "(unspecified)" in text


def test_a_list_of_another_authority(identity: bytes) -> None:
    text = problem(revoking("permissions_ca", serial(identity)), identity)
    assert text.startswith("is not a revocation list of the certificate's issuer")


@pytest.mark.parametrize("pem", [b"", b"garbage", b"-----BEGIN X509 CRL-----\nAAAA\n-----END X509 CRL-----\n"])
def test_what_is_no_list(identity: bytes, pem: bytes) -> None:
    assert "in PEM" in problem(pem, identity)
    assert revocation_lists.period_in(pem) is None


def test_a_certificate_that_cannot_be_read_is_no_problem_of_the_list() -> None:
    assert problem(revoking("identity_ca", 1), b"") == ""


def test_the_period() -> None:
    period = revocation_lists.period_in(revoking("identity_ca", 1))
    assert period is not None
    assert period[0] < NOW < period[1]
