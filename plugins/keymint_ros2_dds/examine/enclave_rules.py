# SPDX-License-Identifier: Apache-2.0
"""The rules about the files of one enclave, each in one place.

A view asks some of them and says what an answer weighs: ``keymint check`` (:mod:`~keymint_ros2_dds.examine.check`),
proofs (:func:`differences`) and ``keymint adopt`` (:mod:`~keymint_ros2_dds.examine.adopted_enclave`), which compares
a keystore of another tool with the authorities that it has itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime, timedelta
from functools import cached_property
from typing import Generic, TypeVar

from comarmor.text import hexadecimal
from comarmor.values import Data
from keymint.api import EnclaveFiles, TrustAnchors
from keymint.errors import Defects, Diagnostic, KeymintError
from keymint.pki import certificates, keys, revocation_lists, smime
from keymint.pki.examine import IdentityCheck, When, anchor_defects, utc_time
from keymint.pki.smime import SignedDocument
from keymint_ros2_dds import enclave_layout as layout, subject_names, vendor_limits
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.domains import in_words, merged_domains, uncovered_domains
from keymint_ros2_dds.reading import signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, PermissionsDocument, as_ranges

_REPLACEABLE = (layout.IDENTITY_CA, layout.PERMISSIONS_CA, layout.CERTIFICATE, layout.KEY)
IN_PLACE_OF = {f"{name.removesuffix('.pem')}.p11": name for name in _REPLACEABLE}
"""A file with a PKCS #11 URI that ROS 2 reads in place of another one, where the vendor takes such URIs.

Source: ``get_security_files`` in ``security.cpp`` of rmw_dds_common, from Jazzy on, as rmw_fastrtps calls it.
"""
AUTHORITY_FILES = {layout.IDENTITY_ROLE: layout.IDENTITY_CA, layout.PERMISSIONS_ROLE: layout.PERMISSIONS_CA}
"""The file of the authority that has a role; in the flat layout it may be one for both."""
Document = TypeVar("Document", PermissionsDocument, GovernanceDocument)
_SLACK = timedelta(days=1)
"""Fast DDS reads dates in the host's time zone, so a period must begin a day earlier and end a day later."""
_DROPPED = (
    "then running participants of Cyclone DDS drop it within a second and report nothing, those of Fast DDS 2.9 go on, "
    "and neither connects again"
)
"""What vendors do at the end of a period; ``tests/real/test_keystore_life.py`` measures it."""
_NONE_STARTS = "then running participants refuse every new peer, and none starts"
"""What they do at the end of a revocation list; measured there as well."""
_UTC = "let its nodes run with TZ=UTC, or give it a validity of ten days or more"


def differences(enclave: EnclaveFiles) -> tuple[Diagnostic, ...]:
    """Compare the trust anchors of an enclave with the authorities of the workspace.

    Vendors trust the authorities in the enclave. If someone else issued all its files, they are consistent with each
    other, so only a comparison with the workspace detects it. See :meth:`keymint.api.Prover.differences`.
    """
    anchors = enclave.anchors
    if missing := tuple(anchor_defects(anchors.authorities[role] for role in AUTHORITY_FILES)):
        return missing
    # Nobody but people read the unsigned permissions.
    unneeded = {layout.PERMISSIONS_XML, *([layout.KEY] if anchors.public_key or anchors.key_uri else [])}
    needed = [each for each in layout.enclave_files(anchors.layout, anchors.distro) if each not in unneeded]
    chains = {role: each.chain for role, each in anchors.authorities.items()}
    rules = EnclaveRules(enclave.files, enclave.folder, "'keymint install' restores it", "", chains)
    # An encrypted key cannot be read without its password, so it is not compared with the certificate.
    return tuple(each for each in rules.trust(anchors, needed) if each.code != "key-password")


class SignedFact(Data, Generic[Document]):
    """A signed document of an enclave, read once for all rules and views.

    Attributes:
        signed: what is signed; None if the file is missing, or its signature does not verify.
        document: what it says; None if it cannot be read.
        defects: why it cannot be read, or what its schema does not allow.
    """

    signed: SignedDocument | None = None
    document: Document | None = None
    defects: tuple[Diagnostic, ...] = ()

    @property
    def sound(self) -> Document | None:
        """What it says, if its schema allows that."""
        return None if self.defects else self.document


class EnclaveRules(IdentityCheck):
    """The rules about the files of one enclave.

    Args:
        files: the enclave's files by name.
        folder: its folder as the user would type it.
        restore: help for a file that has to be written again.
        subject: the subject of the findings, if they name it.
        chains: the authorities that its certificate and its documents are verified with, PEM by role; empty bytes for
            one that is missing.
    """

    def __init__(
        self, files: Mapping[str, bytes], folder: str, restore: str, subject: str, chains: Mapping[str, bytes]
    ) -> None:
        super().__init__(files, folder, restore, subject)
        self._chains = chains

    # -- facts ---------------------------------------------------------------------------------------------------

    @cached_property
    def permissions(self) -> SignedFact[PermissionsDocument]:
        """The permissions."""
        return self._signed(layout.PERMISSIONS_P7S, signed_permissions.read)

    @cached_property
    def governance(self) -> SignedFact[GovernanceDocument]:
        """The governance."""
        return self._signed(layout.GOVERNANCE_P7S, signed_governance.read)

    def _signed(self, name: str, reader: Callable[[bytes, str, int], Document]) -> SignedFact[Document]:
        try:
            signed = smime.read(self._files.get(name, b""), self._chains[layout.PERMISSIONS_ROLE])
        except KeymintError:
            return SignedFact()  # reported with the authorities
        unread, file = Defects(), self._where(name).file
        document = unread.attempt(lambda: reader(signed.content, file, signed.lines_before))
        defects = document.defects if document else unread.found
        return SignedFact(signed, document, tuple(map(self._for_subject, defects)))

    @cached_property
    def _list_problem(self) -> str:
        """Why vendors refuse a participant with the revocation list, dates and what it revokes aside."""
        if layout.CRL not in self._files:
            return ""
        try:
            issuer = certificates.load_bundle(self._chains[layout.IDENTITY_ROLE])[0]
        except KeymintError:
            return ""  # reported with the authorities
        return revocation_lists.problem(self._files[layout.CRL], issuer)

    @cached_property
    def revocation(self) -> revocation_lists.Revocation | None:
        """The entry of the certificate in the list beside it, which its issuer signed."""
        crl = revocation_lists.first(self._files.get(layout.CRL, b""))
        if crl is None or self.certificate is None or self._list_problem:
            return None
        return revocation_lists.entry(crl, self.certificate.serial_number)

    # -- what the authorities vouch for --------------------------------------------------------------------------

    def trust(self, anchors: TrustAnchors, needed: Iterable[str]) -> Iterator[Diagnostic]:
        """Yield the findings on the files with which vendors decide whom to trust.

        Args:
            anchors: what the enclave must rest on; its certificate may have any name if they have none.
            needed: names of the files that it must have.
        """
        own_uri = self._files.get(layout.KEY_URI)
        known = {layout.KEY_URI} if vendor_limits.is_key_uri(own_uri, anchors.key_uri) else set()
        for name in sorted(self._files.keys() & IN_PLACE_OF.keys() - known):
            what = f"replaces {IN_PLACE_OF[name]} in ROS 2 Jazzy and later"
            yield self._error("file-replaced", name, f"{what}, and Keymint cannot check what it refers to", "remove it")
        yield from self.inventory(needed)
        yield from self.revocation_list()
        for role, name in (*AUTHORITY_FILES.items(), (layout.PERMISSIONS_ROLE, layout.CA)):
            if role in anchors.authorities:  # also where the layout does not have the file
                yield from self.anchored(name, anchors.authorities[role])
        yield from self.identity(self._chains[layout.IDENTITY_ROLE], anchors)
        unsigned, signer = Defects(), self._chains[layout.PERMISSIONS_ROLE]
        for name in (layout.PERMISSIONS_P7S, layout.GOVERNANCE_P7S):
            if name in self._files and signer:
                with unsigned:
                    smime.read(self._files[name], signer, where=self._where(name))
        yield from unsigned.found

    def revocation_list(self) -> Iterator[Diagnostic]:
        """Yield an error if vendors refuse a participant with the revocation list of the enclave, dates aside."""
        problem, found = self._list_problem, self.revocation
        help_ = "remove it, or replace it with a list by the certificate's issuer"
        if found:
            help_ = "the list is right: remove the enclave, and 'keymint renew --rekey' makes a new key and certificate"
            when = f"serial number {hexadecimal(found.serial)}, since {found.at:%Y-%m-%d} ({found.reason})"
            problem = f"revokes the certificate beside it, {when}"
        if problem:
            yield self._error("revocation-list", layout.CRL, f"{problem}: vendors refuse the participant", help_)

    # -- what it says --------------------------------------------------------------------------------------------

    def encoding(self, name: str) -> Iterator[Diagnostic]:
        """Yield an error if the certificate or the key is in another form than Keymint writes."""
        is_canonical, what = certificates.is_canonical, "its certificate"
        if name == layout.KEY:
            is_canonical, what = keys.is_canonical, "a private key"
        if name in self._files and self.certificate is not None and not is_canonical(self._files[name]):
            yield self._error("pem-altered", name, f"is not the canonical encoding of {what}")

    def name(self) -> Iterator[Diagnostic]:
        """Yield a warning if vendors confuse the name of the certificate with others."""
        if self.certificate is not None and (confused := subject_names.twice(self.certificate.subject)):
            help_ = "let its authority issue names with each attribute once, e.g. one CN and one OU"
            yield self._warning("names-confused", layout.CERTIFICATE, confused, help_)

    def periods(self, when: When) -> Iterator[Diagnostic]:
        """Yield the findings on the dates of the certificate and of the revocation list."""
        yield from self.certificate_period(when, _DROPPED)
        if period := revocation_lists.period_in(self._files.get(layout.CRL, b"")):
            yield from self._period("revocation list", layout.CRL, period, when, "keymint crl --refresh", _NONE_STARTS)

    def documents(
        self, permissions: PermissionsDocument | None, governance: GovernanceDocument | None, when: When
    ) -> Iterator[Diagnostic]:
        """Yield the findings on what the signed documents say.

        Args:
            permissions: the signed permissions, if they can be read.
            governance: the signed governance, if it can be read.
            when: the clock, and within which time an end is reported.
        """
        if permissions is None:
            return
        if len(permissions.grants) != 1:
            message = f"has {len(permissions.grants)} grants; vendors choose among several in different ways"
            yield self._warning("grant-count", layout.PERMISSIONS_P7S, message, "keep one grant")
        for grant in permissions.grants:
            yield from self._grant(grant, when)
        if governance is not None:
            governed = merged_domains(as_ranges(each for rule in governance.domain_rules for each in rule.domains))
            granted = as_ranges(each for grant in permissions.grants for rule in grant.rules for each in rule.domains)
            if lacking := uncovered_domains(merged_domains(granted), governed):
                message = f"grants in {in_words(lacking)}, but the governance is for {in_words(governed)}"
                help_ = "add the domain to a domain rule of the governance"
                yield self._error("domain-uncovered", layout.PERMISSIONS_P7S, message, help_)

    def _grant(self, grant: DocumentGrant, when: When) -> Iterator[Diagnostic]:
        name = subject_names.of_any(self.certificate.subject) if self.certificate else grant.subject_name
        if grant.subject_name != name:
            message = f"grants to {grant.subject_name!r}, but the certificate is for {name!r}"
            yield self._error("grant-subject", layout.PERMISSIONS_P7S, message)
        if grant.allows:
            message = "allows by default on Cyclone DDS and OpenDDS, and denies on Fast DDS"
            yield self._error("grant-default", layout.PERMISSIONS_P7S, message, "make the default DENY")
        if period := STANDARD.period(grant):
            found = tuple(self._period("grant", layout.PERMISSIONS_P7S, period, when, self._renew, _DROPPED))
            yield from found or self._in_slack(period, when[0])
        else:
            message = f"its dates are {grant.not_before!r} and {grant.not_after!r}, expected two xs:dateTime in order"
            yield self._error("grant-never-valid", layout.PERMISSIONS_P7S, message, "sign a document with valid dates")

    def plain_text(self, signed: bytes | None) -> Iterator[Diagnostic]:
        """Yield an error if the unsigned permissions are others than those that participants read."""
        if self._files.get(layout.PERMISSIONS_XML, signed) != signed:
            message = "is not the document that permissions.p7s signs"
            yield self._error("document-differs", layout.PERMISSIONS_XML, message)

    def _in_slack(self, period: tuple[datetime, datetime], now: datetime) -> Iterator[Diagnostic]:
        """Yield a warning about dates of a grant that are in force here, but not in every time zone."""
        begin, end = period
        if now + _SLACK >= end or now - _SLACK < begin:
            message = (
                f"the grant is valid from {utc_time(begin)} to {utc_time(end)}, which is within a day of now: Fast DDS "
                "reads these dates in its host's time zone"
            )
            is_renewable = now - _SLACK >= begin and end - begin > 2 * _SLACK
            help_ = f"'{self._renew}' issues it again, with later dates" if is_renewable else _UTC
            yield self._warning("grant-slack", layout.PERMISSIONS_P7S, message, help_)
