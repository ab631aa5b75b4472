# SPDX-License-Identifier: Apache-2.0
"""``keymint sign``: whose key is certified, and what a carrier of requests may try."""

from __future__ import annotations

import stat
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import AttributeOID, NameOID

from comarmor.errors import Origin
from comarmor.text import hexadecimal
from keymint.pki import certificates, keys
from keymint.robots import bundle, certification_request
from tests.conftest import NOW, snapshot

NONCE = "0123456789abcdef" * 2


def ran(keymint, *arguments: object) -> dict[str, Any]:
    outcome = keymint(*arguments, "--json")
    assert outcome.code == 0, outcome.out
    return outcome.document["result"]


def ask(keymint, name: str = "talker", keystore: str = "robot", *more: str) -> str:
    """Let a robot ask for an enclave; returns the fingerprint as it shows it."""
    fingerprint: str = ran(keymint, "request", name, "--folder", keystore, *more)["fingerprint"]
    return f"{name}={fingerprint}"


def refused(keymint, ws: Path, *arguments: object) -> str:
    """Check that a request is refused, and that nothing changed; returns the code."""
    before = snapshot(ws)
    outcome = keymint("sign", *arguments, "-w", "ws", "--json")
    assert outcome.code == 1, outcome.out
    after = snapshot(ws)
    assert {path: after[path] for path in before} == before
    assert not list(ws.parent.glob("*.bundle"))
    [diagnostic] = outcome.document["diagnostics"]
    assert diagnostic["help"]
    code: str = diagnostic["code"]
    return code


def forged(key: ec.EllipticCurvePrivateKey, name: str = "/talker", *, extension: bool = False) -> bytes:
    """Return the request that a carrier makes for a key of his own."""
    builder = x509.CertificateSigningRequestBuilder(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]))
    builder = builder.add_attribute(AttributeOID.CHALLENGE_PASSWORD, NONCE.encode())
    if extension:
        builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    return builder.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM)


def carried(ws: Path, content: bytes) -> Path:
    path = ws.parent / "talker.request.pem"
    path.write_bytes(content)
    return path


def installed(ws: Path, name: str = "talker") -> x509.Certificate:
    return x509.load_pem_x509_certificate((ws / f"install/enclaves/{name}/cert.pem").read_bytes())


def test_the_key_of_a_robot_is_certified(keymint, ws: Path) -> None:
    before = installed(ws)
    confirmed = ask(keymint)
    [made] = ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", confirmed)["bundles"]
    assert (made["enclave"], made["file"], made["has_private_key"]) == ("/talker", "talker.bundle", False)
    file = ws.parent / "talker.bundle"
    read = bundle.read(file.read_bytes(), Origin("talker.bundle"))
    assert read.certificate == installed(ws)
    assert f"talker={certificates.fingerprint(read.certificate)}" == confirmed
    assert (
        read.manifest.nonce
        == certification_request.read((ws.parent / "talker.request.pem").read_bytes(), Origin("r")).nonce
    )
    assert "key.pem" not in read.files
    assert not (ws / "install/enclaves/talker/key.pem").exists()
    assert stat.S_IMODE(file.stat().st_mode) == 0o644
    # Name, validity and extensions are the authority's.
    after = installed(ws)
    assert after.subject == before.subject
    assert (after.not_valid_before_utc, after.not_valid_after_utc) == (
        before.not_valid_before_utc,
        before.not_valid_after_utc,
    )
    assert {each.oid for each in after.extensions} == {each.oid for each in before.extensions}


def test_nothing_but_the_key_is_taken_from_a_request(keymint, ws: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    carried(ws, forged(key, extension=True))
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", f"talker={keys.fingerprint(key)}")
    constraints = installed(ws).extensions.get_extension_for_class(x509.BasicConstraints).value
    assert not constraints.ca


def test_several_requests_at_once(keymint, ws: Path) -> None:
    given = [ask(keymint), ask(keymint, "robot1/listener")]
    (ws.parent / "out").mkdir()
    files = ["talker.request.pem", "robot1.listener.request.pem"]
    confirmed = [word for each in given for word in ("--fingerprint", each)]
    assert keymint("sign", *files, "-w", "ws", *confirmed, "-o", "one.bundle").code == 2
    result = ran(keymint, "sign", *files, "-w", "ws", *confirmed, "-o", "out")
    assert [each["file"] for each in result["bundles"]] == ["out/talker.bundle", "out/robot1.listener.bundle"]


def test_again_is_the_same_with_a_higher_number(keymint, ws: Path) -> None:
    confirmed = ask(keymint)
    [first] = ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", confirmed)["bundles"]
    before = snapshot(ws / "install")
    [again] = ran(keymint, "sign", "talker.request.pem", "-w", "ws")["bundles"]
    assert again["issue"] > first["issue"]
    assert {**again, "issue": 0} == {**first, "issue": 0}
    assert snapshot(ws / "install") == before


def test_a_package_without_a_key_never_gets_one_here(keymint, policy: Path, tmp_path: Path) -> None:
    (tmp_path / "ws").mkdir()
    assert keymint("init", "ws", "--policy", policy).code == 0
    assert keymint("create", "--all", "-w", "ws").code == 0
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", ask(keymint))
    for verb in ("build", "install"):
        assert keymint(verb, "-w", "ws").code == 0
    assert {path.parent.name for path in (tmp_path / "ws/private").rglob("key.pem")} == {"listener"}
    assert not (tmp_path / "ws/install/enclaves/talker/key.pem").exists()
    checked = keymint("check", "-w", "ws")
    assert (checked.code, checked.err) == (0, "")


def test_a_dry_run_changes_nothing(keymint, ws: Path) -> None:
    confirmed = ask(keymint)
    before = snapshot(ws.parent)
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", confirmed, "--dry-run")
    assert snapshot(ws.parent) == before


def test_the_register_has_the_certificate(keymint, ws: Path) -> None:
    confirmed = ask(keymint)
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", confirmed)
    issued = ran(keymint, "issued", "-w", "ws")
    assert hexadecimal(installed(ws).serial_number) in str(issued)
    assert confirmed.removeprefix("talker=") in str(issued)


# -- who confirms the key --------------------------------------------------------------------------------------------


def test_possession_alone_is_not_enough(keymint, ws: Path) -> None:
    carried(ws, forged(ec.generate_private_key(ec.SECP256R1())))
    assert refused(keymint, ws, "talker.request.pem") == "request-unconfirmed"


def test_a_carrier_swaps_the_request(keymint, ws: Path) -> None:
    confirmed = ask(keymint)
    carried(ws, forged(ec.generate_private_key(ec.SECP256R1())))
    assert refused(keymint, ws, "talker.request.pem", "--fingerprint", confirmed) == "request-exchanged"


def test_the_fingerprint_is_of_one_enclave(keymint, ws: Path) -> None:
    """A robot that is asked for one name must not get another one's."""
    fingerprint = ask(keymint, "robot1/listener").removeprefix("robot1/listener=")
    assert (
        refused(keymint, ws, "robot1.listener.request.pem", "--fingerprint", f"talker={fingerprint}")
        == "request-unconfirmed"
    )


def test_the_present_key_confirms_a_new_one(keymint, ws: Path) -> None:
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", ask(keymint))
    trust = ran(keymint, "bundle", "talker", "-w", "ws")["bundles"][0]["authority"]
    (ws.parent / "talker.bundle").unlink()
    ran(keymint, "sign", "talker.request.pem", "-w", "ws")
    ran(keymint, "accept", "talker.bundle", "--folder", "robot", "--authority-fingerprint", trust)
    (ws.parent / "talker.bundle").unlink()
    before = installed(ws).public_key()
    ask(keymint, "talker", "robot", "--rekey")
    ran(keymint, "sign", "talker.request.pem", "-w", "ws")
    assert installed(ws).public_key() != before
    # The key that was replaced confirms nothing any more.
    (ws.parent / "talker.bundle").unlink()
    ask(keymint, "talker", "robot", "--rekey", "--discard")
    assert refused(keymint, ws, "talker.request.pem") == "request-unconfirmed"


def test_the_key_of_another_enclave_confirms_nothing(keymint, ws: Path) -> None:
    folder = ws / "install/enclaves/robot1/listener"
    key = load_pem_private_key((folder / "key.pem").read_bytes(), None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    other = certificates.Issuer(certificates.load((folder / "cert.pem").read_bytes()), key)
    carried(ws, certification_request.make("/talker", ec.generate_private_key(ec.SECP256R1()), NONCE, other))
    assert refused(keymint, ws, "talker.request.pem") == "request-unconfirmed"


def test_a_request_for_a_key_that_was_made_here(keymint, ws: Path) -> None:
    """The workspace keeps it, and the bundle does not carry it once more."""
    key = load_pem_private_key((ws / "install/enclaves/talker/key.pem").read_bytes(), None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    carried(ws, forged(key))
    [made] = ran(keymint, "sign", "talker.request.pem", "-w", "ws")["bundles"]
    assert not made["has_private_key"]
    assert (ws / "install/enclaves/talker/key.pem").exists()
    assert not (ws / "src/talker/issuance.xml").exists()


# -- which keys are not certified ------------------------------------------------------------------------------------


def confirmed_key(ws: Path, key: Any, name: str = "talker") -> tuple[str, ...]:
    carried(ws, certification_request.make(f"/{name}", key, NONCE))
    return "talker.request.pem", "--fingerprint", f"{name}={keys.fingerprint(key)}"


def private(ws: Path, file: str) -> Any:
    return load_pem_private_key((ws / file).read_bytes(), None)


def test_the_key_of_an_authority(keymint, ws: Path) -> None:
    for authority in ("identity_ca", "permissions_ca"):
        given = confirmed_key(ws, private(ws, f"private/{authority}.key.pem"))
        assert refused(keymint, ws, *given) == "key-of-authority"


def test_the_key_of_another_enclave(keymint, ws: Path) -> None:
    given = confirmed_key(ws, private(ws, "install/enclaves/robot1/listener/key.pem"))
    assert refused(keymint, ws, *given) == "key-shared"


def test_the_key_that_another_package_has_elsewhere(keymint, ws: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    ran(keymint, "sign", *confirmed_key(ws, key), "-w", "ws")
    (ws.parent / "talker.bundle").unlink()
    assert refused(keymint, ws, *confirmed_key(ws, key, "robot1/listener")) == "key-shared"


def test_a_key_that_another_enclave_had_once(keymint, ws: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    for each in (key, ec.generate_private_key(ec.SECP256R1())):
        ran(keymint, "sign", *confirmed_key(ws, each), "-w", "ws")
        (ws.parent / "talker.bundle").unlink()
    assert refused(keymint, ws, *confirmed_key(ws, key, "robot1/listener")) == "key-shared"


def test_one_key_for_two_requests(keymint, ws: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    given = []
    for name in ("talker", "robot1/listener"):
        (ws.parent / f"{len(given)}.pem").write_bytes(certification_request.make(f"/{name}", key, NONCE))
        given += [f"{len(given)}.pem", "--fingerprint", f"{name}={keys.fingerprint(key)}"]
    assert refused(keymint, ws, *given) == "key-shared"


def test_two_requests_for_one_enclave(keymint, ws: Path) -> None:
    confirmed = ask(keymint)
    (ws.parent / "again.pem").write_bytes((ws.parent / "talker.request.pem").read_bytes())
    given = ("talker.request.pem", "again.pem", "--fingerprint", confirmed)
    assert refused(keymint, ws, *given) == "request-twice"


def test_a_key_that_was_revoked_as_compromised(keymint, ws: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    ran(keymint, "sign", *confirmed_key(ws, key), "-w", "ws")
    (ws.parent / "talker.bundle").unlink()
    assert keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0
    assert refused(keymint, ws, *confirmed_key(ws, key)) == "key-barred"
    # Nor does it confirm another one: whoever stole it could.
    thief = certificates.Issuer(_certificate(key), key)  # it needs no certificate of ours
    carried(ws, certification_request.make("/talker", ec.generate_private_key(ec.SECP256R1()), NONCE, thief))
    assert refused(keymint, ws, "talker.request.pem") == "request-unconfirmed"
    # A new key, read at the robot, is certified again, for the next generation.
    new = ec.generate_private_key(ec.SECP256R1())
    [made] = ran(keymint, "sign", *confirmed_key(ws, new), "-w", "ws")["bundles"]
    assert made["generation"] == 1
    (ws / "private/identities/talker/key.pem").unlink()  # check says that nothing uses it
    assert keymint("check", "-w", "ws").code == 0


def _certificate(key: ec.EllipticCurvePrivateKey) -> x509.Certificate:
    """Return a certificate of a key by that key."""
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "/talker")])
    first, last = datetime.fromtimestamp(NOW, UTC), datetime.fromtimestamp(NOW + 86_400, UTC)
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    builder = builder.serial_number(7).not_valid_before(first).not_valid_after(last)
    return builder.sign(key, hashes.SHA256())


def test_a_key_of_another_kind(keymint, ws: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric import rsa

    given = confirmed_key(ws, rsa.generate_private_key(65537, 2048))
    assert refused(keymint, ws, *given) == "key-kind"


def test_a_name_that_no_package_has(keymint, ws: Path) -> None:
    carried(ws, forged(ec.generate_private_key(ec.SECP256R1()), "/talke"))
    assert refused(keymint, ws, "talker.request.pem") == "request-unknown"
    assert refused(keymint, ws, "talker.request.pem", "--fingerprint", f"nobody={'0' * 64}") == "package-unknown"


def test_all_defects_are_reported_together(keymint, ws: Path) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    for number, name in enumerate(("/talker", "/unknown")):
        (ws.parent / f"{number}.pem").write_bytes(forged(key, name))
    outcome = keymint("sign", "0.pem", "1.pem", "-w", "ws", "--json")
    assert set(outcome.codes()) == {"request-unconfirmed", "request-unknown"}
    assert {each["file"] for each in outcome.document["diagnostics"]} == {"0.pem", "1.pem"}


@pytest.mark.parametrize("given", ["talker", "talker=12", f"={'0' * 64}", "talker=" + "g" * 64])
def test_fingerprints_that_are_none(keymint, ws: Path, given: str) -> None:
    ask(keymint)
    before = snapshot(ws)
    assert keymint("sign", "talker.request.pem", "-w", "ws", "--fingerprint", given).code in {1, 2}
    assert snapshot(ws) == before


def test_files_that_are_no_requests(keymint, ws: Path) -> None:
    for content in (b"", b"x", (ws / "install/enclaves/talker/cert.pem").read_bytes()):
        carried(ws, content)
        assert refused(keymint, ws, "talker.request.pem") == "request-invalid"
    carried(ws, b"x" * 100_000)
    assert keymint("sign", "talker.request.pem", "-w", "ws", "--json").codes() == ["file-size"]


def test_an_authority_whose_key_is_elsewhere(keymint, ws: Path) -> None:
    (ws / "private/identity_ca.key.pem").rename(ws.parent / "elsewhere.pem")
    assert refused(keymint, ws, "talker.request.pem", "--fingerprint", ask(keymint)) == "authority-key-missing"


def test_openssl_can_make_the_request(keymint, ws: Path) -> None:
    """The form is PKCS #10, so that other tools can make a request, for a key in a token of theirs."""
    folder = ws.parent
    config = f"[req]\ndistinguished_name=n\nattributes=a\nprompt=no\n[n]\nCN=/talker\n[a]\nchallengePassword={NONCE}\n"
    (folder / "config").write_text(config)
    asked = ["openssl", "req", "-new", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout"]
    asked += ["key.pem", "-config", "config", "-out", "talker.request.pem"]
    subprocess.run(asked, cwd=folder, check=True, capture_output=True)
    fingerprint = keys.fingerprint(private(folder, "key.pem"))
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", f"talker={fingerprint}")
