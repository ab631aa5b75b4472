# SPDX-License-Identifier: Apache-2.0
"""In a workspace with DDS and Zenoh a node has one certificate, for clients only: DDS vendors accept it."""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from keymint_ros2_dds.vendors.participants import RefusedError, System

from .handmade import Authorities, criteria, rule

NODE = (ExtendedKeyUsageOID.CLIENT_AUTH,)
ROUTER = (ExtendedKeyUsageOID.SERVER_AUTH,)
ENCLAVE_OF_DDS = (ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH)
BOTH_WAYS = rule("allow", criteria("publish", ["rt/x"]) + criteria("subscribe", ["rt/x"]))


def enclave(
    authorities: Authorities, folder: Path, name: str, usages: tuple[x509.ObjectIdentifier, ...], issuer: Authorities
) -> Path:
    """Write an enclave whose certificate has these extended key usages."""
    authorities.enclave(folder, BOTH_WAYS, name=name)
    certificate, key = issuer.identity.issue([(NameOID.COMMON_NAME, name)], usages)
    (folder / "cert.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    (folder / "key.pem").write_bytes(key)
    return folder


@pytest.mark.parametrize(
    ("talker", "listener"), [(NODE, NODE), (NODE, ENCLAVE_OF_DDS), (ENCLAVE_OF_DDS, NODE), ((), NODE), (ROUTER, NODE)]
)
def test_participants_with_certificates_for_clients_only_exchange_data(
    authorities: Authorities,
    system: System,
    tmp_path: Path,
    talker: tuple[x509.ObjectIdentifier, ...],
    listener: tuple[x509.ObjectIdentifier, ...],
) -> None:
    """Measured on Cyclone DDS 0.10.2 and Fast DDS 2.9.1, which look at no extended key usage."""
    folders = {
        name: enclave(authorities, tmp_path / name, f"/{name}", usages, authorities)
        for name, usages in (("talker", talker), ("listener", listener))
    }
    reader = system.open(folders["listener"]).edge("subscribe", "rt/x")
    writer = system.open(folders["talker"]).edge("publish", "rt/x")
    writer.write("hello")
    assert reader.read() == "hello"


def test_a_certificate_of_another_authority_is_refused(
    authorities: Authorities, system: System, tmp_path: Path
) -> None:
    """The control: certificates are verified."""
    stranger = Authorities.new()
    with pytest.raises(RefusedError):
        system.open(enclave(authorities, tmp_path / "talker", "/talker", NODE, stranger))
