# SPDX-License-Identifier: Apache-2.0
"""Workspaces whose authorities have their keys in a token."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from keymint.api import KeySpec
from keymint.pki import certificates
from keymint.pki.tokens.token_sessions import PIN_VARIABLE, Tokens
from tests.conftest import NOW, snapshot
from tests.keymint.pki.conftest import make_spec
from tests.keymint.stages.keystores import AUTHORITY_KEYS, CERTIFICATES, ENCLAVES, content, public_key
from tests.softhsm import PIN, SoftHsm

pytestmark = pytest.mark.softhsm
NAMES = ("identity_ca", "permissions_ca")
RIGHT, WRONG = {PIN_VARIABLE: PIN}, {PIN_VARIABLE: "wrong-secret"}


def name_keys(ws: Path, **elements: str) -> None:
    """Name the authorities' keys in the profile."""
    path = ws / "profile/authorities.xml"
    text = path.read_text()
    for name, element in elements.items():
        opening = f'<authority name="{name}">'
        before, after = text.split(opening)
        text = f"{before}{opening}\n      <key>{element}</key>{after}"
    path.write_text(text)


def uri(element: str) -> str:
    return f"<pkcs11>{element}</pkcs11>"


@pytest.fixture
def in_token(ws: Path, softhsm: SoftHsm) -> Path:
    """A workspace that was installed with keys in files, which were then moved into a token."""
    uris = {}
    for number, (name, file) in enumerate(zip(NAMES, AUTHORITY_KEYS, strict=True), start=1):
        uris[name] = uri(softhsm.import_key(ws / file, name, f"{number:02}"))
    name_keys(ws, **uris)
    for file in AUTHORITY_KEYS:
        (ws / file).unlink()
    return ws


@pytest.fixture
def signatures(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts what tokens sign, by URI."""
    counted: Counter[str] = Counter()
    sign = Tokens._sign

    def counting(self: Tokens, spec, where, data, mechanism) -> bytes:
        counted[spec.uri.rpartition("=")[2]] += 1
        return sign(self, spec, where, data, mechanism)

    monkeypatch.setattr(Tokens, "_sign", counting)
    return counted


def expire_soon(ws: Path, package: str = "talker") -> None:
    """Let the certificate of a package end earlier, so that one certificate must be issued."""
    path = ws / "src" / package / "identities.xml"
    period = "<validity><not_before>2026-11-17T00:00:00</not_before><duration>P200D</duration></validity>"
    path.write_text(path.read_text().replace("<identity/>", f"<identity><cert>{period}</cert></identity>"))
    assert period in path.read_text()


@pytest.mark.parametrize("kinds", [("P-256", "P-256"), ("P-256", "RSA")], ids="/".join)
def test_a_workspace_whose_authorities_never_had_files(
    keymint, policy: Path, tmp_path: Path, softhsm: SoftHsm, kinds: tuple[str, str], signatures: Counter[str]
) -> None:
    ws = tmp_path / "ws"
    assert keymint("init", "ws", "--policy", policy).code == 0
    for file in (*AUTHORITY_KEYS, *CERTIFICATES):
        (ws / file).unlink()
    rsa = "<asymmetric_type><rsa><key_size>2048</key_size></rsa></asymmetric_type>"
    name_keys(
        ws,
        **{
            name: uri(softhsm.make_key(name, f"0{number}", kind)) + (rsa if kind == "RSA" else "")
            for number, (name, kind) in enumerate(zip(NAMES, kinds, strict=True))
        },
    )
    outcome = keymint("provision", policy, "-w", "ws", env=RIGHT)
    assert outcome.code == 0, outcome.err
    assert not [*(ws / "private").glob("*.pem")]
    assert keymint("check", cwd=ws).out == "checked 2 enclaves: no findings\n"
    assert keymint("prove", cwd=ws).code == 0
    # Each authority signed its certificate; then one signed two identities, the other two permissions, one governance.
    assert signatures == {"identity_ca": 3, "permissions_ca": 4}
    for enclave in ENCLAVES:
        folder = ws / "install/enclaves" / enclave
        accepts("verify", "-CAfile", folder / "identity_ca.cert.pem", folder / "cert.pem")
        for document in ("permissions.p7s", "governance.p7s"):
            trusted = ("-CAfile", folder / "permissions_ca.cert.pem", "-in", folder / document)
            accepts("smime", "-verify", "-text", *trusted)
    assert PIN not in outcome.out + outcome.err
    assert not [file for file in ws.rglob("*") if file.is_file() and PIN.encode() in file.read_bytes()]


def accepts(*arguments: str | Path) -> None:
    at = ("-attime", str(NOW))
    done = subprocess.run(["openssl", *arguments[:1], *at, *arguments[1:]], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_moving_the_keys_changes_nothing_and_needs_no_token(keymint, in_token: Path, softhsm: SoftHsm) -> None:
    before = content(in_token)
    shutil.rmtree(softhsm.folder)
    assert keymint("build", cwd=in_token).code == 0
    outcome = keymint("install", cwd=in_token)
    assert (outcome.code, outcome.err) == (0, "")
    assert content(in_token) == before
    assert keymint("check", cwd=in_token).out == "checked 2 enclaves: no findings\n"
    assert keymint("status", cwd=in_token).code == 0


def test_only_what_changed_is_signed(keymint, in_token: Path, signatures: Counter[str]) -> None:
    expire_soon(in_token)
    assert keymint("build", cwd=in_token).code == 0
    before = content(in_token)
    outcome = keymint("install", cwd=in_token, env=RIGHT)
    assert outcome.code == 0, outcome.err
    assert signatures == {"identity_ca": 1}
    after = content(in_token)
    changed = {name for name in after if after[name] != before[name]}
    assert changed == {"install/enclaves/talker/cert.pem", "private/register.sqlite3"}
    assert keymint("check", cwd=in_token).code == 0


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({}, f"the environment variable {PIN_VARIABLE}, which holds the PIN of the token ca, is not set"),
        (WRONG, "the PIN of the token ca is wrong"),
    ],
)
def test_without_the_pin_nothing_is_written(keymint, in_token: Path, environment: dict[str, str], said: str) -> None:
    expire_soon(in_token)
    assert keymint("build", cwd=in_token).code == 0
    before = snapshot(in_token)
    outcome = keymint("install", cwd=in_token, env=environment)
    assert outcome.code == 1
    assert outcome.err.startswith("profile/authorities.xml:")
    assert said in outcome.err
    assert outcome.err.count("\n") == 1
    assert "wrong-secret" not in outcome.err
    assert snapshot(in_token) == before


def test_a_pin_file_and_a_variable_that_are_named(keymint, in_token: Path, tmp_path: Path) -> None:
    pin = tmp_path / "ca.pin"
    pin.write_text(f"{PIN}\n")
    profile = in_token / "profile/authorities.xml"
    plain = profile.read_text()
    expire_soon(in_token)
    profile.write_text(plain.replace("=identity_ca<", f"=identity_ca?pin-source=file:{pin}<"))
    assert keymint("build", cwd=in_token).code == 0
    pin.chmod(0o644)
    outcome = keymint("install", cwd=in_token, env=WRONG)
    assert f"the PIN file {pin} has mode 0644" in outcome.err
    pin.chmod(0o600)
    assert keymint("install", cwd=in_token, env=WRONG).code == 0
    expire_soon(in_token, "robot1/listener")
    profile.write_text(plain.replace("</pkcs11>", "</pkcs11><pin_env>CA_PIN</pin_env>"))
    assert keymint("build", cwd=in_token).code == 0
    outcome = keymint("install", cwd=in_token, env=RIGHT)
    assert "the environment variable CA_PIN, which holds the PIN" in outcome.err
    assert keymint("install", cwd=in_token, env={**WRONG, "CA_PIN": PIN}).code == 0


def test_a_copy_of_the_key_in_a_file_is_reported(keymint, in_token: Path, ws: Path) -> None:
    (in_token / AUTHORITY_KEYS[0]).write_bytes(b"what is left")
    (in_token / AUTHORITY_KEYS[0]).chmod(0o600)
    for verb in ("check", "install"):
        outcome = keymint(verb, "--json", cwd=in_token)
        (found,) = [each for each in outcome.document["diagnostics"] if each["code"] == "authority-key-copy"]
        assert (found["severity"], found["file"]) == ("warning", AUTHORITY_KEYS[0])


def test_another_key_in_the_token_signs_nothing(keymint, in_token: Path, softhsm: SoftHsm) -> None:
    softhsm.delete("identity_ca")
    softhsm.make_key("identity_ca", "09")
    expire_soon(in_token)
    assert keymint("build", cwd=in_token).code == 0
    before = snapshot(in_token)
    outcome = keymint("install", "--json", cwd=in_token, env=RIGHT)
    assert (outcome.code, outcome.codes()) == (1, ["token-key-mismatch"])
    assert snapshot(in_token) == before


def test_a_new_authority_needs_a_new_key(keymint, in_token: Path, softhsm: SoftHsm) -> None:
    keymint("build", cwd=in_token)
    before = snapshot(in_token)
    outcome = keymint("install", "--new-authority", "identity_ca", "--json", cwd=in_token, env=RIGHT)
    assert (outcome.code, outcome.codes()) == (1, ["authority-key-same"])
    assert snapshot(in_token) == before
    old = public_key(in_token / CERTIFICATES[0])
    softhsm.make_key("next", "09")
    profile = in_token / "profile/authorities.xml"
    profile.write_text(profile.read_text().replace("object=identity_ca", "object=next"))
    keymint("build", cwd=in_token)
    outcome = keymint("install", "--new-authority", "identity_ca", cwd=in_token, env=RIGHT)
    assert outcome.code == 0, outcome.err
    assert "'identity_ca' is a new authority" in outcome.err
    assert public_key(in_token / CERTIFICATES[0]) != old
    assert keymint("check", cwd=in_token).code == 0


def test_a_lost_certificate_is_not_replaced(keymint, in_token: Path) -> None:
    (in_token / CERTIFICATES[0]).unlink()
    keymint("build", cwd=in_token)
    outcome = keymint("install", "--json", cwd=in_token, env=RIGHT)
    assert (outcome.code, outcome.codes()) == (1, ["authority-lost"])


@pytest.mark.parametrize(
    ("of_type", "said"),
    [
        ("<ec><curve>SECP384R1</curve></ec>", "is not an EC key on SECP384R1"),
        ("<rsa><key_size>2048</key_size></rsa>", "is not an RSA key of 2048 bits"),
    ],
)
def test_the_type_must_be_that_of_the_token(keymint, in_token: Path, of_type: str, said: str) -> None:
    profile = in_token / "profile/authorities.xml"
    text = profile.read_text()
    profile.write_text(text.replace("</pkcs11>", f"</pkcs11><asymmetric_type>{of_type}</asymmetric_type>", 1))
    keymint("build", cwd=in_token)
    outcome = keymint("install", "--json", cwd=in_token, env=RIGHT)
    assert (outcome.code, outcome.codes()) == (1, ["key-kind"])
    assert said in outcome.document["diagnostics"][0]["message"]


def test_one_key_for_two_authorities_is_refused(keymint, in_token: Path, softhsm: SoftHsm) -> None:
    profile = in_token / "profile/authorities.xml"
    profile.write_text(profile.read_text().replace("object=permissions_ca", "object=identity_ca"))
    keymint("build", cwd=in_token)
    outcome = keymint("install", "--new-authority", "permissions_ca", "--json", cwd=in_token, env=RIGHT)
    assert (outcome.code, outcome.codes()) == (1, ["authority-key-shared"])


def test_an_authority_in_a_token_below_one_in_a_token(keymint, in_token: Path, signatures: Counter[str]) -> None:
    profile = in_token / "profile/authorities.xml"
    before, after = profile.read_text().split('<authority name="identity_ca">')
    issued = after.replace("<issuer_name></issuer_name>", "<issuer_name>permissions_ca</issuer_name>", 1)
    profile.write_text(f'{before}<authority name="identity_ca">{issued}')
    assert keymint("build", "--allow-vendor-specific", cwd=in_token).code == 0
    outcome = keymint("install", "--no-prove", cwd=in_token, env=RIGHT)
    assert outcome.code == 0, outcome.err
    assert signatures["permissions_ca"] == 1
    authorities = ("-CAfile", in_token / CERTIFICATES[1], in_token / CERTIFICATES[0])
    accepts("verify", *authorities)


def test_many_packages_are_signed_in_one_process(
    keymint, tmp_path: Path, ws: Path, in_token: Path, signatures: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("keymint.run.execution.MIN_PACKAGES", 1)
    for enclave in ENCLAVES:
        expire_soon(in_token, enclave)
    assert keymint("build", "-j2", cwd=in_token).code == 0
    assert keymint("install", "-j2", cwd=in_token, env=RIGHT).code == 0
    assert signatures == {"identity_ca": 2}, "what another process signs is not counted"


def test_a_robot_that_made_no_request_yet_keeps_nobody_waiting(keymint, policy: Path, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    assert keymint("init", "ws", "--policy", policy).code == 0
    assert keymint("create", "--all", cwd=ws).code == 0
    manifest, identities = ws / "profile/keymint_profile.xml", ws / "src/talker/identities.xml"
    manifest.write_text(manifest.read_text().replace("</profile>", "<exceptions><token_keys/></exceptions></profile>"))
    named = f"<identity><key>{uri('pkcs11:token=robot;object=talker')}</key></identity>"
    identities.write_text(identities.read_text().replace("<identity/>", named))
    for _ in range(2):
        assert keymint("build", cwd=ws).code == 0
        assert not (ws / "private/identities/talker").exists()
        outcome = keymint("install", "--json", cwd=ws)
        assert (outcome.code, outcome.codes()) == (0, ["key-unknown"])
    assert not (ws / "install/enclaves/talker").exists()
    assert (ws / "install/enclaves/robot1/listener/cert.pem").exists()
    lines = ("check",), ("prove", "talker"), ("verify", "-t", "omg"), ("env", "/talker"), ("bundle", "talker")
    for words in lines:
        told = keymint(*words, "--json", cwd=ws).document["diagnostics"]
        (missing,) = (each for each in told if each["code"] in {"enclave-missing", "not-installed"})
        assert "'keymint request" in missing["help"], words
    assert keymint("build", "--rekey", "talker", "--json", cwd=ws).codes() == ["key-elsewhere"]
    assert keymint("build", "-f", cwd=ws).code == 0


def test_the_verbs_of_authorities(keymint, in_token: Path, tmp_path: Path, signatures: Counter[str]) -> None:
    shown = keymint("authority", "show", "--json", cwd=in_token).document["result"]["authorities"]
    assert [each["private_key"] for each in shown] == ["token", "token"]
    assert (keymint("build", cwd=in_token).code, keymint("install", cwd=in_token).code) == (0, 0)
    before = snapshot(in_token)
    pem = in_token / CERTIFICATES[0]
    for words in (
        ("replace", "identity_ca", "--vendor", "fastdds"),
        ("export", "identity_ca", "--with-key", tmp_path / "out.pem"),
        ("import", "identity_ca", pem, "--key", pem),
    ):
        outcome = keymint("authority", *words, "--json", cwd=in_token, env=RIGHT)
        assert (outcome.code, outcome.codes()) == (1, ["authority-in-token"]), words
    assert not (tmp_path / "out.pem").exists()
    assert content_of(snapshot(in_token)) == content_of(before)
    assert not signatures
    certificate = pem.read_bytes()
    later = {**RIGHT, "SOURCE_DATE_EPOCH": str(NOW + 6 * 365 * 24 * 3600)}
    outcome = keymint("authority", "renew", "identity_ca", cwd=in_token, env=later)
    assert outcome.code == 0, outcome.err
    assert signatures["identity_ca"] >= 1
    assert pem.read_bytes() != certificate


def content_of(files: dict[str, tuple[int, int, bytes]]) -> dict[str, bytes]:
    return {name: data for name, (_, _, data) in files.items()}


def test_a_token_signs_revocation_lists(keymint, in_token: Path, signatures: Counter[str]) -> None:
    stolen = (in_token / "install/enclaves/talker/cert.pem").read_bytes()
    (in_token.parent / "stolen.pem").write_bytes(stolen)
    outcome = keymint("revoke", "talker", "--reason", "key-compromise", cwd=in_token)
    assert outcome.code == 1
    assert PIN_VARIABLE in outcome.err
    signatures.clear()  # it was asked for one
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=in_token, env=RIGHT).code == 0
    assert signatures["identity_ca"] == 1
    crl, authority = in_token / "public/identity_ca.crl.pem", in_token / CERTIFICATES[0]
    trusted = ("-crl_check", "-CRLfile", crl, "-CAfile", authority)
    accepts("verify", *trusted, in_token / "install/enclaves/robot1/listener/cert.pem")
    command = ["openssl", "verify", "-attime", str(NOW), *trusted, in_token.parent / "stolen.pem"]
    done = subprocess.run(command, capture_output=True, check=False)
    assert b"certificate revoked" in done.stderr
    assert keymint("install", cwd=in_token).code == 0  # nothing is to be signed


CTRL_C = b"\x03"
PROMPT = b"PIN of the token ca: "


def at_terminal(ws: Path, typed: bytes, *words: str) -> tuple[int, str]:
    """Run the command at a terminal, and type something when it asks; returns its exit code and what it showed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    child, terminal = pty.fork()
    if not child:
        os.chdir(ws)
        os.execve(sys.executable, [sys.executable, "-m", "keymint", *words], environment)
    shown = b""
    with contextlib.suppress(OSError):  # the terminal of a process that ended
        while True:
            # Python sees a signal that comes just before it begins to read with the next one, as a user would press it.
            while typed == CTRL_C and PROMPT in shown and not select.select([terminal], [], [], 2)[0]:
                os.write(terminal, typed)
            if not (part := os.read(terminal, 4096)):
                break
            shown += part
            if shown.endswith(PROMPT):
                os.write(terminal, typed)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    os.close(terminal)
    return code, shown.decode()


@pytest.mark.parametrize(
    ("typed", "code", "said"),
    [
        (f"{PIN}\n".encode(), 0, "1 updated"),
        (b"wrong-secret\n", 1, "the PIN of the token ca is wrong"),
        (b"\n", 1, f"the environment variable {PIN_VARIABLE}"),
        (b"\x04", 1, f"the environment variable {PIN_VARIABLE}"),
        (CTRL_C, 130, "interrupted"),
    ],
    ids=["right", "wrong", "empty", "end of input", "Ctrl+C"],
)
def test_the_user_is_asked_at_a_terminal(keymint, in_token: Path, typed: bytes, code: int, said: str) -> None:
    expire_soon(in_token)
    assert keymint("build", cwd=in_token).code == 0
    before = content(in_token)
    found, shown = at_terminal(in_token, typed, "install")
    assert (found, said in shown) == (code, True), shown
    assert shown.count("PIN of the token ca: ") == 1
    assert PIN not in shown
    assert "wrong-secret" not in shown
    assert (content(in_token) == before) == (code != 0)


def test_an_authority_of_the_company_signs_with_its_token(
    keymint, policy: Path, tmp_path: Path, softhsm: SoftHsm, signatures: Counter[str]
) -> None:
    """Its certificate was made elsewhere, with a name and extensions of its own; its key never was in a file."""
    ws, name = tmp_path / "ws", "identity_ca"
    spec = KeySpec("ec", "SECP256R1", uri=softhsm.make_key("company"))
    assert keymint("init", "ws", "--policy", policy).code == 0
    (ws / AUTHORITY_KEYS[0]).unlink()
    (ws / CERTIFICATES[0]).unlink()
    name_keys(ws, **{name: uri(spec.uri)})
    tokens = Tokens(RIGHT)
    key = tokens.private_key(spec, tokens.public_key(spec))
    (tmp_path / "company.pem").write_bytes(
        certificates.issue(make_spec("O=Company,CN=Robots"), key.public_key(), key, authority=True).pem
    )
    tokens.close()
    signatures.clear()
    outcome = keymint("authority", "import", name, tmp_path / "company.pem", cwd=ws)
    assert outcome.code == 0, outcome.err
    outcome = keymint("provision", policy, "-w", "ws", env=RIGHT)
    assert outcome.code == 0, outcome.err
    assert signatures == {"company": 2}
    assert keymint("check", cwd=ws).out == "checked 2 enclaves: no findings\n"
    certificate = certificates.load((ws / "install/enclaves/talker/cert.pem").read_bytes())
    assert certificate.issuer == certificates.load((tmp_path / "company.pem").read_bytes()).subject
