# SPDX-License-Identifier: Apache-2.0
"""Install spaces as Keymint makes them, with further certificates of their authority."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from keymint_ros2_zenoh.documents import json5

from keymint.api import InstalledEnclave
from tests.plugins.keymint_ros2_zenoh.install_spaces import InstallSpace

from .provisioning import provision

_PROFILE = """<profile name="{name}"><attachment>/{name}</attachment>{rules}</profile>"""
_RULE = """<ros_topic qualifier="ALLOW"><attachment>/{topic}</attachment>
<permissions><ros_{permission}/></permissions></ros_topic>"""


def policy(**subjects: list[tuple[str, str]]) -> str:
    """Return a policy; each subject has a list of permissions and names of topics."""
    profiles = "".join(
        _PROFILE.format(name=name, rules="".join(_RULE.format(permission=each, topic=topic) for each, topic in rules))
        for name, rules in subjects.items()
    )
    return f"<profiles>{profiles}</profiles>"


def compiled(source: str, folder: Path) -> Path:
    """Provision a policy for Zenoh in an empty folder and return the workspace."""
    return provision(source, folder, "--transport", "zenoh").parent


class CompiledSpace(InstallSpace):
    """A copy of the install space of a workspace.

    Args:
        workspace: the workspace.
        folder: the copy, which does not exist yet.
    """

    def __init__(self, workspace: Path, folder: Path) -> None:
        super().__init__(folder, {})
        shutil.copytree(workspace / "install", folder)
        key = (workspace / "private/identity_ca.key.pem").read_bytes()
        self.authority_key = serialization.load_pem_private_key(key, None)  # type: ignore[assignment]
        self._certificate = x509.load_pem_x509_certificate((workspace / "public/identity_ca.cert.pem").read_bytes())
        self._name = self._certificate.subject

    def write(self) -> list[InstalledEnclave]:
        """Issue the certificates that live shorter; all other files are there."""
        for subject, seconds in self.lives.items():
            self.enclave(subject[1:], subject, seconds=seconds)
        return []

    def router(self) -> dict[str, Any]:
        """Return the installed configuration of the router."""
        return _read(self.folder / "zenoh/router.json5")

    def installed_session(self, folder: Path) -> dict[str, Any]:
        """Return the configuration that is installed in the folder of an enclave."""
        return _read(folder / "session.json5")


def _read(file: Path) -> dict[str, Any]:
    document: dict[str, Any] = json5.parse(file.read_bytes(), str(file))[0]
    return document
