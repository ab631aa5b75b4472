# SPDX-License-Identifier: Apache-2.0
"""Certificates of authorities from elsewhere: what they lack, and how they are issued again."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from comarmor.errors import Origin
from keymint.api import Validity
from keymint.errors import KeymintError
from keymint.pki import certificate_forms, certificates, foreign_authorities, keys
from tests.keymint.commands.life.test_authority import outside
from tests.keymint.pki.conftest import make_spec

WHERE = Origin("ca.pem")
VALIDITY = Validity(datetime(2026, 1, 1, tzinfo=UTC), datetime(2036, 1, 1, tzinfo=UTC))


def made(subject: str = "CN=ca", **extensions: str) -> tuple[x509.Certificate, keys.PrivateKey]:
    key = ec.generate_private_key(ec.SECP256R1())
    return certificates.issue(make_spec(subject, **extensions), key.public_key(), key, authority=True).certificate, key


def test_what_ours_have_is_not_missed() -> None:
    assert list(foreign_authorities.defects(made()[0], "ca", WHERE)) == []


@pytest.mark.parametrize(("lists", "identifier"), [(True, False), (False, True), (False, False)])
def test_what_is_lacking_is_there_when_it_is_issued_again(openssl, lists: bool, identifier: bool) -> None:
    pem, key_pem = outside(lists=lists, identifier=identifier)
    certificate, key = certificates.load(pem), keys.from_pem(key_pem)
    codes = {each.code for each in foreign_authorities.defects(certificate, "ca", WHERE)}
    expected = {"authority-cannot-revoke": not lists, "authority-without-identifier": not identifier}
    assert codes == {code for code, missing in expected.items() if missing}
    again = foreign_authorities.issued_like(certificate, key, VALIDITY, None, WHERE)
    new = certificates.load(again)
    assert list(foreign_authorities.defects(new, "ca", WHERE)) == []
    assert new.subject == certificate.subject
    assert new.serial_number != certificate.serial_number
    assert new.not_valid_after_utc == VALIDITY.not_after
    openssl.put(ca=again)
    openssl.accepts("verify", "-x509_strict", "-check_ss_sig", "-attime", "1800000000", "-CAfile", "ca", "ca")


def test_other_extensions_and_the_path_length_stay() -> None:
    certificate, key = made(basicConstraints="critical,CA:TRUE,pathlen:1", certificatePolicies="1.2.3.4")
    new = certificates.load(foreign_authorities.issued_like(certificate, key, VALIDITY, None, WHERE))
    for kind in (x509.BasicConstraints, x509.CertificatePolicies, x509.KeyUsage):
        ours, theirs = (each.extensions.get_extension_for_class(kind) for each in (new, certificate))
        assert (ours.value, ours.critical) == (theirs.value, theirs.critical)


def test_below_another_authority_it_ends_with_that() -> None:
    root, root_key = made("CN=root")
    key = ec.generate_private_key(ec.SECP256R1())
    issuer = certificates.Issuer(root, root_key)
    below = certificates.issue(make_spec("CN=below"), key.public_key(), issuer or key, authority=True).certificate
    longer = Validity(VALIDITY.not_before, datetime(2090, 1, 1, tzinfo=UTC))
    new = certificates.load(foreign_authorities.issued_like(below, key, longer, issuer, WHERE))
    assert certificates.is_issued_by(new, root)
    assert new.not_valid_after_utc == root.not_valid_after_utc
    assert new.extensions.get_extension_for_class(x509.AuthorityKeyIdentifier)
    with pytest.raises(KeymintError, match="which is not in the workspace"):
        foreign_authorities.issued_like(below, key, VALIDITY, None, WHERE)
    past = Validity(datetime(2000, 1, 1, tzinfo=UTC), datetime(2001, 1, 1, tzinfo=UTC))
    with pytest.raises(KeymintError, match="validity is empty"):
        foreign_authorities.issued_like(below, key, past, issuer, WHERE)


@pytest.mark.parametrize(
    ("key", "algorithm"),
    [(ec.generate_private_key(ec.SECP384R1()), "ec"), (rsa.generate_private_key(65537, 2048), "rsa")],
)
def test_the_kind_of_key_is_that_of_the_certificate(key: keys.PrivateKey, algorithm: str) -> None:
    pem = certificates.issue(make_spec(), key.public_key(), key, authority=True).pem
    spec = foreign_authorities.adopted_spec(make_spec("CN=other"), pem)
    assert (spec.subject_name, spec.key.algorithm) == ("CN=ca", algorithm)
    assert keys.fits(key, spec.key)


def test_what_must_not_issue_is_refused() -> None:
    key = ec.generate_private_key(ec.SECP256K1())
    builder = x509.CertificateBuilder().subject_name(x509.Name([])).issuer_name(x509.Name([])).serial_number(7)
    builder = builder.not_valid_before(VALIDITY.not_before).not_valid_after(VALIDITY.not_after)
    odd = builder.public_key(key.public_key()).add_extension(x509.BasicConstraints(True, None), critical=True)
    signer = ec.generate_private_key(ec.SECP256R1())
    pem = certificates.to_pem(odd.sign(signer, certificate_forms.HASHES["SHA256"]))
    with pytest.raises(KeymintError, match="secp256k1, which is not supported"):
        foreign_authorities.require_authority(pem, WHERE)
    with pytest.raises(KeymintError, match="basicConstraints lack CA:TRUE"):
        foreign_authorities.require_authority(outside(ca=False)[0], WHERE)
    assert foreign_authorities.require_authority(outside()[0], WHERE)
