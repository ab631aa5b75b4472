# SPDX-License-Identifier: Apache-2.0
"""Bundles: the files of one enclave with a manifest that the issuer of its certificate signs.

The signature is detached CMS (RFC 5652) with the authority's own certificate, as in the documents of enclaves;
``openssl cms -verify`` checks it. Reading a bundle shows that it is whole and by the authority that it names; whether
this authority is the right one is decided in :mod:`keymint.examine.bundles`.

The manifest is JSON in a canonical form (that of RFC 8785 for the values that occur), which is the only one that is
read; ``schemas/keymint/bundle.schema.json`` describes it. The file is an uncompressed tar archive (POSIX.1-1988 ustar),
also in one canonical form. Only the form that :func:`pack` writes is read. So names, sizes, modes, links, padding and
what other readers of tar may make of them need no rules of their own: a file with any other byte is refused. Each
header is compared before the data behind it is copied, because a reader of all forms of tar takes more memory than the
file is long.
"""

from __future__ import annotations

import hashlib
import json
import re
import tarfile
from collections.abc import Iterable, Mapping
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

from cryptography import x509

from comarmor.text import lazy_regex
from comarmor.values import Data, field, replace
from keymint.errors import KeymintError, Origin
from keymint.names import name_of, package_name, subject_of
from keymint.pki import certificates, cms, extensions
from keymint.pki.revocation_lists import is_by, parse

CERTIFICATE, KEY = "cert.pem", "key.pem"
"""The identity of an enclave and its private key; see :class:`keymint.api.BuildType`."""
MANIFEST, SIGNATURE = "manifest.json", "manifest.cms"
"""Members of a bundle beside the enclave's files."""
MAX_BYTES = 16 << 20
"""Largest bundle in bytes; documents of a subject have some thousand to some million."""
MAX_MEMBERS = 64
NAME = lazy_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
"""The names of members: no folder, nothing hidden, and no longer than a header of tar has room for."""
FORMAT = "keymint-bundle"
VERSION = 1
MAX_MANIFEST = 1 << 16
"""Largest manifest in bytes."""
MAX_NUMBER = 1 << 53
"""Numbers of JSON are exact below this (RFC 8259, 6)."""
_DIGEST = lazy_regex(r"[0-9a-f]{64}")
_NONCE = lazy_regex(r"(?:[0-9a-f]{32})?")
_FOLDER = lazy_regex(r"(?:[A-Za-z0-9][A-Za-z0-9_-]{0,99})?")
_LIST = b"-----BEGIN X509 CRL-----"


class Manifest(Data):
    """What a bundle is for.

    Attributes:
        enclave: the enclave, e.g. ``/robot/talker``.
        folder: the folder of all enclaves below the keystore; empty if they lie at its top.
        key: fingerprint of the certified public key (see :func:`keymint.pki.keys.fingerprint`).
        authority: fingerprint of the key of the authority that issued the certificate and signs the manifest.
        generation: generation of the subject name; see :class:`keymint.api.Issuance`.
        issue: rises with every bundle for the enclave, at least 1.
        revocations: number of the authority's revocation list in the bundle; 0 if it has none.
        nonce: the nonce of the request that the bundle answers; empty if it answers none.
        not_before: from when on all that is in the bundle is in force, UTC.
        not_after: how long all that is in the bundle is in force, UTC.
        files: SHA-256 of every file of the enclave, in hexadecimal digits, by name.
    """

    enclave: str
    folder: str
    key: str
    authority: str
    generation: int
    issue: int
    revocations: int
    nonce: str
    not_before: datetime
    not_after: datetime
    files: Mapping[str, str]

    @property
    def name(self) -> str:
        """The name of the enclave's package."""
        return name_of(self.enclave)


class Bundle(Data):
    """A bundle that is whole, and signed by the authority that it names.

    Attributes:
        manifest: its manifest.
        encoded: the bytes of the manifest.
        files: the files of the enclave by name.
        certificate: the certificate of the enclave.
        signer: the certificate of the authority that issued it and signed the manifest.
        authorities: the certificates of authorities by file.
        lists: the revocation lists.
    """

    manifest: Manifest
    encoded: bytes
    files: Mapping[str, bytes] = field(repr=False)
    certificate: x509.Certificate
    signer: x509.Certificate
    authorities: Mapping[str, tuple[x509.Certificate, ...]]
    lists: tuple[x509.CertificateRevocationList, ...]


def write(manifest: Manifest, files: Mapping[str, bytes], issuer: certificates.Issuer) -> bytes:
    """Return the bundle of an enclave.

    Args:
        manifest: its manifest; the digests of the files are filled in.
        files: the enclave's files by name; the certificate is by the issuer.
        issuer: the authority.

    Raises:
        KeymintError: the authority's certificate does not permit it to sign documents, or the files are too large.
    """
    if problem := certificates.can_sign_documents(issuer.certificate):
        raise KeymintError.of([replace(problem, help=f"{problem.help}, then 'keymint authority renew' reissues it")])
    encoded = dump(replace(manifest, files=_digests(files)))
    members = {**files, MANIFEST: encoded, SIGNATURE: cms.sign(encoded, issuer.certificate, issuer.key)}
    try:
        return pack(members)
    except ValueError:
        raise KeymintError(
            f"the files of {manifest.enclave} do not fit into a bundle",
            help=f"the most are {MAX_MEMBERS} files and {MAX_BYTES:,} bytes",
            code="bundle-size",
        ) from None


def read(content: bytes, where: Origin) -> Bundle:
    """Return a bundle, after verifying its digests and its signature.

    Args:
        content: the file.
        where: the file, for messages.

    Raises:
        KeymintError: ``bundle-form``, ``bundle-manifest``, ``bundle-version``: it is not a bundle, or cannot be read.
            ``bundle-altered``: a file or the manifest was altered, or is by another authority than the certificate.
    """
    members = dict(unpack(content, where))
    encoded, signature = members.pop(MANIFEST, b""), members.pop(SIGNATURE, b"")
    manifest = load(encoded, where)
    if _digests(members) != manifest.files:
        raise _altered("has files that are not those of its manifest", where)
    authorities = certificates_of_authorities(members)
    try:
        certificate = certificates.load(members.get(CERTIFICATE, b""))
        key = certificates.fingerprint(certificate)
        parsed = cms.parse(signature)
        signer = next(
            each
            for chain in authorities.values()
            for each in chain
            if certificates.fingerprint(each) == manifest.authority and certificates.is_issued_by(certificate, each)
        )
        verified = cms.verify(parsed, encoded, signer) and certificates.can_sign_documents(signer) is None
        lists = revocation_lists(members)
    except (KeymintError, StopIteration, ValueError, TypeError):
        raise _altered("is not signed by the authority that issued its certificate", where) from None
    if not verified:
        raise _altered("its manifest is not signed by the authority that issued its certificate", where)
    if key != manifest.key:
        raise _altered("its certificate is for another key than its manifest", where)
    return Bundle(manifest, encoded, members, certificate, signer, authorities, lists)


def certificates_of_authorities(files: Mapping[str, bytes]) -> dict[str, tuple[x509.Certificate, ...]]:
    """Return the certificates that an enclave trusts, by the name of their file.

    Raises:
        KeymintError: a certificate is damaged.
    """
    return {
        name: certificates.load_bundle(content)
        for name, content in files.items()
        if name != CERTIFICATE and certificates.BEGIN in content and name.endswith(".pem")
    }


def issuing_files(certificate: bytes, authorities: Mapping[str, tuple[x509.Certificate, ...]]) -> frozenset[str]:
    """Return the names of the files with the authority that issued the certificate of an enclave, PEM.

    Args:
        certificate: the certificate, PEM; if it cannot be read, nobody issued it.
        authorities: the certificates of authorities by file.
    """
    try:
        own = certificates.load(certificate)
    except KeymintError:
        return frozenset()
    by_file = authorities.items()
    return frozenset(file for file, chain in by_file if any(certificates.is_issued_by(own, each) for each in chain))


def revocation_lists(files: Mapping[str, bytes]) -> tuple[x509.CertificateRevocationList, ...]:
    """Return the revocation lists of an enclave.

    Raises:
        ValueError: a list is damaged.
    """
    blocks = (block for name, content in files.items() if name.endswith(".pem") for block in content.split(_LIST)[1:])
    return tuple(parse(_LIST + block) for block in blocks)


def number_of(lists: Iterable[x509.CertificateRevocationList], authority: x509.Certificate) -> int:
    """Return the lowest number of the revocation lists of an authority (RFC 5280, 5.2.3); 0 if there is none."""
    try:
        numbers = [extensions.value(each, x509.CRLNumber) for each in lists if is_by(each, authority)]
    except ValueError:
        return 0
    return min((each.crl_number if each else 0 for each in numbers), default=0)


def _digests(files: Mapping[str, bytes]) -> Mapping[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def _altered(message: str, where: Origin) -> KeymintError:
    help_ = "somebody or something altered it on its way: copy it again from the authority"
    return KeymintError(message, where=where, help=help_, code="bundle-altered")


# -- the manifest ------------------------------------------------------------------------------------------------------


def dump(manifest: Manifest) -> bytes:
    """Return a manifest in its canonical form."""
    values = {each.name: getattr(manifest, each.name) for each in fields(manifest)}
    values |= {"format": FORMAT, "version": VERSION, "files": dict(manifest.files)}
    for name in ("not_before", "not_after"):
        values[name] = values[name].astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    return json.dumps(values, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def load(content: bytes, where: Origin) -> Manifest:
    """Return a manifest.

    Args:
        content: what :func:`dump` wrote.
        where: its file, for messages.

    Raises:
        KeymintError: ``bundle-manifest``: it is not in the canonical form. ``bundle-version``: a later version of
            Keymint wrote it.
    """
    try:
        values: Any = json.loads(content.decode("ascii")) if len(content) <= MAX_MANIFEST else None
        version = values["version"] if values["format"] == FORMAT else None
        manifest = None if version != VERSION else _manifest(values)
    except (KeymintError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        manifest = version = None
    if isinstance(version, int) and version > VERSION:
        message = f"is a bundle of version {version}, expected {VERSION}"
        help_ = "install the version of Keymint that the authority has"
        raise KeymintError(message, where=where, help=help_, code="bundle-version")
    if manifest is None or dump(manifest) != content:
        message = "its manifest is damaged, or not what 'keymint bundle' writes"
        help_ = "copy the bundle again from the authority"
        raise KeymintError(message, where=where, help=help_, code="bundle-manifest")
    return manifest


def _manifest(values: Mapping[str, Any]) -> Manifest:
    """Return the manifest with these values.

    Raises:
        ValueError: a value is not legal. Other errors: there is no such value, or it has another type.
    """
    enclave = subject_of(package_name(values["enclave"]))
    files = {_matching(NAME, name): _matching(_DIGEST, value) for name, value in values["files"].items()}
    if not files or (enclave == "/" and not values["folder"]):  # the root enclave has no place there
        raise ValueError
    return Manifest(
        enclave=enclave,
        folder=_matching(_FOLDER, values["folder"]),
        key=_matching(_DIGEST, values["key"]),
        authority=_matching(_DIGEST, values["authority"]),
        generation=_number(values["generation"], 0),
        issue=_number(values["issue"], 1),
        revocations=_number(values["revocations"], 0),
        nonce=_matching(_NONCE, values["nonce"]),
        not_before=datetime.fromisoformat(values["not_before"]).astimezone(UTC),
        not_after=datetime.fromisoformat(values["not_after"]).astimezone(UTC),
        files=files,
    )


def _matching(form: re.Pattern[str], text: str) -> str:
    if not form.fullmatch(text):
        raise ValueError
    return text


def _number(value: object, least: int) -> int:
    if type(value) is not int or not least <= value < MAX_NUMBER:
        raise ValueError
    return value


# -- the archive -------------------------------------------------------------------------------------------------------


def pack(members: Mapping[str, bytes]) -> bytes:
    """Return the archive of some files, sorted by name; every one has the mode 0600.

    Raises:
        ValueError: a name or the number or size of the files is not allowed.
    """
    if len(members) > MAX_MEMBERS or not all(map(NAME.fullmatch, members)):
        raise ValueError("members of a bundle")
    content = b"".join(
        part
        for name, data in sorted(members.items())
        for part in (_header(name, len(data)), data, bytes(-len(data) % tarfile.BLOCKSIZE))
    )
    size = len(content) + 2 * tarfile.BLOCKSIZE  # two empty blocks are the end
    packed = content.ljust(size + -size % tarfile.RECORDSIZE, b"\0")
    if len(packed) > MAX_BYTES:
        raise ValueError("size of a bundle")
    return packed


def unpack(content: bytes, where: Origin) -> Mapping[str, bytes]:
    """Return the files of an archive by name.

    Args:
        content: the archive.
        where: its file, for messages.

    Raises:
        KeymintError: it is not exactly what :func:`pack` writes; code ``bundle-form``.
    """
    if len(content) > MAX_BYTES:
        raise _refused(f"has {len(content):,} bytes, {MAX_BYTES:,} are the most", where)
    members: dict[str, bytes] = {}
    at = 0
    try:
        while content[at : at + 1].strip(b"\0") and len(members) < MAX_MEMBERS:
            begin = at + tarfile.BLOCKSIZE
            name = content[at : at + 100].rstrip(b"\0").decode("ascii")
            end = begin + int(content[at + 124 : at + 135], 8)
            is_ours = NAME.fullmatch(name) and name not in members and content[at:begin] == _header(name, end - begin)
            if not is_ours or end > len(content):
                raise _refused("has an entry that no bundle has", where)
            members[name] = content[begin:end]
            at = end + -end % tarfile.BLOCKSIZE
        canonical = pack(members) == content
    except ValueError:
        canonical = False
    if not canonical:
        raise _refused("is not a bundle, or was truncated or altered", where)
    return members


def _header(name: str, size: int) -> bytes:
    """Return the header of a file: 512 bytes, as POSIX.1-1988 has them.

    Raises:
        ValueError: the size is negative, or too large for a header.
    """
    header = tarfile.TarInfo(name)
    header.size, header.mode = size, 0o600
    return header.tobuf(tarfile.USTAR_FORMAT)


def _refused(message: str, where: Origin) -> KeymintError:
    return KeymintError(message, where=where, help="copy it again from the authority", code="bundle-form")
