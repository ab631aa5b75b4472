# SPDX-License-Identifier: Apache-2.0
"""What another tool revoked stays revoked: it is in the register, or it is an error."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from comarmor.text import hexadecimal
from tests.keymint.commands.exchange.test_adopt import POLICY, made
from tests.keymint.commands.exchange.test_adopt_apply import files

OTHER = 4711
"""Serial number of a certificate that no enclave has."""


@pytest.fixture
def keystore(tmp_path: Path) -> Path:
    (tmp_path / "policy.xml").write_text(POLICY)
    return made(tmp_path / "ks")


def revoking(
    keystore: Path,
    serials: Sequence[int],
    *,
    number: int = 7,
    end: int = 2035,
    other: bool = False,
    names: tuple[str, str] = ("public/ca.cert.pem", "private/ca.key.pem"),
) -> bytes:
    """Return a revocation list of the keystore's authority, or of another one with its name."""
    authority = x509.load_pem_x509_certificate((keystore / names[0]).read_bytes())
    key = load_pem_private_key((keystore / names[1]).read_bytes(), None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    builder = x509.CertificateRevocationListBuilder(
        authority.subject, datetime(2026, 2, 1, tzinfo=UTC), datetime(end, 2, 1, tzinfo=UTC)
    )
    for serial in serials:
        entry = x509.RevokedCertificateBuilder(serial, datetime(2026, 1, 15, tzinfo=UTC))
        reason = x509.CRLReason(x509.ReasonFlags.key_compromise)
        builder = builder.add_revoked_certificate(entry.add_extension(reason, critical=False).build())
    builder = builder.add_extension(x509.CRLNumber(number), critical=False)
    signer = ec.generate_private_key(ec.SECP256R1()) if other else key
    return builder.sign(signer, hashes.SHA256()).public_bytes(Encoding.PEM)


def put(keystore: Path, content: bytes, *enclaves: str) -> None:
    for enclave in enclaves or ("talker", "robot1/listener"):
        (keystore / "enclaves" / enclave / "crl.pem").write_bytes(content)


def serial_of(keystore: Path, enclave: str) -> int:
    return x509.load_pem_x509_certificate((keystore / "enclaves" / enclave / "cert.pem").read_bytes()).serial_number


def errors(outcome) -> list[tuple[str, str]]:
    return [(each["code"], each["file"]) for each in outcome.document["diagnostics"] if each["severity"] == "error"]


def test_a_list_is_gone_on_with(keymint, keystore: Path, tmp_path: Path) -> None:
    put(keystore, revoking(keystore, [OTHER]))
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 0, outcome.err
    robots = files(keystore, "enclaves/", "public/")
    for verb in ("build", "install"):
        assert keymint(verb, "-w", "ws").code == 0
        assert files(tmp_path / "ws/install", "enclaves/", "public/") == robots
    (shown,) = keymint("crl", "-w", "ws", "--json").document["result"]["lists"]
    assert (shown["number"], [each["serial"] for each in shown["revoked"]]) == (7, [hexadecimal(OTHER)])
    serial = serial_of(keystore, "talker")
    assert keymint("revoke", "talker", "--reason", "retired", "-w", "ws").code == 0
    new = x509.load_pem_x509_crl((tmp_path / "ws/install/enclaves/robot1/listener/crl.pem").read_bytes())
    assert {each.serial_number for each in new} == {OTHER, serial}
    assert new.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number == 8
    (kept,) = [each for each in new if each.serial_number == OTHER]
    assert kept.revocation_date_utc == datetime(2026, 1, 15, tzinfo=UTC)
    reason = kept.extensions.get_extension_for_class(x509.CRLReason).value.reason
    assert reason is x509.ReasonFlags.key_compromise


def test_a_list_behind_links(keymint, keystore: Path, tmp_path: Path) -> None:
    (keystore / "public/crl.pem").write_bytes(revoking(keystore, [OTHER]))
    (keystore / "enclaves/talker/crl.pem").symlink_to("../../public/crl.pem")
    (keystore / "enclaves/robot1/listener/crl.pem").symlink_to("../../../public/crl.pem")
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert keymint("install", "-w", "ws").code == 0
    assert files(tmp_path / "ws/install", "enclaves/", "public/") == files(keystore, "enclaves/", "public/")


def test_single_files(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks", layout="rti")
    names = ("cert/identity_ca.pem", "private/identity_ca_key.pem")
    for number, name in ((3, "old"), (4, "revoked.pem")):
        (keystore / name).write_bytes(revoking(keystore, [OTHER], number=number, names=names))
    outcome = keymint("adopt", "ks", "--apply", "-w", "ws")
    assert outcome.code == 0, outcome.err
    found = [path.read_bytes() for path in (tmp_path / "ws/install/enclaves").rglob("crl.pem")]
    assert found == [(keystore / "revoked.pem").read_bytes()] * 2
    assert keymint("install", "-w", "ws").out.startswith("nothing to do")


def test_an_enclave_that_is_revoked(keymint, keystore: Path, tmp_path: Path) -> None:
    serial = serial_of(keystore, "talker")
    put(keystore, revoking(keystore, [serial]))
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 1
    shown = hexadecimal(serial)
    assert (
        f"ks/enclaves/talker/crl.pem: error: revokes the certificate beside it, serial number {shown}, since "
        "2026-01-15 (key-compromise): vendors refuse the participant (take it out of the keystore;" in outcome.err
    )
    assert not (tmp_path / "ws").exists()


def test_only_the_list_of_its_own_authority_revokes_an_enclave(keymint, keystore: Path) -> None:
    put(keystore, revoking(keystore, [serial_of(keystore, "talker")], other=True))
    found = {code for code, _ in errors(keymint("adopt", "ks", "--json"))}
    assert found == {"adopt-revocations"}


@pytest.mark.parametrize("place", ["enclaves/talker/crl.pem", "public/crl.pem"])
def test_a_list_that_only_some_have(keymint, keystore: Path, place: str) -> None:
    (keystore / place).write_bytes(revoking(keystore, [OTHER]))
    outcome = keymint("adopt", "ks", "--json")
    lacking = [f"ks/enclaves/{name}/crl.pem" for name in ("robot1/listener", "talker")]
    assert errors(outcome) == [("adopt-revocations", each) for each in lacking if place not in each]


def test_an_older_list(keymint, keystore: Path) -> None:
    put(keystore, revoking(keystore, [OTHER], number=8))
    put(keystore, revoking(keystore, [OTHER], number=7), "talker")
    assert errors(keymint("adopt", "ks", "--json")) == [("adopt-revocations", "ks/enclaves/talker/crl.pem")]


def test_a_revocation_that_the_newest_list_lacks(keymint, keystore: Path) -> None:
    put(keystore, revoking(keystore, [OTHER], number=8))
    (keystore / "private/old.crl").write_bytes(revoking(keystore, [OTHER, 12]))
    outcome = keymint("adopt", "ks")
    assert (
        "crl.pem: error: does not revoke all that ks/private/old.crl revokes, e.g. the serial number 0c ("
        in outcome.err
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            lambda ks: revoking(ks, [OTHER], end=2026),
            "the revocation list expired on 2026-02-01 00:00 UTC (issue it again with the tool",
        ),
        (
            lambda ks: revoking(ks, [OTHER], other=True),
            "is not a revocation list of the certificate's issuer: vendors refuse the participant (remove it, or",
        ),
        (
            lambda _: b"revoked: nobody",
            "is not a revocation list in PEM: vendors refuse the participant (remove it, or replace it",
        ),
        (lambda ks: b"text\n" + revoking(ks, [OTHER]), "(rewrite it, here and on the robots: openssl crl -in ks/encl"),
    ],
    ids=["ended", "another signer", "no list", "text"],
)
def test_a_list_that_no_node_takes(keymint, keystore: Path, content, words: str) -> None:
    put(keystore, content(keystore))
    outcome = keymint("adopt", "ks")
    assert outcome.code == 3
    assert words in outcome.err


def test_a_list_of_others_beside_it_is_not_taken_over(keymint, keystore: Path) -> None:
    (keystore / "public/other.crl").write_bytes(revoking(keystore, [OTHER], other=True))
    outcome = keymint("adopt", "ks")
    assert (
        "ks/public/other.crl: warning: is no revocation list of the authority 'ca' (no action needed if it"
        in outcome.err
    )
