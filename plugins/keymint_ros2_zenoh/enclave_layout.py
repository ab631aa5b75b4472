# SPDX-License-Identifier: Apache-2.0
"""The files of a keystore for Zenoh, those of an enclave and those of the router, and the variables that name them.

``rmw_zenoh`` finds configurations by environment variables (its README, "Configuration"). A session also needs the name
of its enclave, which ``ros2 run … --ros-args --enclave …`` gives, and no variable.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from keymint.api import EnvironmentVariable, Layout

ENCLAVES = "enclaves"
LAYOUTS: Mapping[str, Layout] = {"sros2": Layout(ENCLAVES)}
"""The layout that build types have in common from Foxy on. Ardent's has no place for an enclave's own files."""
READS = (".pem", ".json5")
"""Suffixes of the files that a session or router reads from an enclave."""
CERTIFICATE, KEY, IDENTITY_CA = "cert.pem", "key.pem", "identity_ca.cert.pem"
SESSION = "session.json5"
ROUTER = "zenoh/router.json5"
"""The router's configuration, relative to the install space: the rights of all enclaves."""
SIGNATURE = f"{ROUTER}.p7s"
"""The detached signature over it: CMS in DER. Zenoh does not look at it, ``keymint check`` does."""


def files(layout: str) -> frozenset[str]:
    """Return the names of all files that may lie in an enclave; see :meth:`keymint.api.BuildType.files`."""
    return frozenset((CERTIFICATE, KEY, IDENTITY_CA, SESSION)) if layout in LAYOUTS else frozenset()


def enclave_folder(keystore: str, subject: str) -> str:
    """Return the folder of an enclave in a keystore; that of the root enclave ``/`` contains all others."""
    return f"{keystore}/{ENCLAVES}{subject.rstrip('/')}"


def keystore_variables(distro: str, layout: str) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.BuildType.keystore_variables`: the router's configuration; nodes ignore it."""
    del distro, layout
    return (EnvironmentVariable("ZENOH_ROUTER_CONFIG_URI", ROUTER, is_path=True),)


def enclave_variables(
    distro: str, layout: str, subject: str, files: Collection[str]
) -> tuple[EnvironmentVariable, ...]:
    """See :meth:`keymint.api.BuildType.enclave_variables`; the enclave of a router has no session."""
    if SESSION not in files:
        return keystore_variables(distro, layout)
    return (EnvironmentVariable("ZENOH_SESSION_CONFIG_URI", f"{ENCLAVES}{subject}/{SESSION}", is_path=True),)
