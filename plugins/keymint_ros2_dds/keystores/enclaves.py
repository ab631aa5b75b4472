# SPDX-License-Identifier: Apache-2.0
"""Examine an enclave that another tool made: what it has, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from typing import Any

from cryptography import x509

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import DomainRange, FoundEnclave, FoundGrant, Validity
from keymint.errors import KeymintError
from keymint.names import name_of, package_name
from keymint.pki import certificates, certification_path, keys, smime
from keymint.pki.distinguished_names import MAX_COMMON_NAME, attributes, to_text
from keymint.pki.mime import SignedDocument
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.domains import in_words, merged, uncovered
from keymint_ros2_dds.enclave_layout import (
    CA,
    CERTIFICATE,
    GOVERNANCE,
    GOVERNANCE_P7S,
    GOVERNANCE_XML,
    IDENTITY_CA,
    KEY,
    KEY_URI,
    PERMISSIONS,
    PERMISSIONS_CA,
    PERMISSIONS_P7S,
    PERMISSIONS_XML,
)
from keymint_ros2_dds.keystores.contents import Contents
from keymint_ros2_dds.keystores.places import EnclavePlace
from keymint_ros2_dds.reading import dates, signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, as_ranges

_EVERYTHING = frozenset(("*", "rt/*", "rq/*", "rr/*", "**"))
"""Expressions that leave nothing denied of a kind of ROS names."""
_DATED = frozenset(("certificate-expired", "certificate-not-yet-valid"))


def examined(contents: Contents, place: EnclavePlace) -> tuple[FoundEnclave, list[Diagnostic]]:
    """Return an enclave and the findings on it; an error is a reason why it cannot be taken over as it is."""
    enclave = _Enclave(contents, place)
    findings = list(enclave.findings())
    return enclave.found(), [replace(each, subject=place.subject) for each in findings]


class _Enclave:
    """One enclave under examination; the findings fill its facts."""

    def __init__(self, contents: Contents, place: EnclavePlace) -> None:
        self._contents = contents
        self._enclave = place
        self._certificate: x509.Certificate | None = None
        self._documents: dict[str, bytes] = {}
        self._grant: DocumentGrant | None = None
        self._found_grant: FoundGrant | None = None
        self._domains: tuple[DomainRange, ...] = ()
        self._facts: dict[str, Any] = {"place": place.place, "links": 0}

    def found(self) -> FoundEnclave:
        certificate = self._certificate
        return FoundEnclave(
            subject=self._enclave.subject,
            files=self._enclave.files,
            certificate=self._content(CERTIFICATE),
            key=self._content(KEY) if self._facts["key"] == "matches" else b"",
            key_spec=keys.kind_of(certificates.public_key(certificate)) if certificate else None,
            subject_name=self._facts["subject_name"],
            validity=Validity(*certificates.period(certificate)) if certificate else None,
            grant_validity=self._grant_validity(),
            domains=self._domains,
            documents=self._documents,
            grant=self._found_grant,
            facts=self._facts,
            exposed=self._facts["key"] == "matches" and is_exposed(self._contents, self._path(KEY)),
        )

    def findings(self) -> Iterator[Diagnostic]:
        yield from self._inventory()
        yield from self._identity()
        yield from self._key()
        permissions = yield from self._signed(PERMISSIONS)
        governance = yield from self._signed(GOVERNANCE)
        yield from self._permissions(permissions)
        yield from self._governance(governance)

    # -- files ---------------------------------------------------------------------------------------------------

    def _path(self, name: str) -> str:
        return self._enclave.files.get(name, "")

    def _content(self, name: str) -> bytes:
        path = self._path(name)
        return self._contents.read(path) if path else b""

    def _at(self, name: str) -> str:
        """Return the path of a file, also of one that is missing."""
        return self._path(name) or f"{self._enclave.place}/{name}"

    def _where(self, name: str) -> Origin:
        return self._contents.place(self._at(name))

    def _error(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        return self._contents.error(code, self._at(name), message, help_)

    def _warning(self, code: str, name: str, message: str, help_: str) -> Diagnostic:
        return self._contents.warning(code, self._at(name), message, help_)

    def _inventory(self) -> Iterator[Diagnostic]:
        own = {name: self._contents.keystore.files[path] for name, path in sorted(self._enclave.files.items())}
        self._facts["links"] = sum(bool(file.link) for file in own.values())
        self._facts["modes"] = {name: f"{file.mode:04o}" for name, file in own.items() if not file.link}
        self._facts["missing"] = []
        for name in (CERTIFICATE, IDENTITY_CA, PERMISSIONS_CA, PERMISSIONS_P7S, GOVERNANCE_P7S):
            if not self._path(name) and not (name in {IDENTITY_CA, PERMISSIONS_CA} and self._path(CA)):
                self._facts["missing"].append(name)
                help_ = "restore it, or remove the enclave's folder if nothing uses it"
                yield self._error("adopt-file-missing", name, "is missing", help_)
        try:
            package_name(self._enclave.subject or "/x")
        except KeymintError as error:
            message = error.diagnostics[0].message
            yield self._contents.error("adopt-path", self._enclave.place, message, "give the enclave another path")
        if self._path(KEY_URI):
            message = "says that the key lies in a token, which is not taken over"
            help_ = "write <pkcs11> into identities.xml afterwards; docs/keystore-life.md"
            yield self._error("adopt-token", KEY_URI, message, help_)

    # -- identity ------------------------------------------------------------------------------------------------

    def _trusted(self, name: str) -> bytes:
        return self._content(name) or self._content(CA)

    def _identity(self) -> Iterator[Diagnostic]:
        self._facts |= {"chain": False, "subject_name": "", "named_like_path": False}
        pem, where = self._content(CERTIFICATE), self._where(CERTIFICATE)
        if not pem:
            return
        try:
            certificate = certificates.load(pem, where)
            certificates.public_key(certificate, where)
        except KeymintError as error:
            yield from error.diagnostics
            return
        self._certificate = certificate
        self._facts["subject_name"] = to_text(certificate.subject)
        self._facts["certificate"] = dates_of(certificate)
        if issuer := self._trusted(IDENTITY_CA):
            problems = certification_path.verify_chain(pem, issuer, self._contents.keystore.now, where)
            self._facts["chain"] = all(each.code in _DATED for each in problems)
            for each in problems:
                dated = each.code in _DATED
                yield replace(each, severity=Severity.WARNING if dated else Severity.ERROR)
        yield from self._common_name(certificate)
        if not certificates.is_canonical(pem):
            message = "has text around its certificate, or encodes it in another way than 'keymint install' writes it"
            yield self._warning("adopt-encoding", CERTIFICATE, message, "nothing: it stays as it is")

    def _common_name(self, certificate: x509.Certificate) -> Iterator[Diagnostic]:
        names = [value for kind, value in attributes(certificate.subject) if kind == "CN"]
        by_content = self._path(CERTIFICATE) == self._enclave.place  # then the name is where the subject comes from
        self._facts["named_like_path"] = names == [self._enclave.subject] or (
            by_content and bool(self._enclave.subject)
        )
        subject_name = self._facts["subject_name"]
        if confused := subject_name_text.twice(certificate.subject):
            yield self._warning("names-confused", CERTIFICATE, confused, "'keymint harden names' gives it another name")
        if any(len(name) > MAX_COMMON_NAME for name in names):
            message = f"has a common name of {max(map(len, names))} characters; X.509 allows {MAX_COMMON_NAME}"
            help_ = "give the enclave a shorter path with the tool that made it; Keymint cannot issue this name again"
            yield self._error("adopt-name-length", CERTIFICATE, message, help_)
        elif subject_name == "CN=/":
            message = (
                "is the root enclave with the name 'CN=/' alone, which on Cyclone DDS can use all other permissions"
            )
            help_ = "it stays as it is; a second RDN in its name mends it afterwards: 'keymint harden names'"
            yield self._warning("adopt-root", CERTIFICATE, message, help_)
        elif not self._enclave.subject:
            message = f"is for {subject_name!r}, whose common name is no name of a subject"
            help_ = "put its files into a folder enclaves/<path>/ with the names that ROS 2 reads"
            yield self._error("adopt-name", CERTIFICATE, message, help_)
        elif not self._facts["named_like_path"]:
            message = f"is for {subject_name!r}, but the path of its enclave is {self._enclave.subject}"
            yield self._warning("adopt-name", CERTIFICATE, message, "nothing: the name stays as it is")

    def _key(self) -> Iterator[Diagnostic]:
        pem, certificate = self._content(KEY), self._certificate
        self._facts["key"] = "unknown" if pem else "elsewhere"
        if not pem:
            message = "is not here: the enclave is taken over without it, and gets no other one"
            yield self._contents.note("adopt-key-elsewhere", self._at(KEY), message, "nothing, if the robot has it")
            return
        try:
            public = keys.public_of(pem, None, self._where(KEY))
        except KeymintError as error:
            yield from error.diagnostics
            return
        if certificate is not None:
            self._facts["key"] = "matches" if keys.matches(public, certificate) else "differs"
        if self._facts["key"] == "differs":
            help_ = "restore the key or the certificate; participants do not start with these"
            yield self._error("adopt-key-mismatch", KEY, "is not the key of the certificate beside it", help_)
        yield from exposure(self._contents, self._path(KEY), self._enclave.subject)

    # -- documents -----------------------------------------------------------------------------------------------

    def _signed(self, kind: str) -> Generator[Diagnostic, None, SignedDocument | None]:
        """Check a signed document; the generator returns it if the signature verifies, else None."""
        self._facts.setdefault("signatures", {})[kind] = False
        name = f"{kind}.p7s"
        signed, authority = self._content(name), self._trusted(PERMISSIONS_CA)
        if not signed or not authority:
            return None
        try:
            document = smime.read(signed, authority, where=self._where(name))
        except KeymintError as error:
            yield from error.diagnostics
            return None
        self._facts["signatures"][kind] = True
        self._documents[f"{kind}.xml"] = document.content
        return document

    def _permissions(self, signed: SignedDocument | None) -> Iterator[Diagnostic]:
        self._facts |= {"grants": [], "same_text": None, "domains": []}
        if signed is None:
            return
        content, plain = signed.content, self._content(PERMISSIONS_XML)
        self._facts["same_text"] = plain == content if plain else None
        if plain and plain != content:
            message = "is not the document that permissions.p7s signs, which is the one that participants read"
            help_ = "write the signed text into it (openssl smime -verify -noverify prints it), or remove it"
            yield self._error("adopt-document-differs", PERMISSIONS_XML, message, help_)
        place = self._where(PERMISSIONS_P7S).file, signed.lines_before
        try:
            document = signed_permissions.read(content, *place)
        except KeymintError as error:
            yield from error.diagnostics
            return
        self._facts["grants"] = [_grant_facts(grant) for grant in document.grants]
        if document.defect:
            yield self._error("adopt-document", PERMISSIONS_P7S, document.defect, "sign a valid document")
        if len(document.grants) != 1:
            message = f"has {len(document.grants)} grants; vendors choose among several in different ways"
            yield self._error("adopt-grants", PERMISSIONS_P7S, message, "sign a document with one grant")
            return
        self._grant = grant = document.grants[0]
        self._found_grant = FoundGrant(content, *place, grant.subject_name)
        yield from self._grant_header(grant)
        yield from self._rules(grant)

    def _grant_header(self, grant: DocumentGrant) -> Iterator[Diagnostic]:
        expected = subject_name_text.of_any(self._certificate.subject) if self._certificate else grant.subject_name
        if grant.subject_name != expected:
            message = f"grants to {grant.subject_name!r}, but the certificate is for {expected!r}"
            yield self._error("adopt-grant-subject", PERMISSIONS_P7S, message, "sign permissions for this certificate")
        period = self._grant_validity()
        if period is None:
            message = f"its dates are {grant.not_before!r} and {grant.not_after!r}, expected xs:dateTime"
            yield self._error("adopt-grant-dates", PERMISSIONS_P7S, message, "sign a document with valid dates")
        elif not period.not_before <= self._contents.keystore.now <= period.not_after:
            message = f"is in force from {_shown(period.not_before)} to {_shown(period.not_after)}, not now"
            help_ = "'keymint renew' signs it again with later dates"
            yield self._warning("adopt-grant-expired", PERMISSIONS_P7S, message, help_)

    def _rules(self, grant: DocumentGrant) -> Iterator[Diagnostic]:
        if grant.allows:
            message = "allows by default, which Fast DDS denies"
            yield self._error("adopt-default", PERMISSIONS_P7S, message, "sign a document whose default is DENY")
        domains = {tuple(merged(as_ranges(rule.domains))) for rule in grant.rules}
        if len(domains) == 1:
            self._domains = next(iter(domains))
        elif domains:
            message = "has rules for different domains, and a package has the same domains in all of its rules"
            yield self._error("adopt-domains", PERMISSIONS_P7S, message, "sign a document whose rules have the same")
        self._facts["domains"] = [[each.first, each.last] for each in self._domains]
        allowed = {
            (criteria.action, topic)
            for rule in grant.rules
            for criteria in rule.criteria
            for topic in criteria.topics
            if rule.allows and topic.strip() in _EVERYTHING
        }
        if allowed:
            shown = ", ".join(f"{action} {topic}" for action, topic in sorted(allowed))
            message = f"allows all of a kind of topics: {shown}"
            help_ = "write a policy for it: 'ros2 security create_enclave' resets an existing enclave to this"
            yield self._warning("adopt-allows-all", PERMISSIONS_P7S, message, help_)

    def _governance(self, signed: SignedDocument | None) -> Iterator[Diagnostic]:
        self._facts["governance_domains"] = []
        if signed is None:
            return
        try:
            document = signed_governance.read(signed.content, self._where(GOVERNANCE_P7S).file, signed.lines_before)
        except KeymintError as error:
            del self._documents[GOVERNANCE_XML]
            yield from error.diagnostics
            return
        if document.defect:
            yield self._error("adopt-document", GOVERNANCE_P7S, document.defect, "sign a valid document")
        governed = merged(as_ranges(each for rule in document.domain_rules for each in rule.domains))
        self._facts["governance_domains"] = [[each.first, each.last] for each in governed]
        if lacking := uncovered(self._domains, governed):
            message = f"grants in {in_words(lacking)}, but the governance is for {in_words(governed)}"
            help_ = "'ros2 security' takes both from ROS_DOMAIN_ID: sign the permissions again with that of the robots"
            yield self._error("adopt-domain", PERMISSIONS_P7S, message, help_)

    def _grant_validity(self) -> Validity | None:
        grant = self._grant
        begin, end = (dates.standard(text) for text in (grant.not_before, grant.not_after)) if grant else (None, None)
        return Validity(begin, end) if begin and end and begin < end else None


def dates_of(certificate: x509.Certificate) -> dict[str, str]:
    """Return the period of a certificate as a report has it."""
    begin, end = map(_shown, certificates.period(certificate))
    return {"not_before": begin, "not_after": end}


def is_exposed(contents: Contents, path: str) -> bool:
    """Tell whether others can read a private key."""
    return bool(contents.keystore.files[path].mode & 0o077)


def exposure(contents: Contents, path: str, subject: str) -> Iterator[Diagnostic]:
    """Yield a finding on a private key that others can read: it may have been copied.

    Args:
        contents: what the files of the keystore contain.
        path: path of the key.
        subject: whose key it is; empty for that of an authority.
    """
    if is_exposed(contents, path):
        mode = contents.keystore.files[path].mode
        message = f"is a private key with mode {mode:04o}: others could read it, so it counts as exposed"
        end = f"'keymint renew --rekey {name_of(subject)}'" if subject else "'keymint authority replace'"
        help_ = f"chmod 600, here and on the robot; {end} ends it if someone may have copied it"
        yield contents.warning("adopt-key-exposed", path, message, help_)


def _grant_facts(grant: DocumentGrant) -> dict[str, Any]:
    return {"subject_name": grant.subject_name, "not_before": grant.not_before, "not_after": grant.not_after}


def _shown(moment: object) -> str:
    return f"{moment:%Y-%m-%dT%H:%M:%SZ}"
