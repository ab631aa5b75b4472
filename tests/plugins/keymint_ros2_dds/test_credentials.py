# SPDX-License-Identifier: Apache-2.0
"""Revocation lists beside a certificate."""

from __future__ import annotations

import pytest
from cryptography import x509
from keymint_ros2_dds.credentials import revocation_period, revocation_problem

from tests.plugins.keymint_ros2_dds.builds import CHATTER
from tests.plugins.keymint_ros2_dds.enclaves import NOW, authority, installed, revoking
from tests.plugins.keymint_ros2_dds.packages import package


@pytest.fixture(scope="module")
def identity() -> bytes:
    return installed(package(CHATTER))["cert.pem"]


def serial(identity: bytes) -> int:
    return x509.load_pem_x509_certificate(identity).serial_number


def test_a_list_that_does_not_name_the_certificate_has_no_problem(identity: bytes) -> None:
    assert (
        revocation_problem(revoking("identity_ca", serial(identity) + 1), identity, authority("identity_ca").pem) == ""
    )


def test_a_revoked_certificate(identity: bytes) -> None:
    crl = revoking("identity_ca", serial(identity))
    assert "revokes the certificate" in revocation_problem(crl, identity, authority("identity_ca").pem)


def test_a_list_of_another_authority(identity: bytes) -> None:
    crl = revoking("permissions_ca", serial(identity))
    problem = revocation_problem(crl, identity, authority("identity_ca").pem)
    assert problem.startswith("is not a revocation list of the certificate's issuer")


@pytest.mark.parametrize("pem", [b"", b"garbage", b"-----BEGIN X509 CRL-----\nAAAA\n-----END X509 CRL-----\n"])
def test_what_is_no_list(identity: bytes, pem: bytes) -> None:
    assert "in PEM" in revocation_problem(pem, identity, authority("identity_ca").pem)
    assert revocation_period(pem) is None


def test_a_certificate_that_cannot_be_read_is_no_problem_of_the_list() -> None:
    assert revocation_problem(revoking("identity_ca", 1), b"", authority("identity_ca").pem) == ""


def test_the_period() -> None:
    period = revocation_period(revoking("identity_ca", 1))
    assert period is not None
    assert period[0] < NOW < period[1]
