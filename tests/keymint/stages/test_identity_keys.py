# SPDX-License-Identifier: Apache-2.0
"""Private keys of subjects: minted once, restored from the enclave, never replaced without being asked."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from tests.keymint.stages.keystores import (
    AUTHORITY_KEYS,
    IDENTITY_KEYS,
    another_key,
    public_key,
)


def refused(keymint, ws: Path, authority: str) -> None:
    """Require that the key of an authority, put in the place of a subject's, is found without the record."""
    (ws / ".keymint/state.json").unlink()
    shutil.rmtree(ws / "install")
    outcome = keymint("install", cwd=ws)
    assert outcome.code == 1
    assert f"is the private key of the authority '{authority}'" in outcome.err
    assert not (ws / "install").exists()
    assert "key-of-authority" in keymint("check", "--json", cwd=ws).codes()


class TestIdentities:
    def test_an_authoritys_key_never_reaches_a_robot(self, keymint, ws: Path) -> None:
        shutil.copyfile(ws / AUTHORITY_KEYS[1], ws / IDENTITY_KEYS[0])
        refused(keymint, ws, "permissions_ca")

    @pytest.mark.parametrize(
        ("words", "file"), [((), "next"), (("--vendor", "fastdds"), "next"), (("--phase", "reissue"), "former")]
    )
    def test_nor_does_one_that_is_not_in_force(self, keymint, ws: Path, words: tuple[str, ...], file: str) -> None:
        replace = ("authority", "replace", "identity_ca")
        for phase in (("--vendor", "fastdds"), words) if file == "former" else (words,):
            assert keymint(*replace, *phase, cwd=ws).code == 0
        shutil.copyfile(ws / f"private/identity_ca.{file}.key.pem", ws / IDENTITY_KEYS[0])
        refused(keymint, ws, "identity_ca")

    def test_two_subjects_with_one_key(self, keymint, ws: Path) -> None:
        shutil.copyfile(ws / IDENTITY_KEYS[1], ws / IDENTITY_KEYS[0])
        (ws / ".keymint/state.json").unlink()
        for installed in (True, False):
            if not installed:
                shutil.rmtree(ws / "install")
            outcome = keymint("install", cwd=ws)
            assert outcome.code == 1
            assert "private/identities/" in outcome.err
            assert "key-shared" in keymint("check", "--json", cwd=ws).codes()

    def test_a_replaced_key_is_mended_by_either_hint(self, keymint, ws: Path) -> None:
        original = (ws / IDENTITY_KEYS[0]).read_bytes()
        another_key(ws, ws / IDENTITY_KEYS[0])
        outcome = keymint("install", cwd=ws)
        assert outcome.code == 1
        assert "is not the private key that /talker had: it was replaced" in outcome.err
        assert "'keymint build -f talker'" in outcome.err
        (ws / IDENTITY_KEYS[0]).unlink()
        assert keymint("build", "-f", "talker", cwd=ws).code == 0
        assert (ws / IDENTITY_KEYS[0]).read_bytes() == original
        assert (ws / IDENTITY_KEYS[0]).stat().st_mode & 0o777 == 0o600
        another_key(ws, ws / IDENTITY_KEYS[0])
        assert "'keymint build --rekey talker'" in keymint("check", cwd=ws).err
        assert keymint("build", "--rekey", "talker", cwd=ws).code == 0
        assert keymint("install", cwd=ws).code == 0
        assert keymint("check", cwd=ws).code == 0
        assert public_key(ws / IDENTITY_KEYS[0]) != load_pem_private_key(original, None).public_key()

    @pytest.mark.parametrize("words", [("build",), ("provision", "../policy.xml"), ("build", "talker")])
    def test_a_deleted_key_never_comes_back_by_itself(self, keymint, ws: Path, words: tuple[str, ...]) -> None:
        (ws / IDENTITY_KEYS[0]).unlink()
        outcome = keymint(*words, cwd=ws)
        assert (outcome.code, "private/identities/talker/key.pem: error" in outcome.err) == (1, True), outcome.err
        assert "'keymint build -f talker'" in outcome.err
        assert "'keymint build --rekey talker'" in outcome.err
        assert not (ws / IDENTITY_KEYS[0]).exists()
        (finding,) = (each for each in keymint("check", "--json", cwd=ws).document["diagnostics"])
        assert (finding["code"], finding["severity"]) == ("key-missing", "warning")

    @pytest.mark.parametrize("how", ["here", "gone", "another"])
    def test_a_missing_key_is_named_at_once_with_one_remedy(self, keymint, ws: Path, how: str) -> None:
        (ws / IDENTITY_KEYS[0]).unlink()
        own, other = (ws / f"install/enclaves/{name}/key.pem" for name in ("talker", "robot1/listener"))
        if how != "here":
            content = other.read_bytes()
            own.unlink()
            own.write_bytes(content) if how == "another" else None
            own.chmod(0o600) if how == "another" else None
        refused = keymint("install", "--json", cwd=ws)
        assert (refused.code, refused.codes()) == (1, ["key-missing"])
        found = [
            each for each in keymint("check", "--json", cwd=ws).document["diagnostics"] if each["severity"] != "note"
        ]
        assert {each["help"] for each in found} == {refused.document["diagnostics"][0]["help"]}, found
        assert ("'keymint build -f talker'" in found[0]["help"], "backup" in found[0]["help"]) == (
            how == "here",
            how != "here",
        )
        assert keymint("build", *(("-f", "talker") if how == "here" else ("--rekey", "talker")), cwd=ws).code == 0
        assert keymint("install", cwd=ws).code == 0
        assert keymint("check", cwd=ws).code == 0

    def test_a_copy_without_private_files_is_checked_without_findings(self, keymint, ws: Path) -> None:
        shutil.rmtree(ws / "private")
        outcome = keymint("check", cwd=ws)
        assert (outcome.code, "no findings" in outcome.out) == (0, True), outcome.err

    def test_a_key_that_is_nowhere_is_not_minted_without_being_asked(self, keymint, ws: Path) -> None:
        (ws / IDENTITY_KEYS[0]).unlink()
        (ws / "install/enclaves/talker/key.pem").unlink()
        outcome = keymint("build", cwd=ws)
        assert outcome.code == 1
        assert "the private key of /talker is missing" in outcome.err
        assert keymint("build", "--rekey", "talker", cwd=ws).code == 0
        assert keymint("install", cwd=ws).code == 0


class TestKeys:
    def test_are_kept(self, keymint, created: Path) -> None:
        keymint("build", cwd=created)
        key = (created / "private/identities/talker/key.pem").read_bytes()
        keymint("build", "-f", cwd=created)
        assert (created / "private/identities/talker/key.pem").read_bytes() == key

    def test_are_replaced_on_request(self, keymint, created: Path) -> None:
        keymint("build", cwd=created)
        key = (created / "private/identities/talker/key.pem").read_bytes()
        other = (created / "private/identities/robot1/listener/key.pem").read_bytes()
        assert keymint("build", "--rekey", "talker", cwd=created).code == 0
        assert (created / "private/identities/talker/key.pem").read_bytes() != key
        assert (created / "private/identities/robot1/listener/key.pem").read_bytes() == other

    def test_of_another_kind_than_asked_for_are_refused(self, keymint, created: Path) -> None:
        keymint("build", cwd=created)
        path = created / "profile/package.defaults/identities.xml"
        text = path.read_text()
        assert "SECP256R1" in text
        path.write_text(
            text.replace("<ec>", "<rsa>")
            .replace("</ec>", "</rsa>")
            .replace("<curve>SECP256R1</curve>", "<key_size>2048</key_size>")
        )
        outcome = keymint("build", cwd=created)
        assert outcome.code == 1
        assert "private/identities/talker/key.pem: error: is not an RSA key of 2048 bits" in outcome.err
        assert keymint("build", "--rekey", "--yes", "*", cwd=created).code == 0

    def test_that_are_damaged_are_said_to_be_without_being_shown(self, keymint, created: Path) -> None:
        keymint("build", cwd=created)
        path = created / "private/identities/talker/key.pem"
        content = path.read_text()
        path.write_text(content.replace("-----BEGIN", "----BEGIN"))
        (created / ".keymint/state.json").unlink()
        outcome = keymint("build", cwd=created)
        assert outcome.code == 1
        assert "private/identities/talker/key.pem" in outcome.err
        assert content.splitlines()[1] not in outcome.err
