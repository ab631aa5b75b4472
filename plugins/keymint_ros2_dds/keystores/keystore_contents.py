# SPDX-License-Identifier: Apache-2.0
"""What the files of a keystore contain, and which of them belong to an enclave.

Files belong to an enclave by name, as SROS2 lays them out, or else by what they contain. SROS2 from Foxy on has
``enclaves/<path>/``, before it a folder for each enclave at the top; all names are fixed. The guides of openssl and RTI
have no fixed names: one file for each certificate, key and signed document.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress

from cryptography import x509

from comarmor.values import Data
from keymint.api import KeystoreFile, KeystoreFiles
from keymint.errors import KeymintError, Origin
from keymint.names import package_name
from keymint.pki import certificates, extensions, keys, smime
from keymint.pki.distinguished_names import attributes
from keymint_ros2_dds import enclave_layout as layout, subject_names
from keymint_ros2_dds.reading import signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument
from keymint_ros2_dds.subject_names import same_name

FORMS: Mapping[str, str] = {
    "sros2": "made like 'ros2 security' of Foxy and later",
    "flat": "made like 'ros2 security' before Foxy",
    "": "single files, as the guides of openssl and RTI make them",
}
"""Forms of keystores in words, by layout."""
_SIGNED = b"MIME-Version:"
_REVOCATIONS = b"-----BEGIN X509 CRL-----"
_ENCLAVES, _PUBLIC, _PRIVATE = "enclaves/", "public/", "private/"
_TOP = frozenset((layout.CA, layout.IDENTITY_CA, layout.PERMISSIONS_CA))
"""Files at the top of the old layout, to which links of enclaves lead."""


class Contents(Data):
    """The files of a keystore by what they contain; links are left out, since they repeat another file.

    Attributes:
        keystore: the keystore.
        certificates: the first certificate of each file that begins with one.
        keys: paths of the files with a private key that can be read, by the fingerprint of the key; PEM first.
        sealed: paths of the files with a private key that cannot be read (:func:`keymint.pki.keys.private_keys`).
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
        elif keys.has_private_key(file.content):
            owned, is_sealed = keys.private_keys(file.content)
            sealed += [path] if is_sealed else []
            for public in owned:
                private.setdefault(keys.fingerprint(public), []).append(path)
        elif _REVOCATIONS in file.content:
            revocations.append(path)
        else:
            with suppress(KeymintError):  # it has no certificate, or one that cannot be read
                first = certificates.load_bundle(file.content)[0]
                certificates.public_key(first)
                found[path] = first
    for paths in private.values():
        paths.sort(key=lambda path: b"-----BEGIN " not in keystore.files[path].content)
    return Contents(keystore, found, private, tuple(sealed), permissions, tuple(governances), tuple(revocations))


def _document(signed: bytes) -> PermissionsDocument | GovernanceDocument | None:
    """Return a signed document; None for any other file."""
    with suppress(KeymintError):
        content = smime.signed_content(signed)
        for read in (signed_permissions.read, signed_governance.read):
            with suppress(KeymintError):
                return read(content)
    return None


# -- which files belong to an enclave --------------------------------------------------------------------------------


class EnclavePlace(Data):
    """Where the files of an enclave are.

    Attributes:
        subject: the subject; empty if nothing says which it is.
        place: its folder, or the path of its certificate.
        files: path in the keystore, by the name that the layout gives the file.
    """

    subject: str
    place: str
    files: Mapping[str, str]


def places(contents: Contents) -> tuple[str, tuple[EnclavePlace, ...], tuple[str, ...]]:
    """Return where the files of a keystore are.

    Returns:
        The layout, empty if names say nothing; the enclaves, sorted by subject; and the files that an install space of
        this layout has at the same place.

    Raises:
        KeymintError: there is no enclave.
    """
    files = contents.keystore.files
    if found := tuple(_named(files, _ENCLAVES, lambda _: True)):
        return "sros2", found, tuple(path for path in files if path.startswith((_ENCLAVES, _PUBLIC)))
    if found := tuple(_named(files, "", lambda path: not path.startswith((_ENCLAVES, _PUBLIC, _PRIVATE)))):
        folders = tuple(f"{each.place}/" for each in found)
        return "flat", found, tuple(path for path in files if path in _TOP or path.startswith(folders))
    if found := tuple(sorted(_by_content(contents), key=lambda each: each.subject)):
        return "", found, ()
    message = "has no enclave: neither a folder with cert.pem, nor a certificate and signed permissions for its subject"
    help_ = "name the folder that ROS_SECURITY_KEYSTORE names, or one with all certificates and signed documents"
    raise KeymintError(message, where=contents.place(""), help=help_, code="keystore-unknown")


def _named(files: Mapping[str, KeystoreFile], top: str, is_searched: Callable[[str], bool]) -> Iterator[EnclavePlace]:
    """Yield the enclaves below a folder, each of which has a certificate or a key under its fixed name."""
    folders: dict[str, dict[str, str]] = {}
    for path in files:
        folder, _, name = path.rpartition("/")
        if path.startswith(top) and is_searched(path):
            folders.setdefault(f"{folder}/".removeprefix(top).rstrip("/"), {})[name] = path
    for folder, own in sorted(folders.items()):
        if (layout.CERTIFICATE in own or layout.KEY in own) and (folder or top):
            yield EnclavePlace(f"/{folder}", f"{top}{folder}".rstrip("/"), own)


def _by_content(contents: Contents) -> Iterator[EnclavePlace]:
    """Yield an enclave for each certificate of an identity for which there are signed permissions."""
    authorities = {path: each for path, each in contents.certificates.items() if _is_authority(each)}
    for path, certificate in contents.certificates.items():
        if path in authorities:
            continue
        name = subject_names.of_any(certificate.subject)
        named = {file: [each.subject_name for each in found.grants] for file, found in contents.permissions.items()}
        documents = [file for file, names in named.items() if any(same_name(each, name) for each in names)]
        if not documents:
            continue
        issuing = {file: each for file, each in authorities.items() if extensions.may(each, "keyCertSign")}
        issuer = next((file for file, each in issuing.items() if certificates.is_issued_by(certificate, each)), "")
        signer = next((file for file, each in authorities.items() if _signed(contents.read(documents[0]), each)), "")
        # Participants read the key from a file with it in PEM, as the first one.
        public = certificates.public_key(certificate)
        keyed = ((file, contents.read(file)) for file in contents.keys_of(certificate))
        own = {
            layout.CERTIFICATE: path,
            layout.KEY: next((file for file, content in keyed if keys.pem_of(content, public) == content), ""),
            layout.IDENTITY_CA: issuer,
            layout.PERMISSIONS_CA: signer,
            layout.PERMISSIONS_P7S: documents[0] if len(documents) == 1 else "",
            layout.GOVERNANCE_P7S: contents.governances[0] if len(contents.governances) == 1 else "",
        }
        yield EnclavePlace(_subject(certificate), path, {name: file for name, file in own.items() if file})


def _signed(content: bytes, authority: x509.Certificate) -> bool:
    try:
        smime.verify(content, certificates.to_pem(authority))
    except KeymintError:
        return False
    return True


def _subject(certificate: x509.Certificate) -> str:
    """Return the subject that a common name stands for; empty if it is no name of a subject."""
    names = [value for kind, value in attributes(certificate.subject) if kind == "CN"]
    try:
        return f"/{package_name(names[0])}" if len(names) == 1 else ""
    except KeymintError:
        return ""


def _is_authority(certificate: x509.Certificate) -> bool:
    """Tell whether a certificate may issue others."""
    constraints = extensions.value(certificate, x509.BasicConstraints)
    return constraints is not None and constraints.ca
