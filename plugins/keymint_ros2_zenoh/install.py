# SPDX-License-Identifier: Apache-2.0
"""The install stage: the files of an enclave, and the router's signed configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from keymint.api import Artifact, Credentials, Package
from keymint.errors import KeymintError, Origin
from keymint.pki import cms, smime
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SESSION, SIGNATURE
from keymint_ros2_zenoh.examine.enclaves import signature_problem
from keymint_ros2_zenoh.settings import ACCESS, IDENTITY, is_router


def install(
    package: Package,
    documents: Mapping[str, bytes],
    credentials: Credentials,
    layout: str,  # noqa: ARG001 - it has one
    installed: Mapping[str, bytes],  # noqa: ARG001 - nothing in an enclave is signed
) -> Mapping[str, Artifact]:
    """Return the files of an enclave by name; see :meth:`keymint.api.BuildType.install`.

    Raises:
        KeymintError: the session's configuration is missing or not valid.
    """
    files = {
        IDENTITY_CA: Artifact(credentials.chains[IDENTITY]),
        CERTIFICATE: Artifact(credentials.certificate),
    }
    if credentials.key:
        files[KEY] = Artifact(credentials.key, secret=True)
    if not is_router(package):
        content = _document(documents.get(SESSION), f"{package.name}/{SESSION}", f"keymint build {package.name}")
        files[SESSION] = Artifact(content)
    return files


def install_shared(
    packages: Sequence[Package],  # noqa: ARG001 - an interface
    documents: Mapping[str, bytes],
    credentials: Credentials,
    layout: str,  # noqa: ARG001 - it has one
    installed: Mapping[str, bytes],
) -> Mapping[str, Artifact]:
    """Return the router's configuration and its signature; see :meth:`keymint.api.BuildType.install_shared`.

    Raises:
        KeymintError: the configuration is missing or not valid.
    """
    content = _document(documents.get(ROUTER), ROUTER, "keymint build")
    present = installed.get(SIGNATURE)
    if present is None or signature_problem(content, present, credentials.chains[ACCESS]):
        signer = smime.load_signer(credentials.signers[ACCESS])
        present = cms.sign(content, signer.certificate, signer.key)
    return {ROUTER: Artifact(content), SIGNATURE: Artifact(present)}


def _document(content: bytes | None, shown: str, command: str) -> bytes:
    if content is None:
        message, help_ = f"there is no {shown}", f"run {command!r}"
        raise KeymintError(message, where=Origin(shown), help=help_, code="document-missing")
    read(content, shown)
    return content
