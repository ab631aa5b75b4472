# SPDX-License-Identifier: Apache-2.0
"""The installed files of Zenoh: the router's configuration, and that of each enclave's session.

Configurations name certificates and keys by absolute paths on the robot. Here they are looked for in the install space
or its copy: at the longest end of the path that exists there. So a configuration that names the files of another
enclave, or none, is read as it stands.
"""

from __future__ import annotations

import hashlib
from pathlib import Path, PurePosixPath

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import Enclave, Environment
from keymint.api.transports import installed_file
from keymint.errors import KeymintError
from keymint.pki import certificates
from keymint_ros2_zenoh.decision import admission
from keymint_ros2_zenoh.decision.message_access import AccessModel
from keymint_ros2_zenoh.documents import configuration_reader as documents
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.enclave_layout import ROUTER
from keymint_ros2_zenoh.keyexpr.key_expr import ANY_CHARACTERS, ANY_CHUNKS
from keymint_ros2_zenoh.lowering.name_keys import TYPE_AND_HASH


@dataclass(frozen=True, slots=True)
class InstalledConfiguration:
    """An installed configuration and its certificates.

    Attributes:
        file: its absolute path.
        install: the install space that it belongs to.
        configuration: what it says.
        access: the decisions of its access control.
    """

    file: Path
    install: Path
    configuration: Configuration
    access: AccessModel

    def local(self, path: str) -> Path | None:
        """Return where a file that the configuration names is in this install space; None if it is not there."""
        names = PurePosixPath(path).parts[1:]
        candidates = (self.install.joinpath(*names[start:]) for start in range(len(names)))
        return next((each for each in candidates if each.is_file()), None)

    def content(self, path: str) -> bytes:
        """Return a file that the configuration names.

        Raises:
            KeymintError: it is not in the install space, or cannot be read.
        """
        return installed_file(self._there(path))

    def _there(self, path: str) -> Path:
        found = self.local(path)
        if found is not None:
            return found
        missing = "does not name the certificates and keys that it needs"
        if path:
            missing = f"names {path!r}, which is not in the install space"
        where, help_ = Origin(str(self.file)), "run 'keymint install'"
        raise KeymintError(f"{self.file.name} {missing}", where=where, help=help_, code="enclave-file")

    def common_name(self, path: str) -> str:
        """Return the common name by which the other side knows a certificate that the configuration names.

        Raises:
            KeymintError: it cannot be read.
        """
        found = self._there(path)
        return admission.common_name(certificates.load_bundle(installed_file(found), Origin(str(found)))[0])


def configuration(file: Path, install: Path, environment: Environment) -> InstalledConfiguration:
    """Return the configuration of a session, or of the router; one that was read before in this run is not read again.

    Args:
        file: its absolute path.
        install: the install space that it belongs to.
        environment: what was read before.

    Raises:
        KeymintError: it cannot be read, or Zenoh would refuse it.
    """
    content = installed_file(file)
    digest = hashlib.sha256(f"zenoh {file}\n".encode() + content).digest()
    found = environment.opened.get(digest)
    if not isinstance(found, InstalledConfiguration):
        read = documents.read(content, str(file))
        access = AccessModel(read.access_control)
        found = environment.opened[digest] = InstalledConfiguration(file, install, read, access)
    return found


def installed_names(enclave: Enclave) -> tuple[str, ...]:
    """Return expressions of names like those in the router's rights; see :class:`keymint.api.InstalledNames`."""
    try:
        content = installed_file(enclave.install / ROUTER)
        rules = documents.read(content, ROUTER).access_control.rules
    except KeymintError:
        return ()
    return tuple(dict.fromkeys(_name(key) for rule in rules for key in rule.key_exprs if "@" not in key))


def _name(key: str) -> str:
    """Return an expression of the names in the keys that a key expression includes, or of all names."""
    _, *name = key.replace(ANY_CHUNKS, "*").replace(ANY_CHARACTERS, "*").split("/")
    if ANY_CHUNKS in key.split("/")[-len(TYPE_AND_HASH) :]:
        return f"/{'/'.join(name).rstrip('/*')}*"
    return f"/{'/'.join(name[: -len(TYPE_AND_HASH)])}"
