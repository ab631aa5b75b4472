# SPDX-License-Identifier: Apache-2.0
"""Stored private keys: their passwords, and who signs."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest


class TestAuthorities:
    """Other authorities than the default ones."""

    def profile(self, ws: Path, authorities: str) -> None:
        (ws / "profile/authorities.xml").write_text(
            f"<?xml version='1.0'?>\n<profile>\n<authorities>\n{authorities}\n</authorities>\n</profile>\n"
        )

    @pytest.fixture
    def ws(self, keymint, policy: Path, tmp_path: Path) -> Path:
        assert keymint("init", "ws", "--policy", policy).code == 0
        return tmp_path / "ws"

    def stages(self, keymint, ws: Path, env=None):
        for arguments in (("create", "--all"), ("build",)):
            assert keymint(*arguments, cwd=ws, env=env).code == 0
        return keymint("install", cwd=ws, env=env)

    def test_an_encrypted_key_takes_its_password_from_the_environment(self, keymint, ws: Path) -> None:
        for path in [*(ws / "private").glob("*.pem"), *(ws / "public").glob("*.pem")]:
            path.unlink()
        defaults = ws / "profile/profile.defaults/authorities.xml"
        text = defaults.read_text()
        assert "<encryption_algorithm>NoEncryption</encryption_algorithm>" in text
        encrypted = (
            text.replace("NoEncryption", "BestAvailableEncryption")
            .replace("<password_env></password_env>", "<password_env>CA_PASSWORD</password_env>")
            .replace("<password_env/>", "<password_env>CA_PASSWORD</password_env>")
        )
        if "CA_PASSWORD" not in encrypted:
            encrypted = encrypted.replace(
                "</encryption_algorithm>", "</encryption_algorithm>\n    <password_env>CA_PASSWORD</password_env>"
            )
        defaults.write_text(encrypted)
        for arguments in (("create", "--all"), ("build",)):
            assert keymint(*arguments, cwd=ws).code == 0
        outcome = keymint("install", cwd=ws)
        assert outcome.code == 1
        assert "the environment variable CA_PASSWORD, which holds the key's password, is not set" in outcome.err
        assert keymint("install", cwd=ws, env={"CA_PASSWORD": "correct horse"}).code == 0
        assert b"ENCRYPTED" in (ws / "private/identity_ca.key.pem").read_bytes()
        assert keymint("install", cwd=ws).code == 0  # nothing is to be signed, so no password is needed
        wrong = keymint("build", "-f", cwd=ws, env={"CA_PASSWORD": "battery staple"})
        assert wrong.code == 0  # building needs no authority
        wrong = keymint("install", cwd=ws, env={"CA_PASSWORD": "battery staple"})
        assert wrong.code == 1
        assert "battery" not in wrong.err + wrong.out
        assert "private/identity_ca.key.pem" in wrong.err

    def test_what_one_vendor_refuses_of_it_is_said_once(self, keymint, ws: Path) -> None:
        """Measured with participants: an intermediate authority, its key, and the hash of the identity."""
        self.profile(
            ws,
            '<authority name="root"><cert><serial_number/><issuer_name/></cert></authority>'
            '<authority name="identity_ca"><cert><serial_number/><issuer_name>root</issuer_name></cert></authority>'
            '<authority name="permissions_ca"><cert><serial_number/><issuer_name/></cert></authority>',
        )
        for file in ("profile.defaults/authorities.xml", "package.defaults/identities.xml"):
            path = ws / "profile" / file
            text = path.read_text()
            path.write_text(
                text.replace("SECP256R1", "SECP384R1") if "authorities" in file else text.replace("SHA256", "SHA384")
            )
        for path in (ws / "private").glob("*.key.pem"):
            path.unlink()
            (ws / "public" / path.name.replace(".key.", ".cert.")).unlink()
        assert keymint("create", "--all", cwd=ws).code == 0
        outcome = keymint("build", "--json", cwd=ws)
        assert outcome.code == 0
        codes = sorted(code for code in outcome.codes() if code.startswith("portability"))
        # The hash is reported at each package's identity, the authorities once for all packages.
        assert codes.count("portability-chain") == 1
        assert codes.count("portability-authority-key") == 2
        assert "portability-hash" in codes
        assert all(found["severity"] == "warning" for found in outcome.document["diagnostics"])

    def test_a_hierarchy_verifies_up_to_its_root(self, keymint, ws: Path) -> None:
        self.profile(
            ws,
            '<authority name="root"><cert><serial_number/><issuer_name/></cert></authority>'
            '<authority name="identity_ca"><cert><serial_number/><issuer_name>root</issuer_name></cert></authority>'
            '<authority name="permissions_ca"><cert><serial_number/><issuer_name/></cert></authority>',
        )
        outcome = self.stages(keymint, ws)
        assert outcome.code == 0, outcome.err
        enclave = ws / "install/enclaves/talker"
        done = subprocess.run(
            [
                "openssl",
                "verify",
                "-attime",
                "1800000000",
                "-x509_strict",
                "-CAfile",
                ws / "public/root.cert.pem",
                "-untrusted",
                enclave / "identity_ca.cert.pem",
                enclave / "cert.pem",
            ],
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        outcome = keymint("check", cwd=ws)
        assert "error" not in outcome.err
