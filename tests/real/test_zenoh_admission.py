# SPDX-License-Identifier: Apache-2.0
"""Which certificates a real router and real sessions admit, compared with the model."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID
from keymint_ros2_zenoh import decision
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError

from tests.plugins.keymint_ros2_zenoh.install_spaces import InstallSpace, key

from .zenoh_network import RealNetwork, real_network

pytestmark = [pytest.mark.zenoh, pytest.mark.usefixtures("zenoh_library")]

CLIENT, SERVER = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
_DAY = timedelta(days=1)


def p256() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def certificate(
    space: InstallSpace,
    new_key: Callable[[], object] = p256,
    *,
    usages: tuple[x509.ObjectIdentifier, ...] = (CLIENT,),
    name: str = "CN=/talker",
    begin: timedelta = -_DAY,
    end: timedelta = _DAY,
    password: bytes = b"",
) -> tuple[bytes, bytes]:
    """Return a certificate of the authority of an install space and its key, both PEM."""
    own = new_key()
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(x509.Name.from_rfc4514_string(name))
    builder = builder.issuer_name(x509.load_pem_x509_certificate(space.authority).subject).public_key(own.public_key())
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now + begin)
    builder = builder.not_valid_after(now + end)
    if usages:
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
    encryption = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    encoding = serialization.Encoding.PEM
    pem = own.private_bytes(encoding, serialization.PrivateFormat.PKCS8, encryption)
    return builder.sign(space.authority_key, hashes.SHA256()).public_bytes(encoding), pem


@pytest.fixture
def space(tmp_path: Path) -> InstallSpace:
    return InstallSpace(tmp_path / "install", {"/talker": [("publish", key("chatter"))]})


def admitted(network: RealNetwork, files: tuple[bytes, bytes]) -> bool:
    """Tell whether a session gets a link to the router with a certificate and a key."""
    folder = network.space.folder / "enclaves/talker"
    for name, content in zip(("cert.pem", "key.pem"), files, strict=True):
        (folder / name).write_bytes(content)
    try:
        network.session("talker")
    except ZenohError:
        return False
    return True


KEYS = {
    "P-256": p256,
    "P-384": lambda: ec.generate_private_key(ec.SECP384R1()),
    "P-521": lambda: ec.generate_private_key(ec.SECP521R1()),
    "RSA-2048": lambda: rsa.generate_private_key(65537, 2048),
    "Ed25519": ed25519.Ed25519PrivateKey.generate,
}


def test_keys(space: InstallSpace) -> None:
    found = {}
    with real_network(space) as network:
        network.router()
        for name, new_key in KEYS.items():
            files = certificate(space, new_key)
            found[name] = admitted(network, files)
            modelled = decision.refusal(files[0], space.authority, datetime.now(UTC), server=False)
            assert (modelled == "") == found[name], name
    assert found == {"P-256": True, "P-384": True, "P-521": False, "RSA-2048": True, "Ed25519": True}


def test_usages_and_times(space: InstallSpace) -> None:
    cases = {
        "clientAuth": (certificate(space), True),
        "both": (certificate(space, usages=(CLIENT, SERVER)), True),
        "no extension": (certificate(space, usages=()), True),
        "serverAuth": (certificate(space, usages=(SERVER,)), False),
        "any": (certificate(space, usages=(ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE,)), False),
        "expired": (certificate(space, end=-timedelta(minutes=1)), False),
        "not yet valid": (certificate(space, begin=timedelta(hours=1)), False),
        "no common name": (certificate(space, name="OU=talker"), True),
    }
    with real_network(space) as network:
        network.router()
        for name, (files, expected) in cases.items():
            assert admitted(network, files) == expected, name
            modelled = decision.refusal(files[0], space.authority, datetime.now(UTC), server=False)
            assert (modelled == "") == expected, name


def test_a_key_that_is_encrypted_or_of_another_certificate_opens_no_session(space: InstallSpace) -> None:
    with real_network(space) as network:
        network.router()
        plain = certificate(space)
        assert admitted(network, plain)
        assert not admitted(network, certificate(space, password=b"secret"))
        assert not admitted(network, (plain[0], certificate(space)[1]))


def test_an_authority_of_the_same_name_is_another_one(space: InstallSpace, tmp_path: Path) -> None:
    stranger = InstallSpace(tmp_path / "stranger", {})
    files = certificate(stranger)
    with real_network(space) as network:
        network.router()
        assert not admitted(network, files)
    assert decision.refusal(files[0], space.authority, datetime.now(UTC), server=False)
