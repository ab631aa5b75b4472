# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: findings on an installed enclave, from its files."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache

from comarmor.errors import Diagnostic, Severity
from keymint.api import Inspection
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime
from keymint_ros2_dds import authority_roles as roles
from keymint_ros2_dds import check_governance, subject_name_text, token_key, vendor_limits
from keymint_ros2_dds.credentials import CredentialCheck, revocation_period, subject_of
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import in_words, uncovered
from keymint_ros2_dds.emission import is_form_of
from keymint_ros2_dds.enclave_layout import (
    CERTIFICATE,
    CRL,
    GOVERNANCE,
    KEY,
    KEY_URI,
    PERMISSIONS,
    PERMISSIONS_P7S,
    PERMISSIONS_XML,
    enclave_files,
)
from keymint_ros2_dds.reading import dates, signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument, as_ranges

SLACK = timedelta(days=1)
"""Fast DDS reads dates in the host's time zone, so a period must begin a day earlier and end a day later."""


_DROPPED = (
    "then running participants of Cyclone DDS drop it within a second and report nothing, those of Fast DDS 2.9 go on, "
    "and neither connects again"
)
_AT_THE_END = {
    "certificate": _DROPPED,
    "grant": _DROPPED,
    "revocation list": "then running participants refuse every new peer, and none starts",
}
"""What vendors do at the end of a period; ``tests/real/test_keystore_life.py`` measures it."""
_UTC = "let its nodes run with TZ=UTC, or give it a validity of ten days or more"


def check(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on one installed enclave; codes are stable."""
    return tuple(_EnclaveCheck(inspection).findings())


class _EnclaveCheck(CredentialCheck):
    """One enclave under inspection."""

    def __init__(self, inspection: Inspection) -> None:
        package = inspection.package
        restore = f"'keymint install {package.name}' writes it again"
        super().__init__(inspection.files, inspection.folder, restore, package.subject)
        self._inspection = inspection
        self._names = enclave_files(inspection.layout, package.distro)

    def findings(self) -> Iterator[Diagnostic]:
        yield from self._inventory()
        yield from self._identity()
        yield from self._revocations()
        content = yield from self._signed(PERMISSIONS)
        governance = yield from self._signed(GOVERNANCE)
        if content is not None:
            permissions = signed_permissions.read(content)
            yield from self._grants(permissions)
            if governance is not None:
                yield from self._domains(permissions, signed_governance.read(governance))
        if governance is not None:
            yield from check_governance.findings(self._inspection)
        plain = self._files.get(PERMISSIONS_XML)
        signed = self._content(PERMISSIONS) if content is None else content
        if plain is not None and PERMISSIONS_XML in self._names and plain != signed:
            yield self._error("document-differs", PERMISSIONS_XML, "is not the document that permissions.p7s signs")

    def _warning(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        return Diagnostic.warning(code, message, self._where(name), help_, self._subject)

    def _inventory(self) -> Iterator[Diagnostic]:
        key = self._inspection.package.identity.key
        if key.uri and not token_key.is_uri(self._files.get(KEY_URI), key.uri):
            problem = "is not the URI of the sources" if KEY_URI in self._files else "is missing"
            yield self._error("key-uri", KEY_URI, problem)
        elif not key.uri and KEY_URI in self._files:
            message = f"replaces {KEY} where Fast DDS runs, although the key of the sources lies in a file"
            yield self._error("key-uri", KEY_URI, message, "remove it")
        for name in self._names:
            if name not in self._files and not (name == KEY and self._inspection.package.issuance.public_key):
                yield self._error("file-missing", name, "is missing")

    def _revocations(self) -> Iterator[Diagnostic]:
        if period := revocation_period(self._files.get(CRL, b"")):
            yield from self._validity("revocation list", CRL, *period, slack=timedelta(0))

    def _identity(self) -> Iterator[Diagnostic]:
        pem = self._files.get(CERTIFICATE, b"")
        try:
            period = certificates.period(certificates.load(pem))
        except KeymintError:
            return  # reported with the chain
        if not certificates.is_canonical(pem):
            yield self._altered(CERTIFICATE, "is not the canonical encoding of its certificate")
        yield from self._validity("certificate", CERTIFICATE, *period, slack=timedelta(0))
        if KEY in self._files and not keys.is_canonical(self._files[KEY]):
            yield self._altered(KEY, "is not the canonical encoding of a private key")

    def _altered(self, name: str, message: str) -> Diagnostic:
        """Return the finding on a file in another form than Keymint writes; other tools write other forms."""
        found = self._error("pem-altered", name, message)
        if not self._inspection.package.issuance.certificate:
            return found
        return replace(found, severity=Severity.NOTE, help="another tool wrote it, and it is kept as it is")

    def _content(self, kind: str) -> bytes | None:
        try:
            return smime.signed_content(self._files.get(f"{kind}.p7s", b""))
        except KeymintError:
            return None

    def _signed(self, kind: str) -> Generator[Diagnostic, None, bytes | None]:
        """Check a signed document; the generator returns its content if it is verified and valid, else None."""
        name = f"{kind}.p7s"
        signed = self._files.get(name)
        if signed is None:
            return None
        where = self._where(name)
        try:
            content = smime.verify(signed, self._inspection.chains[roles.PERMISSIONS], where=where)
        except KeymintError:
            return None  # reported with the trust anchors
        yield from map(self._for_subject, vendor_limits.check_size(len(signed), kind, self._inspection.package))
        if not self._as_built(kind, content):
            package = self._inspection.package.name
            message = f"the sources build another {kind} document: they changed, or the built one was edited by hand"
            help_ = f"'keymint build -f {package}' and 'keymint install {package}' write the document of the sources"
            yield self._warning("drift", name, message, help_)
        if _is_sound(content, kind):
            return content
        try:
            root = dds_xml.read(content, kind, str(where))
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
            return None
        for hazard in dds_xml.hazards(content, root):
            yield self._warning("document-hazard", name, hazard, f"build it instead of editing it; {self._restore}")
        return content

    def _as_built(self, kind: str, content: bytes) -> bool:
        """Tell whether a document is what the sources build, for permissions in any form with the same meaning."""
        built = self._inspection.documents.get(f"{kind}.xml")
        if content == built:
            return True
        if kind != PERMISSIONS or built is None:
            return False
        try:
            return is_form_of(self._inspection.package, content)
        except KeymintError:
            return False

    def _grants(self, document: PermissionsDocument) -> Iterator[Diagnostic]:
        if len(document.grants) != 1:
            message = f"has {len(document.grants)} grants; vendors choose among several in different ways"
            yield self._warning("grant-count", PERMISSIONS_P7S, message, "keep one grant")
        grant = document.grants[0]
        expected = self._certificate_subject()
        if expected is not None and grant.subject_name != expected:
            message = f"grants to {grant.subject_name!r}, but the certificate is for {expected!r}"
            yield self._error("grant-subject", PERMISSIONS_P7S, message)
        if grant.allows:
            message = "allows by default on Cyclone DDS and OpenDDS, and denies on Fast DDS"
            yield self._error("grant-default", PERMISSIONS_P7S, message, "make the default DENY")
        begin, end = dates.standard(grant.not_before), dates.standard(grant.not_after)
        if begin is not None and end is not None:
            yield from self._validity("grant", PERMISSIONS_P7S, begin, end, slack=SLACK)

    def _certificate_subject(self) -> str | None:
        try:
            return subject_name_text.render(subject_of(self._files.get(CERTIFICATE, b"")))
        except KeymintError:
            return None

    def _validity(
        self, what: str, name: str, begin: datetime, end: datetime, *, slack: timedelta
    ) -> Iterator[Diagnostic]:
        now = self._inspection.now
        code = what.replace(" ", "-")
        verb = "crl --refresh" if name == CRL else f"renew {self._inspection.package.name}"
        again = f"'keymint {verb}' issues it again"
        renew = again if name == CRL else f"{again}, with later dates"
        if now > end:
            yield self._error(f"{code}-expired", name, f"the {what} expired on {_shown(end)}", renew)
        elif now < begin:
            message = f"the {what} is not valid before {_shown(begin)}"
            later = f"compare the clock of this machine; if it is right, {again}"
            yield self._error(f"{code}-not-yet-valid", name, message, later)
        elif now + timedelta(days=self._inspection.within_days) >= end:
            yield self._warning(
                f"{code}-expires", name, f"the {what} expires on {_shown(end)}; {_AT_THE_END[what]}", renew
            )
        elif now + slack >= end or now - slack < begin:
            message = (
                f"the {what} is valid from {_shown(begin)} to {_shown(end)}, which is within a day of now: Fast DDS "
                "reads these dates in its host's time zone"
            )
            is_renewable = now - slack >= begin and end - begin > 2 * slack
            yield self._warning(f"{code}-slack", name, message, renew if is_renewable else _UTC)

    def _domains(self, permissions: PermissionsDocument, governance: GovernanceDocument) -> Iterator[Diagnostic]:
        governed = as_ranges(each for rule in governance.domain_rules for each in rule.domains)
        granted = as_ranges(each for grant in permissions.grants for rule in grant.rules for each in rule.domains)
        for item in uncovered(sorted(set(granted)), governed):
            yield self._error(
                "domain-uncovered", PERMISSIONS_P7S, f"grants in {in_words([item])}, which the governance lacks",
                "add the domain to a domain rule of the governance",
            )  # fmt: skip


@lru_cache(maxsize=16)
def _is_sound(content: bytes, kind: str) -> bool:
    """Tell whether a document is valid, and no vendor misreads it; most enclaves have the same governance."""
    if kind == PERMISSIONS:
        return signed_permissions.is_plain(content)
    try:
        return not any(dds_xml.hazards(content, dds_xml.read(content, kind, kind)))
    except KeymintError:
        return False


def _shown(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"
