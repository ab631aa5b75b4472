# SPDX-License-Identifier: Apache-2.0
"""Where the files of an enclave are in a keystore: by name, as SROS2 lays them out, or else by what they contain.

SROS2 from Foxy on has ``enclaves/<path>/``, before it a folder for each enclave at the top; all names are fixed. The
guides of openssl and RTI have no fixed names: one file for each certificate, key and signed document.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from cryptography import x509

from comarmor.values import dataclass
from keymint.api import KeystoreFile
from keymint.errors import KeymintError
from keymint.names import package_name
from keymint.pki import certificates, extensions, key_files, smime
from keymint.pki.distinguished_names import attributes
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.decision.subject_names import same_name
from keymint_ros2_dds.enclave_layout import (
    CA,
    CERTIFICATE,
    GOVERNANCE_P7S,
    IDENTITY_CA,
    KEY,
    PERMISSIONS_CA,
    PERMISSIONS_P7S,
)
from keymint_ros2_dds.keystores.file_contents import Contents, is_authority

FORMS: Mapping[str, str] = {
    "sros2": "made like 'ros2 security' of Foxy and later",
    "flat": "made like 'ros2 security' before Foxy",
    "": "single files, as the guides of openssl and RTI make them",
}
"""Forms of keystores in words, by layout."""
_ENCLAVES, _PUBLIC, _PRIVATE = "enclaves/", "public/", "private/"
_TOP = frozenset((CA, IDENTITY_CA, PERMISSIONS_CA))
"""Files at the top of the old layout, to which links of enclaves lead."""


@dataclass(frozen=True, slots=True)
class EnclavePlace:
    """Where the files of an enclave are.

    Attributes:
        subject: the subject; empty if nothing says which it is.
        place: its folder, or the path of its certificate.
        files: path in the keystore, by the name that the layout gives the file.
    """

    subject: str
    place: str
    files: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Places:
    """Where the files of a keystore are.

    Attributes:
        layout: the layout; empty if names say nothing.
        enclaves: the enclaves, sorted by subject.
        kept: the files that an install space of this layout has at the same place.
    """

    layout: str
    enclaves: tuple[EnclavePlace, ...]
    kept: tuple[str, ...]


def places(contents: Contents) -> Places:
    """Return where the files of a keystore are.

    Raises:
        KeymintError: there is no enclave.
    """
    files = contents.keystore.files
    if found := tuple(_named(files, _ENCLAVES, lambda _: True)):
        kept = tuple(path for path in files if path.startswith((_ENCLAVES, _PUBLIC)))
        return Places("sros2", found, kept)
    if found := tuple(_named(files, "", lambda path: not path.startswith((_ENCLAVES, _PUBLIC, _PRIVATE)))):
        folders = tuple(f"{each.place}/" for each in found)
        return Places("flat", found, tuple(path for path in files if path in _TOP or path.startswith(folders)))
    if found := tuple(sorted(_by_content(contents), key=lambda each: each.subject)):
        return Places("", found, ())
    raise KeymintError(
        "has no enclave: neither a folder with cert.pem, nor a certificate and signed permissions for its subject",
        where=contents.place(""),
        help="name the folder that ROS_SECURITY_KEYSTORE names, or one with all certificates and signed documents",
        code="keystore-unknown",
    )


def _named(files: Mapping[str, KeystoreFile], top: str, is_searched: Callable[[str], bool]) -> Iterator[EnclavePlace]:
    """Yield the enclaves below a folder, each of which has a certificate or a key under its fixed name."""
    folders: dict[str, dict[str, str]] = {}
    for path in files:
        folder, _, name = path.rpartition("/")
        if path.startswith(top) and is_searched(path):
            folders.setdefault(f"{folder}/".removeprefix(top).rstrip("/"), {})[name] = path
    for folder, own in sorted(folders.items()):
        if (CERTIFICATE in own or KEY in own) and (folder or top):
            yield EnclavePlace(f"/{folder}", f"{top}{folder}".rstrip("/"), own)


def _by_content(contents: Contents) -> Iterator[EnclavePlace]:
    """Yield an enclave for each certificate of an identity for which there are signed permissions."""
    authorities = {path: each for path, each in contents.certificates.items() if is_authority(each)}
    for path, certificate in contents.certificates.items():
        if path in authorities:
            continue
        name = subject_name_text.of_any(certificate.subject)
        named = {file: [each.subject_name for each in found.grants] for file, found in contents.permissions.items()}
        documents = [file for file, names in named.items() if any(same_name(each, name) for each in names)]
        if not documents:
            continue
        issuer = next((file for file, each in authorities.items() if _issued(certificate, each)), "")
        signer = next((file for file, each in authorities.items() if _signed(contents.read(documents[0]), each)), "")
        own = {
            CERTIFICATE: path,
            KEY: next((file for file in contents.keys_of(certificate) if _is_read(contents, file, certificate)), ""),
            IDENTITY_CA: issuer,
            PERMISSIONS_CA: signer,
            PERMISSIONS_P7S: documents[0] if len(documents) == 1 else "",
            GOVERNANCE_P7S: contents.governances[0] if len(contents.governances) == 1 else "",
        }
        yield EnclavePlace(_subject(certificate), path, {name: file for name, file in own.items() if file})


def _is_read(contents: Contents, path: str, certificate: x509.Certificate) -> bool:
    """Tell whether participants read the key of a certificate from a file with it: in PEM, as the first one."""
    content = contents.read(path)
    return key_files.pem_of(content, certificates.public_key(certificate)) == content


def _issued(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    return extensions.may(authority, "keyCertSign") and certificates.is_issued_by(certificate, authority)


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
