# SPDX-License-Identifier: Apache-2.0
"""What the files of a keystore contain, whatever their names are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

from cryptography import x509

from comarmor.errors import Diagnostic, Origin
from comarmor.values import dataclass
from keymint.api import KeystoreFiles
from keymint.errors import KeymintError
from keymint.pki import certificates, extensions, key_files, keys, smime
from keymint_ros2_dds.reading import signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument

_SIGNED = b"MIME-Version:"
_REVOCATIONS = b"-----BEGIN X509 CRL-----"


@dataclass(frozen=True, slots=True)
class Contents:
    """The files of a keystore by what they contain; links are left out, since they repeat another file.

    Attributes:
        keystore: the keystore.
        certificates: the first certificate of each file that begins with one.
        keys: paths of the files with a private key that can be read, by the fingerprint of the key; PEM first.
        sealed: paths of the files with a private key that cannot be read (:attr:`PrivateKeys.sealed`).
        permissions: unverified permissions documents by path of the signed file.
        governances: paths of signed governance documents.
        revocation_lists: paths of revocation lists.
    """

    keystore: KeystoreFiles
    certificates: Mapping[str, x509.Certificate]
    keys: Mapping[str, Sequence[str]]
    sealed: tuple[str, ...]
    permissions: Mapping[str, PermissionsDocument]
    governances: tuple[str, ...]
    revocation_lists: tuple[str, ...]

    def read(self, path: str) -> bytes:
        """Return what a file contains, also through a link."""
        return self.keystore.files[path].content

    def place(self, path: str) -> Origin:
        """Return a path of the keystore as the user would type it."""
        folder = self.keystore.folder
        return Origin(f"{folder}/{path}" if path else folder)

    def error(self, code: str, path: str, message: str, help_: str, subject: str = "") -> Diagnostic:
        """Return why a file or folder cannot be taken over as it is."""
        return Diagnostic.error(code, message, self.place(path), help_, subject)

    def warning(self, code: str, path: str, message: str, help_: str, subject: str = "") -> Diagnostic:
        """Return what is wrong with a file that is taken over."""
        return Diagnostic.warning(code, message, self.place(path), help_, subject)

    def note(self, code: str, path: str, message: str, help_: str) -> Diagnostic:
        """Return what a later step can improve."""
        return Diagnostic.note(code, message, self.place(path), help_)

    def keys_of(self, certificate: x509.Certificate) -> Sequence[str]:
        """Return the paths of all files with the private key of a certificate; those in PEM come first."""
        public = certificate.public_key()
        return self.keys.get(keys.fingerprint(public), ()) if isinstance(public, keys.PublicKey) else ()


def contents(keystore: KeystoreFiles) -> Contents:
    """Return what the files of a keystore contain; files that cannot be read contain nothing."""
    found: dict[str, x509.Certificate] = {}
    private: dict[str, list[str]] = {}
    sealed: list[str] = []
    revocations: list[str] = []
    permissions: dict[str, PermissionsDocument] = {}
    governances: list[str] = []
    for path, file in keystore.files.items():
        if file.link:
            continue
        if file.content.startswith(_SIGNED):
            document = _document(file.content)
            if isinstance(document, PermissionsDocument):
                permissions[path] = document
            elif document is not None:
                governances.append(path)
        elif key_files.has_any(file.content):
            own = key_files.private_keys(file.content)
            sealed += [path] if own.sealed else []
            for public in own.public:
                private.setdefault(keys.fingerprint(public), []).append(path)
        elif _REVOCATIONS in file.content:
            revocations.append(path)
        elif (certificate := first_certificate(file.content)) is not None:
            found[path] = certificate
    by_form = {name: sorted(paths, key=lambda path: not _is_pem(keystore, path)) for name, paths in private.items()}
    return Contents(keystore, found, by_form, tuple(sealed), permissions, tuple(governances), tuple(revocations))


def _is_pem(keystore: KeystoreFiles, path: str) -> bool:
    return b"-----BEGIN " in keystore.files[path].content


def first_certificate(pem: bytes) -> x509.Certificate | None:
    """Return the first certificate of a file; None if it has none, or one that cannot be read."""
    try:
        certificate = certificates.load_bundle(pem)[0]
        certificates.public_key(certificate)
    except KeymintError:
        return None
    return certificate


def is_authority(certificate: x509.Certificate) -> bool:
    """Tell whether a certificate may issue others."""
    constraints = extensions.value(certificate, x509.BasicConstraints)
    return constraints is not None and constraints.ca


def _document(signed: bytes) -> PermissionsDocument | GovernanceDocument | None:
    """Return a signed document; None for any other file."""
    with suppress(KeymintError):
        content = smime.signed_content(signed)
        for read in (signed_permissions.read, signed_governance.read):
            with suppress(KeymintError):
                return read(content)
    return None
