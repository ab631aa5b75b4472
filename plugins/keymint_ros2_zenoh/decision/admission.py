# SPDX-License-Identifier: Apache-2.0
"""Whom a router or a session admits by its certificate (measured on Zenoh 1.10.2 with mutual TLS)."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from ipaddress import ip_address

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from keymint.errors import KeymintError
from keymint.pki import certificates, certification_path, extensions


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name that access control compares: the first one, or an empty text."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def first_common_name(pem: bytes) -> str:
    """Return the common name of a certificate in PEM.

    Raises:
        KeymintError: no certificate.
    """
    return common_name(certificates.load(pem))


def refusal(certificate: bytes, authorities: bytes, at: datetime, *, server: bool) -> str:
    """Return why the other side of a link refuses a certificate, or an empty text.

    Args:
        certificate: PEM, with intermediate authorities behind it if there are any.
        authorities: PEM of the certificates that the other side trusts.
        at: the time.
        server: it is the certificate of the listening side.
    """
    try:
        leaf, *above = certificates.load_bundle(certificate)
    except KeymintError as error:
        return error.diagnostics[0].message
    intermediates = b"".join(certificates.to_pem(each) for each in above if each.issuer != each.subject)
    findings = certification_path.verify_chain(certificates.to_pem(leaf), intermediates + authorities, at)
    if findings:
        return findings[0].message
    key = leaf.public_key()
    if isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP521R1):
        return "its key is on the curve P-521, which TLS of Zenoh does not verify"
    lacking = lacking_usage(leaf, server=server)
    return lacking and f"its extended key usage lacks {lacking}"


def lacking_usage(certificate: x509.Certificate, *, server: bool) -> str:
    """Return the usage that the listening or the connecting side needs and a certificate lacks, or an empty text."""
    server_auth, client_auth = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    name, wanted = ("serverAuth", server_auth) if server else ("clientAuth", client_auth)
    usages = extensions.value(certificate, x509.ExtendedKeyUsage)
    return "" if usages is None or wanted in usages else name


def names_host(certificate: x509.Certificate, host: str) -> bool:
    """Tell whether a certificate is for a host: only its subject alternative names count, never its common name."""
    names = extensions.value(certificate, x509.SubjectAlternativeName)
    if names is None:
        return False
    try:
        return ip_address(host) in names.get_values_for_type(x509.IPAddress)
    except ValueError:
        listed: Sequence[str] = names.get_values_for_type(x509.DNSName)
        return any(_matches_host(name.lower(), host.lower()) for name in listed)


def _matches_host(name: str, host: str) -> bool:
    """Compare a name with a host; ``*`` stands for its first label (RFC 6125, 6.4.3), of three at least (rustls)."""
    domain = host.partition(".")[2]
    return name == host or ("." in domain and name == f"*.{domain}")
