# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: findings on installed enclaves, from their files and their sources; codes are stable."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import timedelta

from comarmor.patterns.decision_lists import SearchBudget
from comarmor.patterns.tokens import PatternError
from comarmor.values import replace
from keymint.api import Inspection
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.pki import certificates, distinguished_names, smime
from keymint_ros2_dds import enclave_layout as layout, governance_warnings, vendor_limits
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.examine.enclave_rules import Document, EnclaveRules, SignedFact
from keymint_ros2_dds.keystores.foreign_documents import not_kept
from keymint_ros2_dds.proving.enclave_governance import STRICT, EnclaveGovernance, Weaker, cuts, weaker
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.subject_names import parts


def check(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on one installed enclave.

    What the workspace's authorities vouch for is asked apart
    (:func:`~keymint_ros2_dds.examine.enclave_rules.differences`).
    """
    return tuple(_InstalledEnclave(inspection).findings())


def check_all(inspections: Sequence[Inspection]) -> tuple[Diagnostic, ...]:
    """Return findings that concern several enclaves."""
    return (*_shared_grants(inspections), *_shared_authorities(inspections), *_different_authorities(inspections))


class _InstalledEnclave(EnclaveRules):
    """One enclave under inspection."""

    def __init__(self, inspection: Inspection) -> None:
        package = inspection.package
        restore = f"'keymint install {package.name}' writes it again"
        super().__init__(inspection.files, inspection.folder, restore, package.subject, inspection.chains)
        self._inspection = inspection

    def findings(self) -> Iterator[Diagnostic]:
        inspection = self._inspection
        when = inspection.now, timedelta(days=inspection.within_days)
        names = layout.enclave_files(inspection.layout, inspection.package.distro)
        elsewhere = [layout.KEY] if inspection.package.issuance.public_key else []
        yield from self._key_uri()
        yield from self.inventory(name for name in names if name not in elsewhere)
        for altered in (*self.encoding(layout.CERTIFICATE), *self.encoding(layout.KEY)):
            kept = replace(altered, severity=Severity.NOTE, help="another tool wrote it, and it is kept as it is")
            yield kept if inspection.package.issuance.certificate else altered
        yield from self.name()
        yield from self.periods(when)
        yield from self._document(layout.PERMISSIONS, self.permissions)
        yield from self._document(layout.GOVERNANCE, self.governance)
        yield from self.documents(self.permissions.sound, self.governance.sound, when)
        if self.governance.sound:
            yield from self._governance()
        if layout.PERMISSIONS_XML in names:
            signed = self.permissions.signed.content if self.permissions.signed else None
            with suppress(KeymintError):  # whoever signed it
                signed = signed or smime.signed_content(self._files.get(layout.PERMISSIONS_P7S, b""))
            yield from self.plain_text(signed)

    def _key_uri(self) -> Iterator[Diagnostic]:
        uri = self._inspection.package.identity.key.uri
        if uri and not vendor_limits.is_key_uri(self._files.get(layout.KEY_URI), uri):
            problem = "is not the URI of the sources" if layout.KEY_URI in self._files else "is missing"
            yield self._error("key-uri", layout.KEY_URI, problem)
        elif not uri and layout.KEY_URI in self._files:
            message = f"replaces {layout.KEY} where Fast DDS runs, although the key of the sources lies in a file"
            yield self._error("key-uri", layout.KEY_URI, message, "remove it")

    def _document(self, kind: str, fact: SignedFact[Document]) -> Iterator[Diagnostic]:
        """Yield what vendors cannot read of a signed document, and that it is not the one of the sources."""
        name, package = f"{kind}.p7s", self._inspection.package
        if fact.signed is None:
            return  # reported with the trust anchors
        content, built = fact.signed.content, self._inspection.documents.get(f"{kind}.xml")
        is_permissions = kind == layout.PERMISSIONS
        yield from map(self._for_subject, vendor_limits.check_size(len(self._files[name]), kind, package))
        # Permissions may have any form with the same meaning. What vendors read differently is a proof's to find.
        may_differ = is_permissions and built is not None
        if content != built and (not may_differ or not_kept(package, layout.PERMISSIONS_XML, content)):
            message = f"the sources build another {kind} document: they changed, or the built one was edited by hand"
            again = f"'keymint build -f {package.name}' and 'keymint install {package.name}'"
            yield self._warning("drift", name, message, f"{again} write the document of the sources")
        yield from fact.defects
        # What Keymint writes is known to have none.
        plain = is_permissions and signed_permissions.is_plain(content)
        for hazard in () if plain or not fact.sound else dds_xml.hazards(content):
            yield self._warning("document-hazard", name, hazard, f"build it instead of editing it; {self._restore}")

    def _governance(self) -> Iterator[Diagnostic]:
        """Yield findings on what the sources leave open, and on what the signed governance protects less."""
        package = self._inspection.package
        for finding in governance_warnings.findings(package):
            if finding.severity is Severity.WARNING and finding.code != governance_warnings.UNPROTECTED:
                yield finding
        if signed := self.governance.signed:
            place = self._where(layout.GOVERNANCE_P7S).file, signed.lines_before
            governing = EnclaveGovernance(signed.content, place, package)
            if governing.differs:
                yield from dict.fromkeys(self._weaker_protection(governing))

    def _weaker_protection(self, governing: EnclaveGovernance) -> Iterator[Diagnostic]:
        subject, document = self._subject, governing.document
        help_ = f"'keymint install {self._inspection.package.name}' signs what the sources build"

        def finding(code: str, message: str, line: int) -> Diagnostic:
            return Diagnostic.error(code, message, document.place(line), help_, subject)

        for domains in cuts(governing.domains()):
            rule = document.rule(domains.first)
            if rule is None:
                continue
            expected = governing.source_rule(domains.first) or STRICT
            try:
                results = list(weaker(rule, expected, STANDARD, SearchBudget(governance_warnings.STATES), access=True))
            except PatternError as error:
                yield finding("governance-unread", str(error), rule.line)
                continue
            for result in results:
                if isinstance(result, Weaker):
                    scope = f" for {result.topic!r}" if result.topic else ""
                    message = f"{result.tag} is {result.text}{scope}, but the sources require {result.required}"
                    yield finding("governance-weaker", message, result.line)
                else:
                    message = f"whether it protects as much as the sources is unknown: {result.reason}"
                    yield finding("governance-unknown", message, rule.line)


def _shared_grants(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    """Yield a finding for each identity that may use the permissions of another one on Cyclone DDS.

    It requires only that every part of the identity's name occurs in the grant's. So ``CN=/robot`` may use the grant
    of ``CN=/robot/camera``, which every peer receives in a handshake.
    """
    subjects = [(inspection, name, parts(name)) for inspection in inspections if (name := _subject(inspection))]
    holders: dict[str, set[int]] = defaultdict(set)
    for number, (_, _, tokens) in enumerate(subjects):
        for token in tokens:
            holders[token].add(number)
    for number, (inspection, name, tokens) in enumerate(subjects):
        for other in sorted(set.intersection(*(holders[token] for token in tokens)) - {number}):
            granted = subjects[other][0].package.subject
            message = f"on Cyclone DDS the identity {name!r} can use the permissions of {granted}"
            where = Origin(f"{inspection.folder}/{layout.CERTIFICATE}")
            help_ = "give each subject_name an RDN that no other has, e.g. OU={unique}"
            yield Diagnostic.warning("names-confused", message, where, help_, inspection.package.subject)


def _subject(inspection: Inspection) -> str:
    certificate = certificates.certificate_in(inspection.files.get(layout.CERTIFICATE))
    return distinguished_names.to_text(certificate.subject) if certificate else ""


def _shared_authorities(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    """Yield one finding for each authority that both issues identities and signs permissions."""
    reported: set[bytes] = set()
    for inspection in inspections:
        authority = inspection.chains[layout.PERMISSIONS_ROLE]
        if authority and authority == inspection.chains[layout.IDENTITY_ROLE] and authority not in reported:
            reported.add(authority)
            # Where enclaves have no file for a second authority, the user cannot act on it.
            one = layout.has_one_authority(inspection.layout, inspection.package.distro)
            severity = Severity.NOTE if one else Severity.WARNING
            message = (
                f"the authority {inspection.package.grant.issuer!r} issues identities and signs permissions: on "
                "older releases of DDS implementations an identity can sign permissions for itself (CVE-2023-24010)"
            )
            where, subject = Origin(f"{inspection.folder}/{layout.CERTIFICATE}"), inspection.package.subject
            yield Diagnostic("authority-shared", severity, message, where, "use two authorities", subject)


def _different_authorities(inspections: Sequence[Inspection]) -> Iterator[Diagnostic]:
    """Yield a finding for each enclave with another permissions authority; Fast DDS requires one for all."""
    for inspection in inspections[1:]:
        first = inspections[0]
        if inspection.chains[layout.PERMISSIONS_ROLE] != first.chains[layout.PERMISSIONS_ROLE]:
            message = (
                f"its permissions are signed by {inspection.package.grant.issuer!r}, those of "
                f"{first.package.subject} by {first.package.grant.issuer!r}: on Fast DDS they cannot communicate"
            )
            where, help_ = Origin(inspection.folder), "sign all permissions by one authority"
            yield Diagnostic.warning("authorities-differ", message, where, help_, inspection.package.subject)
