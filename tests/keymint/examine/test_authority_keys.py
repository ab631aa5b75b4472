# SPDX-License-Identifier: Apache-2.0
"""Private keys of authorities: stored as the profile asks, and where they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from tests.conftest import snapshot

NAMES = ("identity_ca", "permissions_ca")
PASSWORD = {"CA_PASSWORD": "correct horse"}


@pytest.fixture
def asked(provisioned: Path) -> Path:
    """A workspace with plain keys, whose profile asks for encrypted ones since."""
    ask(provisioned)
    return provisioned


def ask(ws: Path) -> None:
    defaults = ws / "profile/profile.defaults/authorities.xml"
    text = defaults.read_text().replace("NoEncryption", "BestAvailableEncryption")
    defaults.write_text(text.replace("<password_env>", "<password_env>CA_PASSWORD"))


def key(ws: Path, name: str) -> Path:
    return ws / f"private/{name}.key.pem"


def found(outcome) -> list[tuple[str, str, str]]:
    return [(each["severity"], each["code"], each["file"]) for each in outcome.document["diagnostics"]]


class TestEncryption:
    """What the profile asks for, and what is stored."""

    @pytest.mark.parametrize("env", [{}, PASSWORD], ids=["no password", "password"])
    def test_check_names_plain_keys_that_the_profile_wants_encrypted(self, keymint, asked: Path, env) -> None:
        outcome = keymint("check", "--json", cwd=asked, env=env)
        assert outcome.code == 3
        assert found(outcome) == [("warning", "key-plain", f"private/{name}.key.pem") for name in NAMES]
        assert all("backups still hold the plain key" in each["help"] for each in outcome.document["diagnostics"])

    def test_nothing_else_encrypts_a_key(self, keymint, asked: Path) -> None:
        before = [key(asked, name).read_bytes() for name in NAMES]
        renewed = ("authority", "renew", NAMES[1], "--flag-day")
        for words in (("provision", "../policy.xml"), ("renew", "--rekey", "talker"), renewed):
            assert keymint(*words, cwd=asked, env=PASSWORD).code == 0, words
        assert [key(asked, name).read_bytes() for name in NAMES] == before

    def test_the_verb_encrypts_the_same_key(self, keymint, asked: Path) -> None:
        before = {path: content for path, content in snapshot(asked).items() if not path.startswith(".keymint")}
        plain = load_pem_private_key(key(asked, NAMES[0]).read_bytes(), None)
        outcome = keymint("authority", "encrypt", NAMES[0], "--json", cwd=asked, env=PASSWORD)
        assert (outcome.code, outcome.codes()) == (0, ["key-copies"])
        stored = key(asked, NAMES[0]).read_bytes()
        assert stored.startswith(b"-----BEGIN ENCRYPTED PRIVATE KEY-----")
        encrypted = load_pem_private_key(stored, b"correct horse")
        assert encrypted.private_numbers() == plain.private_numbers()
        assert key(asked, NAMES[0]).stat().st_mode & 0o777 == 0o600
        after = {path: content for path, content in snapshot(asked).items() if not path.startswith(".keymint")}
        changed = {path for path in before.keys() | after.keys() if before.get(path) != after.get(path)}
        assert changed <= {"private", f"private/{NAMES[0]}.key.pem", "private/runs.jsonl"}
        assert found(keymint("check", "--json", cwd=asked, env=PASSWORD)) == [
            ("warning", "key-plain", f"private/{NAMES[1]}.key.pem")
        ]
        again = keymint("authority", "encrypt", NAMES[0], "--json", cwd=asked, env=PASSWORD)
        assert (again.code, again.codes()) == (0, [])
        assert key(asked, NAMES[0]).read_bytes() == stored

    def test_then_everything_works_with_the_password_and_reading_without(self, keymint, asked: Path) -> None:
        for name in NAMES:
            assert keymint("authority", "encrypt", name, cwd=asked, env=PASSWORD).code == 0
        assert keymint("build", "--rekey", "--yes", "*", cwd=asked).code == 0
        refused = keymint("install", "--json", cwd=asked)
        assert (refused.code, set(refused.codes())) == (1, {"password-missing"})
        assert keymint("install", cwd=asked, env=PASSWORD).code == 0
        for words in (("check",), ("prove",), ("status",), ("authority", "show"), ("verify", "-i", "omg")):
            outcome = keymint(*words, "--json", cwd=asked)
            assert outcome.code == 0, (words, outcome.out)
        assert keymint("check", "--json", cwd=asked, env=PASSWORD).codes() == []

    def test_a_dry_run_writes_nothing(self, keymint, asked: Path) -> None:
        before = snapshot(asked)
        outcome = keymint("authority", "encrypt", NAMES[0], "--dry-run", cwd=asked, env=PASSWORD)
        assert (outcome.code, snapshot(asked)) == (0, before)
        assert "1 updated" in outcome.out

    def test_both_keys_while_one_is_replaced(self, keymint, provisioned: Path) -> None:
        asked = provisioned
        assert keymint("authority", "replace", NAMES[0], cwd=asked).code == 0
        ask(asked)
        both = [f"private/{NAMES[0]}{suffix}.key.pem" for suffix in ("", ".next")]
        assert [file for *_, file in found(keymint("check", "--json", cwd=asked, env=PASSWORD))][:2] == both
        assert keymint("authority", "encrypt", NAMES[0], cwd=asked, env=PASSWORD).code == 0
        assert all(b"BEGIN ENCRYPTED" in (asked / path).read_bytes() for path in both)
        assert keymint("authority", "replace", NAMES[0], "--phase", "end", cwd=asked, env=PASSWORD).code == 0

    def test_without_the_password(self, keymint, asked: Path) -> None:
        before = key(asked, NAMES[0]).read_bytes()
        outcome = keymint("authority", "encrypt", NAMES[0], "--json", cwd=asked)
        assert (outcome.code, outcome.codes()) == (1, ["password-missing"])
        assert key(asked, NAMES[0]).read_bytes() == before

    @pytest.mark.parametrize("name", NAMES)
    def test_a_profile_that_does_not_ask(self, keymint, provisioned: Path, name: str) -> None:
        outcome = keymint("authority", "encrypt", name, "--json", cwd=provisioned, env=PASSWORD)
        assert (outcome.code, outcome.codes()) == (1, ["encryption-unasked"])
        assert outcome.document["diagnostics"][0]["line"]

    def test_a_key_elsewhere(self, keymint, asked: Path) -> None:
        key(asked, NAMES[0]).unlink()
        outcome = keymint("authority", "encrypt", NAMES[0], "--json", cwd=asked, env=PASSWORD)
        assert (outcome.code, outcome.codes()) == (1, ["authority-key-missing"])

    def test_no_authority(self, keymint, asked: Path) -> None:
        assert keymint("authority", "encrypt", "identity", cwd=asked).code == 2


class TestIdentities:
    """Keys in install/ are never encrypted: no ROS 2 distribution passes a password to a node."""

    @pytest.fixture
    def locked(self, provisioned: Path) -> Path:
        defaults = provisioned / "profile/package.defaults/identities.xml"
        text = defaults.read_text().replace("NoEncryption", "BestAvailableEncryption")
        defaults.write_text(text.replace("<password_env>", "<password_env>ID_PASSWORD"))
        return provisioned

    @pytest.mark.parametrize(
        "words",
        [("build",), ("build", "--rekey", "--yes", "*"), ("install",), ("check",), ("provision", "../policy.xml")],
    )
    def test_asking_for_it_is_an_error(self, keymint, locked: Path, words: tuple[str, ...]) -> None:
        before = (locked / "install/enclaves/talker/key.pem").read_bytes()
        outcome = keymint(*words, "--json", cwd=locked, env={"ID_PASSWORD": "secret"})
        assert outcome.code == (3 if words == ("check",) else 1)
        assert set(outcome.codes()) == {"identity-encrypted"}
        place = outcome.document["diagnostics"][0]
        assert place["file"] == "profile/package.defaults/identities.xml"
        assert "no ROS 2 distribution" in place["message"]
        assert (locked / "install/enclaves/talker/key.pem").read_bytes() == before

    def test_a_new_package(self, keymint, locked: Path) -> None:
        (locked / "private/identities/talker/key.pem").unlink()
        (locked / "install/enclaves/talker/key.pem").unlink()
        assert keymint("build", "talker", "--json", cwd=locked).codes() == ["identity-encrypted"]

    def test_a_key_that_is_encrypted(self, keymint: Callable, provisioned: Path) -> None:
        """The advice is followed: a new key."""
        from keymint.pki import keys

        path = provisioned / "private/identities/talker/key.pem"
        encrypted = keys.to_pem(keys.from_pem(path.read_bytes()), b"secret")
        for each in (path, provisioned / "install/enclaves/talker/key.pem"):
            each.write_bytes(encrypted)
        outcome = keymint("check", "--json", cwd=provisioned)
        assert ("identity-encrypted", str(path.relative_to(provisioned))) in [
            (each["code"], each["file"]) for each in outcome.document["diagnostics"]
        ]
        assert any("'keymint build --rekey talker'" in each["help"] for each in outcome.document["diagnostics"])
        assert keymint("build", "--rekey", "talker", cwd=provisioned).code == 0
        assert keymint("install", cwd=provisioned).code == 0
        assert keymint("check", cwd=provisioned).code == 0


class TestElsewhere:
    """The private key of an authority may be on another machine, or lost: a note."""

    @pytest.mark.parametrize("verb", ["check", "status"])
    def test_a_note(self, keymint, provisioned: Path, verb: str) -> None:
        assert keymint(verb, "--json", cwd=provisioned).codes() == []
        key(provisioned, NAMES[0]).unlink()
        outcome = keymint(verb, "--json", cwd=provisioned)
        assert outcome.code == 0
        assert found(outcome) == [("note", "authority-key-missing", f"public/{NAMES[0]}.cert.pem")]

    def test_status_shows_it_without_being_asked(self, keymint, provisioned: Path) -> None:
        key(provisioned, NAMES[0]).unlink()
        assert "note: the private key of 'identity_ca' is not here" in keymint("status", cwd=provisioned).err
