"""The files of an installed enclave, as a transport reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cryptography import x509

from keymint.api import Enclave
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, names
from keymint_ros2_dds.install import CA, IDENTITY_CA, PERMISSIONS_CA

__all__ = ["authority", "by_subject", "content", "subject_name"]


def by_subject(enclaves: Sequence[Enclave]) -> Mapping[str, Enclave]:
    """Return enclaves by their subjects."""
    return {enclave.subject: enclave for enclave in enclaves}


def content(folder: Path, name: str) -> bytes:
    """Return a file of an enclave.

    Raises:
        KeymintError: it cannot be read.
    """
    try:
        return (folder / name).read_bytes()
    except OSError as error:
        raise KeymintError(
            f"{name} cannot be read: {error.strerror}",
            where=Origin(str(folder / name)),
            help="run 'keymint install'",
            code="enclave-file",
        ) from None


def authority(folder: Path, *, permissions: bool) -> bytes:
    """Return the certificate of an authority: the layout of Ardent has one file for both.

    Raises:
        KeymintError: it cannot be read.
    """
    name = PERMISSIONS_CA if permissions else IDENTITY_CA
    return content(folder, name if (folder / name).exists() else CA)


def subject_name(certificate: bytes, where: Origin) -> str:
    """Return the subject of an identity as grants name it: in the order of RFC 2253, last RDN first.

    Raises:
        KeymintError: it is no certificate.
    """
    loaded: x509.Certificate = certificates.load(certificate, where)
    try:
        return names.render(loaded.subject)
    except KeymintError:  # not portable, which is for ``keymint check`` to say
        return loaded.subject.rfc4514_string()
