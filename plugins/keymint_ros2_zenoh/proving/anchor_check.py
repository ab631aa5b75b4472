# SPDX-License-Identifier: Apache-2.0
"""What an enclave rests on: its certificates, and the router's file that the workspace's authority signed.

An enclave cannot vouch for itself, and no session or router looks at the signature. So both are compared with the
authorities of the workspace.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from comarmor.errors import Diagnostic, Origin
from keymint.api import TrustAnchor, TrustAnchors, ValidityTerm
from keymint.pki import certificates
from keymint.pki.identity_check import IdentityCheck, anchor_defects, certificate_terms
from keymint_ros2_zenoh import signature
from keymint_ros2_zenoh.authority_roles import ACCESS, IDENTITY
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SIGNATURE

_INSTALL = "'keymint install' restores it"


def differences(
    files: Mapping[str, bytes], folder: str, anchors: TrustAnchors, shared: Mapping[str, bytes], shared_folder: str
) -> tuple[Diagnostic, ...]:
    """Return what the workspace's authorities do not vouch for; see :meth:`keymint.api.Prover.differences`."""
    identity, access = anchors.authorities[IDENTITY], anchors.authorities[ACCESS]
    if missing := tuple(anchor_defects((identity, access))):
        return missing
    rules = IdentityCheck(files, folder, _INSTALL)
    needed = (CERTIFICATE, IDENTITY_CA) if anchors.public_key else (CERTIFICATE, KEY, IDENTITY_CA)
    own = (*rules.inventory(needed), *rules.anchored(IDENTITY_CA, identity), *rules.identity(identity.chain, anchors))
    # An encrypted key cannot be read without its password.
    readable = (each for each in own if each.code != "key-password")
    return (*readable, *router_differences(shared, shared_folder, access))


def router_differences(shared: Mapping[str, bytes], shared_folder: str, access: TrustAnchor) -> tuple[Diagnostic, ...]:
    """Return why the router's file is not what the authority that signs the rights signed.

    Args:
        shared: installed shared files by path.
        shared_folder: the folder of these paths, as the user would type it.
        access: the authority.
    """
    if absent := tuple(IdentityCheck(shared, shared_folder, _INSTALL).inventory((ROUTER, SIGNATURE))):
        return absent
    problem = _signature_problem(shared[ROUTER], shared[SIGNATURE], access.chain)
    if not problem:
        return ()
    help_ = "find out who wrote it before 'keymint install' signs the file that the sources build"
    return (Diagnostic.error("zenoh-signature", problem, Origin(f"{shared_folder}/{SIGNATURE}"), help_),)


# All enclaves rest on the same file.
@lru_cache(maxsize=16)
def _signature_problem(content: bytes, signed: bytes, authority: bytes) -> str:
    return signature.problem(content, signed, certificates.load_first(authority, with_lists=True))


def terms(
    files: Mapping[str, bytes], folder: str, anchors: TrustAnchors, shared: Mapping[str, bytes], shared_folder: str
) -> tuple[ValidityTerm, ...]:
    """Return the periods of the certificates of an enclave; see :meth:`keymint.api.Prover.terms`.

    Rights have no dates: they end with the certificate.

    Raises:
        KeymintError: a file is missing, or is no certificate.
    """
    del anchors, shared, shared_folder
    return tuple(certificate_terms(files, folder, (CERTIFICATE, IDENTITY_CA)))
