# SPDX-License-Identifier: Apache-2.0
"""Shows texts and files without what differs in each run: keys, serial numbers, signatures, and what follows from them.

Nothing is hidden by its form. What is random is read from the files of the folder (serial numbers, digests of keys,
certificates and signed files), and each such value is called by the file that it came from: a report that names the
serial number of another certificate than before is a difference.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import stat
import tarfile
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, pkcs7

from comarmor.text import hexadecimal

_NUMBER = re.compile(r"(?<![0-9A-Za-z])(?:[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){7,}|[0-9A-Fa-f]{12,})(?![0-9A-Za-z])")
_PEM = re.compile(rb"-----BEGIN ([A-Z0-9 ]+)-----.+?-----END \1-----", re.DOTALL)
_NONCE = re.compile(rb'"nonce":"([0-9a-f]+)"')
_LINES = re.compile(r"(?<=\S) {2,}")
INTERNAL = ("register.sqlite3", ".keymint")
"""Files whose content is a matter of the program alone: only their presence and their modes are shown."""


class Volatile:
    """What is random in a folder, by the value; it grows as files appear."""

    def __init__(self, folder: Path, names: Mapping[str, str]) -> None:
        self._folder = folder
        self._names = sorted(names.items(), key=lambda pair: -len(pair[0]))
        self._known: dict[str, str] = {}
        self._seen: dict[str, int] = {}
        self._shown: dict[tuple[str, str], Any] = {}

    # -- texts ---------------------------------------------------------------------------------------------------

    def text(self, text: str) -> str:
        """Return a text with names in place of folders and of random values."""
        for value, name in self._names:
            text = text.replace(value, name)
        return "\n".join(self._line(line) for line in text.split("\n"))

    def value(self, value: Any) -> Any:
        """Return a JSON value whose texts are shown."""
        if isinstance(value, dict):
            # Rights of Zenoh are a digest of files with digests of keys; the documents themselves are compared.
            hidden = {"rights"} if isinstance(value.get("rights"), str) else set()
            return {self.text(key): "<rights>" if key in hidden else self.value(each) for key, each in value.items()}
        if isinstance(value, list):
            return [self.value(each) for each in value]
        if isinstance(value, int) and str(value) in self._known:
            return self._known[str(value)]
        return self.text(value) if isinstance(value, str) else value

    def _line(self, line: str) -> str:
        found = _NUMBER.sub(lambda match: self._name(match[0]), line)
        # Serial numbers are not equally long, and columns of tables follow them.
        return line if found == line else _LINES.sub("  ", found)

    def _name(self, number: str) -> str:
        plain = number.replace(":", "").lower().lstrip("0")
        return self._known.get(plain) or self._known.get(plain[:12], number) if plain else number

    def know(self, number: int | bytes | str, name: str) -> None:
        """Call a random value by a name: a digest, or a number in each of its forms."""
        forms = [str(number), f"{number:x}"] if isinstance(number, int) else []
        plain = number.hex() if isinstance(number, bytes) else number
        for form in (each.lstrip("0") for each in forms or [str(plain)]):
            self._known.setdefault(form, f"<{name}>")
            if len(form) >= 32:
                self._known.setdefault(form[:12], f"<{name}>")

    # -- files ---------------------------------------------------------------------------------------------------

    def tree(self) -> dict[str, Any]:
        """Return all files and folders below the folder: the mode of each, and its content as it is shown."""
        files = sorted(_walk(self._folder, ""))
        contents: dict[str, bytes] = {}
        for path, found in files:
            if stat.S_ISREG(found.st_mode) and not any(part in INTERNAL for part in path.split("/")):
                contents[path] = (self._folder / path).read_bytes()
        for path, content in contents.items():
            self._learn(path, content)
        shown: dict[str, Any] = {}
        for path, found in files:
            entry: dict[str, Any] = {"mode": f"{stat.filemode(found.st_mode)}"}
            if stat.S_ISLNK(found.st_mode):
                entry["link"] = self.text(str((self._folder / path).readlink()))
            elif path in contents:
                entry["content"] = self._content(path, contents[path])
            if ".keymint/" not in path:
                shown[self.text(path)] = entry
        return shown

    def _learn(self, path: str, content: bytes) -> None:
        """Read what is random in a file."""
        digest = hashlib.sha256(content).hexdigest()
        if (path, digest) in self._shown:
            return
        self._shown[path, digest] = None
        if not (path.endswith((".pem", ".p7s", ".bundle", ".crl")) or b"-----BEGIN" in content[:200]):
            return
        times = self._seen[path] = self._seen.get(path, 0) + 1
        place = path if times == 1 else f"{path}#{times}"
        for name, member in _members(content):
            inside = f"{place}:{name}" if name else place
            self.know(hashlib.sha256(member).digest(), f"digest of {inside}")
            for nonce in _NONCE.findall(member) if name == "manifest.json" else ():
                self.know(nonce.decode(), f"nonce of {place}")
            for number, found in enumerate(_objects(member)):
                self._learn_object(found, f"{inside}[{number}]" if number else inside)

    def _learn_object(self, found: Any, place: str) -> None:
        if isinstance(found, x509.Certificate):
            self.know(found.serial_number, f"serial of {place}")
            self.know(hashlib.sha256(found.public_bytes(Encoding.DER)).digest(), f"digest of certificate {place}")
            self.know(hashlib.sha1(found.public_bytes(Encoding.DER)).digest(), f"digest of certificate {place}")
        if isinstance(found, x509.Certificate | x509.CertificateSigningRequest):
            spki = found.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
            self.know(hashlib.sha256(spki).digest(), f"key of {place}")
            self.know(x509.SubjectKeyIdentifier.from_public_key(found.public_key()).digest, f"key of {place}")
        if isinstance(found, x509.CertificateRevocationList):
            for revoked in sorted(found, key=lambda each: each.revocation_date_utc):
                self.know(revoked.serial_number, f"serial in {place}")

    def _content(self, path: str, content: bytes) -> Any:
        key = (path, hashlib.sha256(content).hexdigest())
        if self._shown.get(key) is None:
            self._shown[key] = self._facts(path, content)
        return self._shown[key]

    def _facts(self, path: str, content: bytes) -> Any:
        if content.startswith(b"MIME-Version"):
            return self._signed(content)
        members = list(_members(content))
        if members[0][0]:
            return {name: self._facts(name, member) for name, member in members}
        if _PEM.search(content) and not path.endswith((".json", ".json5")):
            return [self._object(found) for found in _objects(content)]
        try:
            return self.text(content.decode())
        except UnicodeDecodeError:
            pass
        if path.endswith((".p7s", ".cms")):
            return ["signature", *_signers(content, pkcs7.load_der_pkcs7_certificates)]
        return f"sha256:{hashlib.sha256(content).hexdigest()} {len(content)} bytes"

    def _signed(self, content: bytes) -> Any:
        """Return what is signed, to the byte, with who signed it and the headers around it."""
        boundary = re.search(rb'boundary="([^"]+)"', content)
        if not boundary:
            return "no boundary"
        parts = content.split(b"--" + boundary[1])
        if len(parts) < 4:
            return f"{len(parts)} parts"
        head, signature = parts[0].replace(boundary[1], b"BOUNDARY"), parts[2].strip()
        headers, _, encoded = signature.replace(b"\r\n", b"\n").partition(b"\n\n")
        encoded = b"-----BEGIN PKCS7-----\n" + encoded.strip() + b"\n-----END PKCS7-----\n"
        return {
            "head": self.text(head.decode(errors="backslashreplace")),
            "signed": self.text(parts[1].decode(errors="backslashreplace")),
            "headers": headers.decode(errors="backslashreplace"),
            "signers": _signers(encoded, pkcs7.load_pem_pkcs7_certificates),
        }

    def _object(self, found: Any) -> Any:
        if isinstance(found, str):
            return found
        shown: dict[str, Any] = {"kind": type(found).__name__}
        if isinstance(found, x509.CertificateRevocationList):
            shown["issuer"] = found.issuer.rfc4514_string()
            shown["dates"] = [str(found.last_update_utc), str(found.next_update_utc)]
            shown["revoked"] = sorted(
                f"{self._name(hexadecimal(each.serial_number))} {each.revocation_date_utc} "
                f"{[reason.value for reason in each.extensions]}"
                for each in found
            )
        else:
            shown["subject"] = found.subject.rfc4514_string()
            shown["key"] = f"{type(found.public_key()).__name__} {getattr(found.public_key(), 'key_size', '')}"
        if isinstance(found, x509.Certificate):
            shown["issuer"] = found.issuer.rfc4514_string()
            shown["serial"] = self._name(hexadecimal(found.serial_number))
            shown["dates"] = [str(found.not_valid_before_utc), str(found.not_valid_after_utc)]
        shown["signature"] = found.signature_algorithm_oid.dotted_string
        shown["extensions"] = [
            f"{each.oid.dotted_string} {each.critical} {self._extension(each.value)}" for each in found.extensions
        ]
        return shown

    def _extension(self, value: x509.ExtensionType) -> str:
        if isinstance(value, x509.SubjectKeyIdentifier):
            return self._name(value.digest.hex())
        if isinstance(value, x509.AuthorityKeyIdentifier):
            return self._name((value.key_identifier or b"").hex())
        return repr(value)


def _walk(folder: Path, above: str) -> Iterator[tuple[str, os.stat_result]]:
    with os.scandir(folder) as entries:
        for entry in entries:
            found, path = entry.stat(follow_symlinks=False), above + entry.name
            yield path, found
            if stat.S_ISDIR(found.st_mode) and os.access(entry.path, os.R_OK | os.X_OK):
                yield from _walk(Path(entry.path), f"{path}/")


def _members(content: bytes) -> Iterable[tuple[str, bytes]]:
    """Return the files of an archive with their names, or the content itself without a name."""
    if content[257:262] != b"ustar":
        return [("", content)]
    try:
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            return [(each.name, read.read()) for each in archive if (read := archive.extractfile(each))]
    except tarfile.TarError:
        return [("", content)]


def _objects(content: bytes) -> Iterator[Any]:
    """Yield the objects in the blocks of PEM; a private key is only its kind."""
    readers = {
        b"CERTIFICATE": x509.load_pem_x509_certificate,
        b"CERTIFICATE REQUEST": x509.load_pem_x509_csr,
        b"X509 CRL": x509.load_pem_x509_crl,
    }
    for match in _PEM.finditer(content):
        try:
            with warnings.catch_warnings(action="ignore"):
                yield readers[match[1]](match[0]) if match[1] in readers else match[1].decode()
        except ValueError as error:
            yield f"unreadable {match[1].decode()}: {error}"


def _signers(content: bytes, load: Any) -> list[str]:
    try:
        with warnings.catch_warnings(action="ignore"):
            return [each.subject.rfc4514_string() for each in load(content)]
    except ValueError as error:
        return [f"unreadable: {error}"]
