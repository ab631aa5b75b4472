# SPDX-License-Identifier: Apache-2.0
"""Other readers of signed files, to compare Keymint with: OpenSSL as vendors call it, its command, a vendor, Python.

Each returns the content with LF line ends, or None where it refuses the file.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import email
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from ctypes import c_char_p, c_int, c_long, c_void_p
from dataclasses import dataclass, field
from pathlib import Path

from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki import smime
from tests.robustness.signed_mutation import Random, mutated
from tests.signers import SIGNERS, by_openssl

from .handmade import Authorities, criteria, permissions_document, rule

Read = Callable[[bytes], bytes | None]
_TEXT, _NOINTERN, _NOVERIFY = 0x1, 0x10, 0x20
_BIO_CTRL_INFO = 3


class Libcrypto:
    """OpenSSL's functions as the vendors call them: ``SMIME_read_PKCS7``, then ``PKCS7_verify``.

    Args:
        authority: certificate of the permissions authority, PEM.
        intern: as Cyclone DDS 0.10 and Fast DDS 2.9: the signer is found inside, and its path is verified. Else as
            later ones: the signer is the authority.

    Raises:
        OSError: there is no libcrypto.
    """

    def __init__(self, authority: bytes, *, intern: bool) -> None:
        self._library = ctypes.CDLL(ctypes.util.find_library("crypto") or "libcrypto.so.3")
        self._intern = intern
        call = self._call
        source = call("BIO_new_mem_buf", c_char_p(authority), c_int(len(authority)))
        certificate = call("PEM_read_bio_X509", source, None, None, None)
        assert certificate, "no certificate"
        self._store = call("X509_STORE_new")
        call("X509_STORE_add_cert", self._store, certificate)
        self._certificates = call("OPENSSL_sk_new_null")
        call("OPENSSL_sk_push", self._certificates, certificate)
        call("BIO_free", source)

    def _call(self, name: str, *arguments: object) -> c_void_p:
        function = getattr(self._library, name)
        function.restype = c_void_p
        return c_void_p(function(*arguments))

    def read(self, signed: bytes) -> bytes | None:
        """Return the content with CRLF, as vendors receive it, or None."""
        call, content = self._call, c_void_p()
        source = call("BIO_new_mem_buf", c_char_p(signed), c_int(len(signed)))
        found = call("SMIME_read_PKCS7", source, ctypes.byref(content))
        text: bytes | None = None
        if found:
            out = call("BIO_new", call("BIO_s_mem"))
            chain, flags = (None, _TEXT) if self._intern else (self._certificates, _TEXT | _NOVERIFY | _NOINTERN)
            verify = self._library.PKCS7_verify
            verify.restype = c_int
            if verify(found, chain, self._store, content, out, c_int(flags)) == 1:
                at = c_void_p()
                size = self._library.BIO_ctrl
                size.restype = c_long
                length = size(out, c_int(_BIO_CTRL_INFO), c_long(0), ctypes.byref(at))
                text = ctypes.string_at(at, length) if length else b""
            call("BIO_free", out)
            call("PKCS7_free", found)
            if content:
                call("BIO_free", content)
        call("BIO_free", source)
        call("ERR_clear_error")
        return text


@dataclass(frozen=True, slots=True)
class Command:
    """``openssl smime -verify``, a process for each file."""

    folder: Path
    authority: bytes

    def __post_init__(self) -> None:
        (self.folder / "ca").write_bytes(self.authority)

    def read(self, signed: bytes) -> bytes | None:
        """Return the content with CRLF, or None."""
        (self.folder / "signed").write_bytes(signed)
        (self.folder / "content").write_bytes(b"")
        asked = ("-text", "-in", "signed", "-CAfile", "ca", "-nointern", "-certfile", "ca", "-out", "content")
        done = subprocess.run(
            ["openssl", "smime", "-verify", *asked], cwd=self.folder, capture_output=True, check=False
        )
        return (self.folder / "content").read_bytes() if done.returncode == 0 else None


def by_email(signed: bytes) -> bytes | None:
    """Return the content as Python's ``email`` reads it, without verifying the signature, or None."""
    message = email.message_from_bytes(signed)
    parts = message.get_payload()
    if not message.is_multipart() or not isinstance(parts, list):
        return None
    content = parts[0].get_payload(decode=True)
    return content.replace(b"\r\n", b"\n") if isinstance(content, bytes) else None


@dataclass(frozen=True, slots=True)
class Cyclone:
    """Cyclone DDS's access-control plugin. The topics that it permits show which document it read.

    Attributes:
        folder: of an enclave.
        topics: the topic that each document permits.
    """

    folder: Path
    topics: Mapping[bytes, str]

    def read(self, signed: bytes) -> bytes | None:
        """Return the document that the plugin read, or None."""
        (self.folder / "permissions.p7s").write_bytes(signed)
        with CycloneAccessControl(self.folder) as access:
            if not access.valid:
                return None
            permitted = [text for text, topic in self.topics.items() if access.allows("publish", topic)]
        assert len(permitted) == 1, permitted
        return permitted[0]


def documents(count: int = 8) -> dict[bytes, str]:
    """Return permissions documents that permit one topic each, with content that S/MIME readers treat differently."""
    found: dict[bytes, str] = {}
    for number in range(count):
        topic = f"rt/document{number}"
        plain = permissions_document("CN=/talker", rule("allow", criteria("publish", [topic])))
        odd = (
            "",
            plain.replace("><", ">\n<"),
            plain.replace("><", ">  \n\t<") + "\n\n",
            plain.replace("<rule", "<rule").replace('name="grant"', 'name="\n--inner\n--inner--\n.\nFrom me\n"'),
            plain.replace("><", ">" + " " * 1015 + "\n<"),
            plain.replace('name="grant"', f'name="{"x" * (1023 - plain.splitlines()[1].index("grant"))}--inner"'),
            plain.rstrip("\n"),
            plain.replace("><", ">\n\n<").replace('name="grant"', 'name="caf\xe9"'),
        )[number % 8]
        found[(odd or plain).encode()] = topic
    return found


@dataclass(slots=True)
class Counts:
    """The result of a comparison.

    Attributes:
        counts: number of files by result.
        wrong: a line for each file that we accept, and another reader refuses or reads as something else.
    """

    counts: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


class Bench:
    """All readers, an authority, documents, and these documents signed by every tool.

    Args:
        scratch: an empty folder.
        cyclone: whether to use Cyclone DDS as well.
    """

    def __init__(self, scratch: Path, *, cyclone: bool) -> None:
        authorities = Authorities.new()
        own, topics = authorities.permissions, documents()
        self.authority = own.pem
        pairs = [(name, text) for name in SIGNERS for text in topics]
        self.genuine = [(name, SIGNERS[name](text, own.certificate, own.key), text) for name, text in pairs]
        first = next(iter(topics))
        options = (("-nodetach",), ("-nocerts",), ("-noattr",), ("-md", "sha1"), ("-binary",))
        self._odd = [by_openssl(first, own.certificate, own.key, "smime", *each) for each in options]
        self._pool = [signed for _, signed, _ in self.genuine]
        folder = authorities.enclave(scratch / "enclave", permissions=first.decode())
        command = Command(scratch, self.authority)
        self.readers: dict[str, Read] = {
            "libcrypto, later vendors": Libcrypto(self.authority, intern=False).read,
            "libcrypto, earlier vendors": Libcrypto(self.authority, intern=True).read,
            "openssl smime -verify": command.read,
        }
        if cyclone:
            self.readers["Cyclone DDS"] = Cyclone(folder, topics).read

    def by_keymint(self, signed: bytes) -> bytes | None:
        """Return the content as Keymint reads and verifies it."""
        try:
            return smime.read(signed, self.authority, where=Origin("permissions.p7s")).content
        except KeymintError:
            return None

    def mutations(self, count: int, seed: int) -> Iterator[bytes]:
        """Yield mutated files."""
        chance = Random(seed)
        for number in range(count):
            source: Sequence[bytes] = self._odd if number % 20 == 19 else self._pool
            yield mutated(chance.choice(source), self._pool, chance)

    def compare(self, count: int, seed: int, *, every: int = 1) -> Counts:
        """Compare our reader with the others.

        Args:
            count: number of mutated files.
            seed: seed of the random generator.
            every: of the files that Keymint refuses, the command and Cyclone DDS read one in ``every``; they read all
                files that Keymint accepts.
        """
        comparison = Counts()
        for number, signed in enumerate(self.mutations(count, seed)):
            content = self.by_keymint(signed)
            others: dict[str, bytes | None] = {}
            for name, read in self.readers.items():
                if content is not None or number % every == 0 or name.startswith("libcrypto"):
                    others[name] = _with_lf(read(signed))
                    comparison.counts[f"read by {name}"] += 1
            comparison.counts["files"] += 1
            comparison.counts["accepted by Keymint"] += content is not None
            some = {text for text in others.values() if text is not None}
            comparison.counts["refused by Keymint, accepted by a vendor or openssl"] += content is None and bool(some)
            comparison.counts["refused by all"] += content is None and not some
            mailed = by_email(signed)
            if some and mailed is not None and mailed not in some:
                comparison.counts["openssl and Python's email read different contents"] += 1
            others["Python's email"] = mailed
            if content is not None:
                for name, text in others.items():
                    if text != content:
                        comparison.wrong.append(
                            f"file {number} of seed {seed}: {name} reads {text!r:.200}, Keymint {content!r:.200}"
                        )
        return comparison


def _with_lf(text: bytes | None) -> bytes | None:
    return None if text is None else text.replace(b"\r\n", b"\n")
