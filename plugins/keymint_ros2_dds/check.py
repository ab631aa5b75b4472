"""``keymint check``: what can be said of an installed enclave by looking at its files."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from datetime import UTC, datetime, timedelta

from cryptography import x509
from lxml import etree

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import DomainRange, Inspection
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, names, smime, verify
from keymint_ros2_dds import check_governance, revocation, vendor_limits
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import in_words, uncovered
from keymint_ros2_dds.emission import is_form_of
from keymint_ros2_dds.layout import (
    CA,
    CERTIFICATE,
    CRL,
    FILES,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    PERMISSIONS,
    PERMISSIONS_CA,
    PERMISSIONS_P7S,
    PERMISSIONS_XML,
)

SLACK = timedelta(days=1)
"""Fast DDS reads dates in the host's time zone; so a period must reach a day beyond the time it is needed for."""


def check(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on one installed enclave; every code is stable."""
    return tuple(_Enclave(inspection).findings())


class _Enclave:
    """One enclave under inspection."""

    def __init__(self, inspection: Inspection) -> None:
        self._seen = inspection
        self._files = inspection.files
        self._names = FILES.get(inspection.layout, ())

    def findings(self) -> Iterator[Diagnostic]:
        yield from self._inventory()
        yield from self._identity()
        yield from self._revocations()
        yield from self._authorities()
        permissions = yield from self._signed(PERMISSIONS)
        governance = yield from self._signed(GOVERNANCE)
        if permissions is not None:
            yield from self._grant(permissions)
            if governance is not None:
                yield from self._domains(permissions, governance)
        if governance is not None:
            yield from check_governance.findings(self._seen)
        plain = self._files.get(PERMISSIONS_XML)
        if plain is not None and PERMISSIONS_XML in self._names and plain != self._content(PERMISSIONS):
            yield self._error(
                "document-differs", PERMISSIONS_XML, "is not the document that permissions.p7s signs", self._again
            )

    @property
    def _again(self) -> str:
        return f"'keymint install {self._seen.package.name}' writes it anew"

    def _where(self, name: str) -> Origin:
        return Origin(f"{self._seen.folder}/{name}")

    def _error(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        return Diagnostic(code, Severity.ERROR, message, self._where(name), help_, self._seen.package.subject)

    def _warning(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        return Diagnostic(code, Severity.WARNING, message, self._where(name), help_, self._seen.package.subject)

    def _for_subject(self, found: Diagnostic) -> Diagnostic:
        where = found.where or self._where("")
        return Diagnostic(found.code, found.severity, found.message, where, found.help, self._seen.package.subject)

    def _inventory(self) -> Iterator[Diagnostic]:
        for name in self._names:
            if name not in self._files:
                yield self._error("file-missing", name, "is missing", self._again)
        for name in sorted(self._files.keys() - {*self._names, CRL}):
            message = f"does not belong to the layout {self._seen.layout!r}"
            yield self._warning("file-unexpected", name, message, "remove it")

    def _revocations(self) -> Iterator[Diagnostic]:
        """Judge the revocation list, which is the user's to put there."""
        pem = self._files.get(CRL)
        if pem is None:
            return
        if problem := revocation.problem(pem, self._files.get(CERTIFICATE, b""), self._seen.identity_ca):
            yield self._error("revocation-list", CRL, problem, "put a sound list there, or remove it")
        elif held := revocation.period(pem):
            yield from self._validity("revocation list", CRL, *held, slack=timedelta(0))

    def _identity(self) -> Iterator[Diagnostic]:
        pem = self._files.get(CERTIFICATE)
        if pem is None:
            return
        where = self._where(CERTIFICATE)
        found = verify.verify_chain(pem, self._seen.identity_ca, self._seen.now, where)
        yield from map(self._for_subject, found)
        try:
            certificate = certificates.load(pem, where)
        except KeymintError:
            return  # said by the chain
        if not certificates.is_canonical(pem):
            message = "is not exactly the encoding of the certificate that it holds"
            yield self._error("pem-altered", CERTIFICATE, message, self._again)
        wanted = names.parse(self._seen.package.identity.subject_name)
        if certificate.subject != wanted:
            message = f"is for {names.to_text(certificate.subject)!r}, not {names.to_text(wanted)!r}"
            yield self._error("certificate-subject", CERTIFICATE, message, self._again)
        if not any(item.code in {"certificate-expired", "certificate-not-yet-valid"} for item in found):
            period = certificate.not_valid_before_utc, certificate.not_valid_after_utc
            yield from self._validity("certificate", CERTIFICATE, *period, slack=timedelta(0))
        key = self._files.get(KEY)
        if key is not None:
            yield from self._key(key, certificate)

    def _key(self, pem: bytes, certificate: x509.Certificate) -> Iterator[Diagnostic]:
        where = self._where(KEY)
        encrypted = bool(self._seen.package.identity.key.password_env)
        if not keys.is_canonical(pem):
            yield self._error(
                "pem-altered",
                KEY,
                "is not exactly the encoding of a private key",
                self._again,
            )
        if encrypted:
            return  # without its password nothing more can be said of it
        try:
            key = keys.from_pem(pem, None, where)
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
            return
        if not keys.matches(key, certificate):
            message = "is not the key of the certificate beside it"
            yield self._error("key-mismatch", KEY, message, self._again)

    def _authorities(self) -> Iterator[Diagnostic]:
        trusted = {
            IDENTITY_CA: self._seen.identity_ca,
            PERMISSIONS_CA: self._seen.permissions_ca,
            CA: self._seen.permissions_ca,
        }
        for name in (IDENTITY_CA, PERMISSIONS_CA, CA):
            if name in self._names and name in self._files and self._files[name] != trusted[name]:
                yield self._error(
                    "authority-differs", name, "is not the certificate of the workspace's authority", self._again
                )
        try:
            found = certificates.can_sign_documents(
                certificates.load_bundle(self._seen.permissions_ca)[0],
                self._where(PERMISSIONS_CA if PERMISSIONS_CA in self._names else CA),
            )
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
        else:
            if found:
                yield self._for_subject(found)

    def _content(self, kind: str) -> bytes | None:
        try:
            return smime.signed_content(self._files.get(f"{kind}.p7s", b""))
        except KeymintError:
            return None

    def _signed(self, kind: str) -> Generator[Diagnostic, None, etree._Element | None]:
        """Judge a signed document; the generator's value is its root, or None where it cannot be trusted."""
        name = f"{kind}.p7s"
        signed = self._files.get(name)
        if signed is None:
            return None
        where = self._where(name)
        content = yield from self._verified(signed, where)
        if content is None:
            return None
        yield from map(self._for_subject, vendor_limits.check_size(len(signed), kind, self._seen.package))
        if not self._as_built(kind, content):
            package = self._seen.package.name
            message = f"the sources build another {kind} document: they changed, or the built one was edited by hand"
            mend = f"'keymint build -f {package}' and 'keymint install {package}' write what the sources say"
            yield self._warning("drift", name, message, mend)
        try:
            root = dds_xml.read(content, kind, str(where))
        except KeymintError as error:
            yield from map(self._for_subject, error.diagnostics)
            return None
        for hazard in dds_xml.hazards(content, root):
            yield self._warning("document-hazard", name, hazard, f"build it anew in place of editing it; {self._again}")
        return root

    def _as_built(self, kind: str, content: bytes) -> bool:
        """Tell whether a document is what the sources build; permissions may say the same in another form."""
        built = self._seen.documents.get(f"{kind}.xml")
        if content == built:
            return True
        if kind != PERMISSIONS or built is None:
            return False
        try:
            same_grant = _without_rules(content) == _without_rules(built)
            return same_grant and is_form_of(self._seen.package, content)
        except KeymintError:
            return False

    def _verified(self, signed: bytes, where: Origin) -> Generator[Diagnostic, None, bytes | None]:
        """Judge a signature; the generator's value is what is signed. An authority that expired hides nothing else."""
        for at in (self._seen.now, None):
            try:
                return smime.verify(signed, self._seen.permissions_ca, at=at, where=where)
            except KeymintError as error:
                yield from map(self._for_subject, error.diagnostics)
                if error.diagnostics[0].code != "smime-authority-expired":
                    return None
        return None

    def _grant(self, root: etree._Element) -> Iterator[Diagnostic]:
        name = f"{PERMISSIONS}.p7s"
        grants = root.findall("permissions/grant")
        if len(grants) != 1:
            message = f"has {len(grants)} grants; vendors choose among several in different ways"
            yield self._warning("grant-count", name, message, "keep one grant")
        grant = grants[0]
        subject = grant.findtext("subject_name", "")
        wanted = self._certificate_subject()
        if wanted is not None and subject != wanted:
            message = f"grants to {subject!r}, but the certificate is for {wanted!r}"
            yield self._error("grant-subject", name, message, self._again)
        if grant.findtext("default", "").strip() != "DENY":
            message = "allows by default on Cyclone DDS and OpenDDS, and denies on Fast DDS"
            yield self._error("grant-default", name, message, "make the default DENY")
        begin, end = (_date(grant.findtext(f"validity/{tag}", "")) for tag in ("not_before", "not_after"))
        if begin is not None and end is not None:
            yield from self._validity("grant", name, begin, end, slack=SLACK)

    def _certificate_subject(self) -> str | None:
        try:
            return names.render(certificates.load(self._files.get(CERTIFICATE, b"")).subject)
        except KeymintError:
            return None

    def _validity(
        self, what: str, name: str, begin: datetime, end: datetime, *, slack: timedelta
    ) -> Iterator[Diagnostic]:
        now = self._seen.now
        code = what.replace(" ", "-")
        renew = (
            "extend its validity in the sources, then build and install" if name != CRL else "put a newer list there"
        )
        if now >= end:
            yield self._error(f"{code}-expired", name, f"the {what} expired on {_shown(end)}", renew)
        elif now <= begin:
            message = f"the {what} is not valid before {_shown(begin)}"
            yield self._error(f"{code}-not-yet-valid", name, message, renew)
        elif now + timedelta(days=self._seen.within_days) >= end:
            yield self._warning(f"{code}-expires", name, f"the {what} expires on {_shown(end)}", renew)
        elif now + slack >= end or now - slack < begin:
            message = (
                f"the {what} is valid from {_shown(begin)} to {_shown(end)}, which is within a day of now: Fast DDS "
                "reads these dates in its host's time zone"
            )
            yield self._warning(f"{code}-slack", name, message, renew)

    def _domains(self, permissions: etree._Element, governance: etree._Element) -> Iterator[Diagnostic]:
        governed = (item for element in governance.iter("domains") for item in _ranges(element))
        granted = {item for element in permissions.iter("domains") for item in _ranges(element)}
        for item in uncovered(sorted(granted), governed):
            yield self._error(
                "domain-uncovered", PERMISSIONS_P7S, f"grants in {in_words([item])}, which the governance lacks",
                "add the domain to a domain rule of the governance",
            )  # fmt: skip


def _ranges(element: etree._Element) -> Iterator[DomainRange]:
    """Yield the domains of a ``<domains>`` element; of a range with one end, that end (as vendors do)."""
    for item in element:
        if item.tag == "id":
            yield DomainRange(int(item.text or 0), int(item.text or 0))
        else:
            low = int(item.findtext("min", "0"))
            yield DomainRange(low, int(item.findtext("max", str(low))))


def _date(text: str) -> datetime | None:
    """Return a date of a document; one without a zone is UTC (DDS Security 1.1, 9.4.1.3.2.2)."""
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _shown(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def _without_rules(content: bytes) -> tuple[tuple[str, str, str], ...]:
    """Return what a permissions document says beside its rules, in the form in which two of them can be compared."""
    root = dds_xml.read(content, PERMISSIONS, PERMISSIONS_XML)
    for grant in root.iter("grant"):
        for rule in [*grant.findall("allow_rule"), *grant.findall("deny_rule")]:
            grant.remove(rule)
    return tuple((item.tag, item.get("name", ""), (item.text or "").strip()) for item in root.iter("*"))
