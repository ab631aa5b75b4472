# SPDX-License-Identifier: Apache-2.0
"""A PKCS #11 token in software (SoftHSM 2), in a folder of its own."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

MODULE = "/usr/lib/softhsm/libsofthsm2.so"
PIN, ADMINISTRATOR_PIN = "4711-pin", "so-4711-pin"
KINDS = {"P-256": "EC:prime256v1", "P-384": "EC:secp384r1", "RSA": "rsa:2048"}


@dataclass(frozen=True)
class SoftHsm:
    """A token.

    Attributes:
        folder: has the configuration of SoftHSM and its tokens.
        label: label of the token.
    """

    folder: Path
    label: str = "ca"

    @property
    def environment(self) -> Mapping[str, str]:
        """The variables with which modules find the token; OpenSC's tools would otherwise complain about their own."""
        return {"SOFTHSM2_CONF": str(self.folder / "softhsm2.conf")}

    def run(self, *command: str | Path) -> str:
        environment = {**os.environ, **self.environment}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout

    def tool(self, *arguments: str | Path, token: str = "") -> str:
        """Run OpenSC's tool as the user of the token."""
        log_in = ("--module", MODULE, "--token-label", token or self.label, "--login", "--pin", PIN)
        return self.run("pkcs11-tool", *log_in, *arguments)

    def another(self, label: str) -> SoftHsm:
        """Make one more token beside this one."""
        pins = ("--pin", PIN, "--so-pin", ADMINISTRATOR_PIN)
        self.run("softhsm2-util", "--init-token", "--free", "--label", label, *pins)
        return SoftHsm(self.folder, label)

    def make_key(self, label: str, number: str = "01", kind: str = "P-256") -> str:
        """Make a key pair in the token, and return the URI of its private key."""
        self.tool("--keypairgen", "--key-type", KINDS[kind], "--label", label, "--id", number)
        return f"pkcs11:token={self.label};object={label}"

    def import_key(self, pem: Path, label: str, number: str = "01") -> str:
        """Put the private key of a file into the token, and return its URI."""
        keyed = ("--import", pem, "--token", self.label, "--label", label, "--id", number)
        self.run("softhsm2-util", *keyed, "--pin", PIN)
        return f"pkcs11:token={self.label};object={label}"

    def delete(self, label: str, kind: str = "privkey") -> None:
        """Delete an object of the token."""
        self.tool("--delete-object", "--type", kind, "--label", label)


def opened(folder: Path, label: str = "ca") -> SoftHsm:
    """Make a token in a new folder; skip the test, or fail it in CI, if the software for it is missing."""
    missing = [program for program in ("softhsm2-util", "pkcs11-tool") if shutil.which(program) is None]
    missing += [] if importlib.util.find_spec("pkcs11") else ["python-pkcs11"]
    if missing:
        reason = f"{', '.join(missing)} is missing: .ci/setup-vendors.sh, and pip install '.[pkcs11]'"
        if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
            pytest.fail(f"KEYMINT_REQUIRE_VENDORS=1, but {reason}", pytrace=False)
        pytest.skip(reason)
    (folder / "tokens").mkdir(parents=True)
    (folder / "softhsm2.conf").write_text(f"directories.tokendir = {folder}/tokens\nlog.level = ERROR\n")
    return SoftHsm(folder).another(label)
