# SPDX-License-Identifier: Apache-2.0
"""Identities whose private key lies in a token of the robot, which ``key.p11`` names: who can use them.

Fast DDS loads such keys with the engine ``pkcs11`` of OpenSSL. Cyclone DDS 0.10 refuses them, and rmw_cyclonedds never
asks for ``key.p11``, so it would start without a key.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic, Severity
from keymint.api import Package
from keymint_ros2_dds.enclave_layout import KEY, KEY_URI, READS_KEY_URI
from keymint_ros2_dds.settings import settings_of

ACCEPT = "<accept><token_keys/></accept> in profile/keymint_profile.xml"


def check(package: Package, *, allow_vendor_specific: bool) -> Iterator[Diagnostic]:
    """Yield what hinders participants from using the key of a package, if it lies in a token.

    Args:
        package: the package.
        allow_vendor_specific: this build accepts differences between vendors.
    """
    spec = package.identity
    if not spec.key.uri:
        return
    if package.distro not in READS_KEY_URI:
        yield Diagnostic.error(
            "key-token-distro",
            f"the key of the identity lies in a token, but ROS 2 {package.distro} reads keys from files only",
            spec.origin, f"leave out <pkcs11>, or use {READS_KEY_URI[0]} or later", package.subject,
        )  # fmt: skip
        return
    from keymint.pki.tokens.pkcs11_uri import parse  # noqa: PLC0415 - few packages need it

    if parse(spec.key.uri, spec.origin).module_path:
        yield Diagnostic.error(
            "key-token-module",
            "the URI of the key names a module, but Fast DDS finds modules through p11-kit",
            spec.origin, "leave out module-path; put the module into /etc/pkcs11/modules on the robot", package.subject,
        )  # fmt: skip
    accepted = settings_of(package).accepts_token_keys
    severity = Severity.NOTE if accepted else Severity.WARNING if allow_vendor_specific else Severity.ERROR
    yield Diagnostic(
        "portability-key-token", severity,
        f"the key of the identity lies in a token; only Fast DDS reads {KEY_URI}, through rmw_fastrtps: with Cyclone "
        f"DDS the node finds no {KEY} and does not start",
        spec.origin,
        "the profile accepts it" if accepted else f"leave out <pkcs11>; or, where only Fast DDS runs, write {ACCEPT}",
        package.subject,
    )  # fmt: skip


def is_uri(content: bytes | None, uri: str) -> bool:
    """Tell whether a file ``key.p11`` has this URI, as ROS 2 reads it: the first word counts."""
    return bool(uri) and content == f"{uri}\n".encode()
