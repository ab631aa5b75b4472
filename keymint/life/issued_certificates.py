# SPDX-License-Identifier: Apache-2.0
"""What a workspace's authorities issued, as data: who holds which certificate, and which of them are revoked."""

from __future__ import annotations

import contextlib
import functools
import zlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import field, replace
from datetime import datetime

from comarmor.values import dataclass

SUPERSEDED = "superseded"
"""The reason of a revocation after which the same key may be certified again."""
REASONS = (SUPERSEDED, "key-compromise", "retired", "affiliation-changed", "privilege-withdrawn", "unspecified")
"""Reasons of a revocation (RFC 5280, 5.3.1); ``retired`` is its cessationOfOperation."""


@dataclass(frozen=True, slots=True)
class IssuedCertificate:
    """A certificate that was issued, and the rights that were signed for it last.

    Attributes:
        issuer: fingerprint of the authority's public key (SHA-256, hexadecimal).
        serial: its serial number; unique for each issuer (RFC 5280, 4.1.2.2).
        authority: name of the authority.
        name: the package; empty if only the revocation is known.
        generation: generation of the subject name, see ADR 0029.
        not_before: begin of its validity, UTC.
        not_after: end of its validity, UTC.
        key: fingerprint of the certified public key; empty if only the revocation is known.
        rights: digest of the package's unsigned documents, which were signed last.
        revoked: when it was revoked, UTC; None if it was not.
        reason: why, one of :data:`REASONS`; empty if it was not revoked.
    """

    issuer: str
    serial: int
    authority: str
    name: str
    generation: int
    not_before: datetime
    not_after: datetime
    key: str
    rights: str = ""
    revoked: datetime | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class SignedRights:
    """A document that was signed: whoever has a certificate for its name may present it until it ends.

    Attributes:
        name: the package.
        generation: generation of the subject name, see ADR 0029.
        subject: distinguished name of the certificate, in certificate order.
        not_after: end of the rights, UTC.
        compressed: what was signed, as :func:`zlib.compress` makes it.
        accepted: when the owner accepted that it stays good beside later ones, UTC; None if that was not said.
    """

    name: str
    generation: int
    subject: str
    not_after: datetime
    compressed: bytes = field(repr=False)
    accepted: datetime | None = None

    @classmethod
    def of(cls, name: str, generation: int, subject: str, not_after: datetime, content: bytes) -> SignedRights:
        """Return the entry of a document for the register; the arguments are as the attributes."""
        return cls(name, generation, subject, not_after, zlib.compress(content, 1))

    @property
    def content(self) -> bytes:
        """What was signed.

        Raises:
            ValueError: the entry is damaged.
        """
        inflated = zlib.decompressobj()
        with contextlib.suppress(zlib.error):
            content = inflated.decompress(self.compressed, _MOST)
        if not inflated.eof:
            raise ValueError
        return content


_MOST = 64 << 20
"""Largest signed document in bytes that is read."""


@dataclass(frozen=True)
class Register:
    """All issued certificates in the order of their issue, and the number of the last revocation list of each issuer.

    Attributes:
        certificates: by issuer and serial number.
        numbers: the last number of a revocation list, by issuer (RFC 5280, 5.2.3).
        bundles: the last issue number of a bundle, by package.
        rights: the signed documents in the order of their issue.
        is_whole: it has all documents that were ever signed; else some may be missing.
    """

    certificates: Mapping[tuple[str, int], IssuedCertificate] = field(default_factory=dict)
    numbers: Mapping[str, int] = field(default_factory=dict)
    bundles: Mapping[str, int] = field(default_factory=dict)
    rights: tuple[SignedRights, ...] = ()
    is_whole: bool = True

    # -- questions -----------------------------------------------------------------------------------------------

    def of(self, name: str) -> tuple[IssuedCertificate, ...]:
        """Return the certificates of a package in the order of their issue."""
        return self._by_name.get(name, ())

    def in_force(self, name: str, at: datetime) -> tuple[IssuedCertificate, ...]:
        """Return the certificates of a package that are not revoked and do not end before a moment."""
        return tuple(each for each in self.of(name) if each.revoked is None and each.not_after >= at)

    def revoked(self, issuer: str) -> tuple[IssuedCertificate, ...]:
        """Return the revoked certificates of an issuer in the order of their issue."""
        return self._revoked.get(issuer, ())

    def is_revoked(self, issuer: str, serial: int) -> bool:
        """Tell whether a certificate is known and revoked."""
        known = self.certificates.get((issuer, serial))
        return known is not None and known.revoked is not None

    def barred(self, key: str) -> str:
        """Return why a key must not be certified again, or an empty text.

        Args:
            key: fingerprint of the public key.
        """
        return self._barred.get(key, "")

    def withdrawn(self, name: str) -> str:
        """Return why a package has no certificate any more, or an empty text if it has one or never had any."""
        last = self.of(name)[-1:]
        return next((each.reason for each in last if each.revoked and each.reason != SUPERSEDED), "")

    def generation(self, name: str) -> int:
        """Return the lowest generation that may be issued to a package: one after the last that was revoked."""
        return max((each.generation + 1 if each.revoked else each.generation for each in self.of(name)), default=0)

    @functools.cached_property
    def _by_name(self) -> Mapping[str, tuple[IssuedCertificate, ...]]:
        return _grouped((each.name, each) for each in self.certificates.values())

    @functools.cached_property
    def _revoked(self) -> Mapping[str, tuple[IssuedCertificate, ...]]:
        return _grouped((each.issuer, each) for each in self.certificates.values() if each.revoked)

    @functools.cached_property
    def _barred(self) -> Mapping[str, str]:
        revoked = (each for each in self.certificates.values() if each.revoked and each.reason != SUPERSEDED)
        return {each.key: each.reason for each in revoked if each.key}

    # -- changes -------------------------------------------------------------------------------------------------

    def with_issued(self, issued: Iterable[IssuedCertificate]) -> Register:
        """Return the register with more certificates; what is known of a certificate's revocation stays."""
        certificates = dict(self.certificates)
        for each in issued:
            known = certificates.get((each.issuer, each.serial))
            new = replace(each, revoked=known.revoked, reason=known.reason) if known and known.revoked else each
            certificates[each.issuer, each.serial] = new
        return replace(self, certificates=certificates)

    def with_revoked(self, revoked: Collection[IssuedCertificate], reason: str, at: datetime) -> Register:
        """Return the register after the revocation of some of its certificates; one that is revoked stays as it is.

        Args:
            revoked: the certificates.
            reason: one of :data:`REASONS`.
            at: when, UTC.
        """
        certificates = dict(self.certificates)
        for each in revoked:
            if each.revoked is None:
                certificates[each.issuer, each.serial] = replace(each, revoked=at, reason=reason)
        return replace(self, certificates=certificates)

    def with_rights(self, signed: Iterable[SignedRights]) -> Register:
        """Return the register with more signed documents; one that has ended stays, as the clock may be wrong."""
        known = {each.compressed for each in self.rights}
        return replace(self, rights=(*self.rights, *(each for each in signed if each.compressed not in known)))

    def with_accepted(self, names: Collection[str], at: datetime) -> Register:
        """Return the register after its owner accepted that earlier rights of some packages stay good.

        Args:
            names: the packages.
            at: when, UTC.
        """
        rights = (
            replace(each, accepted=at) if each.name in names and not each.accepted else each for each in self.rights
        )
        return replace(self, rights=tuple(rights))

    def with_number(self, issuer: str, number: int) -> Register:
        """Return the register after the issue of a revocation list; a number never goes back."""
        return replace(self, numbers={**self.numbers, issuer: max(number, self.numbers.get(issuer, 0))})

    def with_bundle(self, name: str, at: datetime) -> Register:
        """Return the register after the issue of a bundle, whose number is that of ``bundles``.

        Numbers are at least the seconds since 1970, so that they rise also after the register was lost.

        Args:
            name: the package.
            at: the clock, UTC.
        """
        return replace(self, bundles={**self.bundles, name: max(self.bundles.get(name, 0) + 1, int(at.timestamp()))})


def _grouped(pairs: Iterable[tuple[str, IssuedCertificate]]) -> Mapping[str, tuple[IssuedCertificate, ...]]:
    groups: dict[str, list[IssuedCertificate]] = {}
    for key, each in pairs:
        groups.setdefault(key, []).append(each)
    return {key: tuple(group) for key, group in groups.items()}
