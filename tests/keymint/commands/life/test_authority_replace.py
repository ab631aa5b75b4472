# SPDX-License-Identifier: Apache-2.0
"""``keymint authority replace``: each phase, with openssl as the judge, and what must not happen."""

from __future__ import annotations

import stat
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509

from tests.conftest import snapshot
from tests.keymint.commands.life.test_authority import IDENTITY, PERMISSIONS, certificate, openssl_accepts, outside
from tests.keymint.stages.keystores import AUTHORITY_KEYS, CERTIFICATES, ENCLAVES, content, public_key, trusted

BUNDLES = ("--vendor", "fastdds")
OTHERS = (("prove",), ("build",), ("status",), ("authority", "show"))
REISSUE, END = ("--phase", "reissue"), ("--phase", "end")
AUTHORITY_NAMES = (IDENTITY, PERMISSIONS)


@pytest.fixture
def replace(keymint, ws: Path) -> Callable:
    """Run ``keymint authority replace`` in the workspace, and require that it succeeds."""

    def run(*words: str) -> str:
        outcome = keymint("authority", "replace", *words, cwd=ws)
        assert outcome.code == 0, outcome.err
        return outcome.out + outcome.err

    return run


def clean(keymint: Callable, ws: Path, *more: tuple[str, ...]) -> None:
    """Require that other verbs are content, and change nothing."""
    before = content(ws)
    for words in (("check",), ("install",), *more):
        outcome = keymint(*words, cwd=ws)
        assert outcome.code == 0, (words, outcome.err)
    after = content(ws)
    assert {name for name in after if before.get(name) != after[name]} == set()
    openssl_accepts(ws)


def authorities(ws: Path, name: str, space: str = "install") -> list[bytes]:
    """Return the serial numbers of the authorities that all enclaves trust, which must be the same in each."""
    files = {(ws / space / "enclaves" / each / f"{name}.cert.pem").read_bytes() for each in ENCLAVES}
    assert len(files) == 1
    return [str(each.serial_number).encode() for each in x509.load_pem_x509_certificates(files.pop())]


# -- where subjects may trust two authorities ------------------------------------------------------------------------


def test_by_bundles(keymint, ws: Path, replace: Callable) -> None:
    name = IDENTITY
    old, leaves = authorities(ws, name), trusted(ws)
    key, path = public_key(ws / f"private/{name}.key.pem"), ws / f"public/{name}.cert.pem"
    said = replace(name, *BUNDLES)
    assert "all enclaves trust the present and the next authority" in said
    both = authorities(ws, name)
    assert both[:1] == old
    assert len(both) == 2
    assert trusted(ws) == leaves
    assert stat.S_IMODE((ws / f"private/{name}.next.key.pem").stat().st_mode) == 0o600
    clean(keymint, ws, *OTHERS)
    for words in ((), ("--phase", "distribute"), BUNDLES):
        assert "nothing to do" in replace(name, *words)
    assert keymint("authority", "replace", name, *END, cwd=ws).code == 2

    replace(name, *REISSUE)
    assert authorities(ws, name) == [both[1], both[0]]
    assert public_key(ws / f"private/{name}.former.key.pem") == key
    assert public_key(ws / f"private/{name}.key.pem") == public_key(path) != key
    clean(keymint, ws)

    replace(name, *END)
    assert authorities(ws, name) == both[1:]
    assert not list((ws / "private").glob("*former*")) + list((ws / "private").glob("*next*"))
    clean(keymint, ws)
    new, identifiers = certificate(path), set()
    assert new.subject == x509.Name.from_rfc4514_string(f"CN={name}")
    for kind in (x509.SubjectKeyIdentifier, x509.KeyUsage):
        identifiers.add(new.extensions.get_extension_for_class(kind).value)
    assert any(isinstance(each, x509.KeyUsage) and each.crl_sign for each in identifiers)
    assert "nothing to do" in replace(name, *END)
    assert keymint("authority", "replace", name, *REISSUE, cwd=ws).code == 1


def test_in_each_phase_of_bundles_robots_of_the_phase_before_are_accepted(
    keymint, ws: Path, replace: Callable, tmp_path: Path
) -> None:
    """A robot that was not updated yet verifies updated ones, and the other way round."""
    folders = [tmp_path / "robots-0"]
    folders[0].mkdir()

    def keep(number: int) -> None:
        folder = tmp_path / f"robots-{number}"
        folder.mkdir(exist_ok=True)
        for name in ("cert.pem", "identity_ca.cert.pem"):
            (folder / name).write_bytes((ws / "install/enclaves/talker" / name).read_bytes())
        folders[number:] = [folder]

    keep(0)
    for number, words in enumerate(((IDENTITY, *BUNDLES), (IDENTITY, *REISSUE), (IDENTITY, *END)), 1):
        replace(*words)
        keep(number)
        for one, two in ((number, number - 1), (number - 1, number)):
            command = ["openssl", "verify", "-attime", "1800000000", "-CAfile", folders[one] / "identity_ca.cert.pem"]
            done = subprocess.run([*command, folders[two] / "cert.pem"], capture_output=True, text=True, check=False)
            assert done.returncode == 0, (one, two, done.stderr)
    # Without the phases between, they do not know each other.
    command = ["openssl", "verify", "-attime", "1800000000", "-CAfile", folders[0] / "identity_ca.cert.pem"]
    assert subprocess.run([*command, folders[3] / "cert.pem"], capture_output=True, check=False).returncode != 0


def test_revoked_certificates_stay_revoked_in_each_phase(keymint, ws: Path, replace: Callable, tmp_path: Path) -> None:
    stolen = (ws / "install/enclaves/talker/cert.pem").read_bytes()
    (tmp_path / "stolen.pem").write_bytes(stolen)
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
    listener = ws / "install/enclaves/robot1/listener"
    assert (listener / "crl.pem").exists()

    def judged(leaf: Path) -> str:
        arguments = ["-CAfile", listener / "identity_ca.cert.pem"]
        if (listener / "crl.pem").exists():
            arguments += ["-CRLfile", listener / "crl.pem"]
        command = ["openssl", "verify", "-attime", "1800000000", "-crl_check", *arguments, leaf]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return "OK" if done.returncode == 0 else done.stderr

    before = (ws / "install/enclaves/talker/cert.pem").read_bytes()
    (tmp_path / "before.pem").write_bytes(before)
    for words in ((IDENTITY, *BUNDLES), (IDENTITY, *REISSUE)):
        replace(*words)
        clean(keymint, ws)
        assert not (listener / "crl.pem").exists()  # which vendors read one list from
        assert listener.joinpath("identity_ca.cert.pem").read_bytes().count(b"BEGIN X509 CRL") == 2
        assert "revoked" in judged(tmp_path / "stolen.pem")
        assert judged(tmp_path / "before.pem") == "OK"
        assert judged(listener / "cert.pem") == "OK"
    # In the second phase the former authority still revokes what it issued.
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
    assert "revoked" in judged(tmp_path / "before.pem")
    assert judged(ws / "install/enclaves/talker/cert.pem") == "OK"
    clean(keymint, ws)
    lists = keymint("crl", "--json", cwd=ws).document["result"]["lists"]
    listed = {each["authority"]: len(each["revoked"]) for each in lists}
    assert listed == {"identity_ca": 1, "identity_ca.former": 2}
    assert "revocations   number" in keymint("authority", "show", cwd=ws).out
    replace(IDENTITY, *END)
    assert listener.joinpath("identity_ca.cert.pem").read_bytes().count(b"BEGIN") == 1
    assert (listener / "crl.pem").exists()
    assert judged(listener / "cert.pem") == "OK"
    assert not list((ws / "public").glob("*former*")) + list((ws / "public").glob("*next*"))
    clean(keymint, ws)


def test_a_refresh_gives_both_trusted_authorities_a_list_at_once(keymint, ws: Path, replace: Callable) -> None:
    replace(IDENTITY, *BUNDLES)
    (ws / f"public/{IDENTITY}.crl.pem").write_text("damaged")
    outcome = keymint("crl", "--refresh", "--json", cwd=ws)
    assert outcome.code == 0, outcome.out
    assert [each["authority"] for each in outcome.document["result"]["lists"]] == [IDENTITY, f"{IDENTITY}.next"]
    clean(keymint, ws)


# -- elsewhere -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", AUTHORITY_NAMES)
def test_by_a_second_keystore(keymint, ws: Path, replace: Callable, name: str) -> None:
    before = {path: data for path, data in content(ws).items() if path.startswith("install/")}
    said = replace(name)
    assert "set ROS_SECURITY_KEYSTORE to it, and restart all of them together" in said
    after = content(ws)
    assert {path: data for path, data in after.items() if path.startswith("install/")} == before
    assert authorities(ws, name) != authorities(ws, name, "install.next")
    assert (ws / "install.next/.gitignore").read_text().endswith("\n*\n")
    for each in ENCLAVES:
        assert stat.S_IMODE((ws / "install.next/enclaves" / each / "key.pem").stat().st_mode) == 0o600
    clean(keymint, ws, *OTHERS)
    assert "nothing to do" in replace(name)
    staged = {path: data for path, data in content(ws).items() if path.startswith("install.next/enclaves/")}

    replace(name, *END)
    now = content(ws)
    assert {path.replace("install.next/", "install/", 1): data for path, data in staged.items()} == {
        path: data for path, data in now.items() if path.startswith("install/enclaves/")
    }
    assert not [path for path in now if path.startswith("install.next/") and not path.endswith(".gitignore")]
    assert not list((ws / "private").glob("*next*"))
    clean(keymint, ws)


def test_a_second_keystore_follows_the_sources(keymint, ws: Path, replace: Callable) -> None:
    replace(IDENTITY)
    policy = ws.parent / "policy.xml"
    policy.write_text(policy.read_text().replace("/chatter", "/chat"))
    assert keymint("provision", policy, "-w", "ws").code == 0
    before = content(ws)
    refused = keymint("authority", "replace", IDENTITY, *END, "--json", cwd=ws)
    assert (refused.code, refused.codes()[-1]) == (1, "rollover-incomplete")
    assert content(ws) == before
    replace(IDENTITY)
    replace(IDENTITY, *END)
    clean(keymint, ws)


def test_a_second_keystore_has_no_list_of_the_former_authority(keymint, ws: Path, replace: Callable) -> None:
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
    replace(IDENTITY)
    assert (ws / "install/enclaves/talker/crl.pem").exists()
    assert not (ws / "install.next/enclaves/talker/crl.pem").exists()
    clean(keymint, ws)
    replace(IDENTITY, *END)
    assert not list(ws.glob("install*/**/crl.pem"))
    clean(keymint, ws)


@pytest.mark.parametrize("reason", ["superseded", "key-compromise"])
def test_what_is_revoked_while_a_second_keystore_waits_is_revoked_in_it(
    keymint, ws: Path, replace: Callable, tmp_path: Path, reason: str
) -> None:
    replace(IDENTITY)
    (tmp_path / "old.pem").write_bytes((ws / "install.next/enclaves/talker/cert.pem").read_bytes())
    assert keymint("revoke", "talker", "--reason", reason, cwd=ws).code == 0
    refused = keymint("authority", "replace", IDENTITY, *END, "--json", cwd=ws)
    assert refused.codes()[-1] == "rollover-incomplete"
    replace(IDENTITY)
    assert "nothing to do" in replace(IDENTITY)
    listener = ws / "install.next/enclaves/robot1/listener"
    command = ["openssl", "verify", "-attime", "1800000000", "-crl_check", "-CAfile", listener / "identity_ca.cert.pem"]
    command += ["-CRLfile", listener / "crl.pem"]
    done = subprocess.run([*command, tmp_path / "old.pem"], capture_output=True, text=True, check=False)
    assert "revoked" in done.stderr
    assert subprocess.run([*command, listener / "cert.pem"], capture_output=True, check=False).returncode == 0
    assert (ws / "install.next/enclaves/talker").exists() == (reason == "superseded")
    staged = (listener / "crl.pem").read_bytes()
    replace(IDENTITY, *END)
    assert (ws / "install/enclaves/robot1/listener/crl.pem").read_bytes() == staged
    assert (ws / "public/identity_ca.crl.pem").read_bytes() == staged
    assert not list((ws / "public").glob("*next*"))
    for verb in ("check", "prove", "install"):
        assert keymint(verb, cwd=ws).code == 0, verb


def test_with_two_transports(keymint, policy: Path, tmp_path: Path) -> None:
    made = keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "zenoh")
    assert made.code == 0, made.err
    ws = tmp_path / "ws"
    assert keymint("authority", "replace", IDENTITY, cwd=ws).code == 0
    router = (ws / "install.next/zenoh/router.json5").read_text()
    assert f"{ws}/install.next/" in router
    assert f"{ws}/install/" not in router
    for words in (("check",), ("authority", "replace", IDENTITY, *END), ("check",), ("prove",)):
        outcome = keymint(*words, cwd=ws)
        assert outcome.code == 0, (words, outcome.err)
    assert f"{ws}/install/" in (ws / "install/zenoh/router.json5").read_text()


# -- a way out, and what is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [(), BUNDLES], ids=["second keystore", "bundles"])
def test_it_can_be_cancelled(keymint, ws: Path, replace: Callable, words: tuple[str, ...]) -> None:
    before = trusted(ws), authorities(ws, IDENTITY)
    replace(IDENTITY, *words)
    replace(IDENTITY, "--cancel")
    assert (trusted(ws), authorities(ws, IDENTITY)) == before
    assert not list((ws / "private").glob("*next*"))
    assert not [path for path in content(ws) if path.startswith("install.next/") and not path.endswith(".gitignore")]
    clean(keymint, ws)
    replace(IDENTITY, *words)


def test_it_cannot_be_cancelled_once_the_next_authority_issues(keymint, ws: Path, replace: Callable) -> None:
    replace(IDENTITY, *BUNDLES)
    replace(IDENTITY, *REISSUE)
    before = content(ws)
    outcome = keymint("authority", "replace", IDENTITY, "--cancel", "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, ["rollover-too-late"])
    assert content(ws) == before


def test_a_phase_begins_only_after_the_one_before_it(keymint, ws: Path, replace: Callable) -> None:
    replace(IDENTITY, *BUNDLES)
    bundle = ws / "install/enclaves/talker/identity_ca.cert.pem"
    bundle.write_bytes((ws / CERTIFICATES[0]).read_bytes())
    before = content(ws)
    outcome = keymint("authority", "replace", IDENTITY, *REISSUE, "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, ["rollover-incomplete"])
    assert content(ws) == before
    replace(IDENTITY)
    assert len(authorities(ws, IDENTITY)) == 2
    replace(IDENTITY, *REISSUE)


def test_while_it_is_under_way_the_key_is_not_changed_otherwise(keymint, ws: Path, replace: Callable) -> None:
    replace(IDENTITY, *BUNDLES)
    (ws.parent / "ca.pem").write_bytes(outside(IDENTITY)[0])
    for words in (
        ("install", "--new-authority", IDENTITY),
        ("authority", "renew", IDENTITY),
        ("authority", "import", IDENTITY, "../ca.pem"),
        ("authority", "replace", IDENTITY, "--vendor", "cyclonedds"),
        ("authority", "replace", IDENTITY, "--certificate", "../ca.pem"),
    ):
        before = content(ws)
        outcome = keymint(*words, cwd=ws)
        assert outcome.code in {1, 2}
        assert "authority replace" in outcome.err or "already" in outcome.err
        assert content(ws) == before


def test_signers_of_documents_are_not_bundled(keymint, ws: Path, replace: Callable) -> None:
    outcome = keymint("authority", "replace", PERMISSIONS, *BUNDLES, "--phase", "distribute", "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, ["rollover-no-bundle"])
    assert "a second keystore by the next authority is ready" in replace(PERMISSIONS, *BUNDLES)


def test_a_dry_run_says_the_phases_and_writes_nothing(keymint, ws: Path) -> None:
    before = snapshot(ws)
    said = keymint("authority", "replace", IDENTITY, "--dry-run", cwd=ws).out
    assert "> 1. stage: a second keystore" in said
    said = keymint("authority", "replace", IDENTITY, *BUNDLES, "--dry-run", cwd=ws).out
    assert "> 1. distribute" in said
    assert "  2. reissue" in said
    assert snapshot(ws) == before


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--vendor", "fastds"), 2),
        ((*END, "--cancel"), 2),
        (("--key", "x"), 2),
        (REISSUE, 1),
        (("--phase", "distribute"), 1),
        (("--phase", "distribute", "--vendor", "fastdds", "--vendor", "cyclonedds"), 1),
        (("--certificate", "../same.pem"), 1),
    ],
)
def test_what_is_refused(keymint, ws: Path, words: tuple[str, ...], code: int) -> None:
    (ws.parent / "same.pem").write_bytes((ws / CERTIFICATES[0]).read_bytes())
    before = content(ws)
    outcome = keymint("authority", "replace", IDENTITY, *words, cwd=ws)
    assert outcome.code == code
    assert outcome.err.count("\n") >= 1
    assert content(ws) == before


def test_an_authority_that_cannot_be_told_apart_is_not_bundled(keymint, policy: Path, tmp_path: Path) -> None:
    pem, key = outside(identifier=False)
    (tmp_path / "ca.pem").write_bytes(pem)
    (tmp_path / "ca.key").write_bytes(key)
    assert keymint("init", "ws", "--policy", policy).code == 0
    ws = tmp_path / "ws"
    assert keymint("authority", "import", IDENTITY, "../ca.pem", "--key", "../ca.key", cwd=ws).code == 0
    assert keymint("provision", policy, "-w", "ws").code == 0
    outcome = keymint("authority", "replace", IDENTITY, *BUNDLES, "--json", cwd=ws)
    assert (outcome.code, outcome.codes()[-1]) == (1, "authority-without-identifier")
    assert keymint("authority", "renew", IDENTITY, cwd=ws).code == 0
    for words in (BUNDLES, REISSUE, END):
        outcome = keymint("authority", "replace", IDENTITY, *words, cwd=ws)
        assert outcome.code == 0, outcome.err
        clean(keymint, ws)
    assert certificate(ws / CERTIFICATES[0]).subject == x509.load_pem_x509_certificate(pem).subject


def test_keys_with_a_password_keep_it(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("init", "ws", "--policy", policy).code == 0
    ws, known = tmp_path / "ws", {"CA_PASSWORD": "correct horse"}
    for path in AUTHORITY_KEYS:
        (ws / path).unlink()
    defaults = ws / "profile/profile.defaults/authorities.xml"
    text = defaults.read_text().replace("NoEncryption", "BestAvailableEncryption")
    defaults.write_text(text.replace("<password_env>", "<password_env>CA_PASSWORD"))
    for path in CERTIFICATES:
        (ws / path).unlink()
    assert keymint("provision", policy, "-w", "ws", env=known).code == 0
    for words in (BUNDLES, REISSUE, END):
        refused = keymint("authority", "replace", IDENTITY, *words, "--json", cwd=ws)
        assert (refused.code, set(refused.codes())) == (1, {"password-missing"})
        outcome = keymint("authority", "replace", IDENTITY, *words, cwd=ws, env=known)
        assert outcome.code == 0, outcome.err
        assert "correct horse" not in outcome.out + outcome.err
        for path in (ws / "private").glob("identity_ca*.key.pem"):
            assert path.read_bytes().startswith(b"-----BEGIN ENCRYPTED PRIVATE KEY-----")
        assert keymint("check", cwd=ws, env=known).code == 0


def test_the_next_authority_may_come_from_outside(keymint, ws: Path, replace: Callable) -> None:
    pem, key = outside(IDENTITY)
    (ws.parent / "next.pem").write_bytes(pem)
    (ws.parent / "next.key").write_bytes(key)
    replace(IDENTITY, "--certificate", "../next.pem", "--key", "../next.key")
    replace(IDENTITY, *END)
    assert (ws / CERTIFICATES[0]).read_bytes() == pem
    assert public_key(ws / AUTHORITY_KEYS[0]) == public_key(ws / CERTIFICATES[0])
    clean(keymint, ws)
