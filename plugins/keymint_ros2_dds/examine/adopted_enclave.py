# SPDX-License-Identifier: Apache-2.0
"""Examine an enclave that another tool made: what it has, and what is wrong with it.

The rules are those of ``keymint check`` (:mod:`~keymint_ros2_dds.examine.enclave_rules`). What an answer means for a
keystore that is to be taken over stands in a table; a few more rules ask what only a workspace requires.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from typing import Any

from cryptography import x509

from comarmor.values import replace
from keymint.api import DomainRange, FoundEnclave, FoundGrant, TrustAnchor, TrustAnchors, Validity
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.names import name_of, package_name
from keymint.pki import certificates, examine, keys
from keymint.pki.distinguished_names import MAX_COMMON_NAME, attributes, to_text
from keymint_ros2_dds import enclave_layout as layout
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.domains import merged_domains
from keymint_ros2_dds.examine.enclave_rules import AUTHORITY_FILES, EnclaveRules
from keymint_ros2_dds.governance_warnings import OPEN_JOIN, open_domain
from keymint_ros2_dds.keystores.keystore_contents import Contents, EnclavePlace
from keymint_ros2_dds.proving.enclave_governance import ACCEPT
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, as_ranges

_ISSUE = "issue it again with the tool that made it, here and on the robots"
_REMOVE = "take it out of the keystore; a new one for this name: 'keymint create', build and install afterwards"
_VIEW: Mapping[str, tuple[str, str]] = {
    "file-missing": ("adopt-file-missing", "restore it, or remove the enclave's folder if nothing uses it"),
    "file-replaced": ("adopt-token", "write <pkcs11> into identities.xml afterwards; docs/how-to/hsm.md"),
    "authority-differs": (
        "adopt-authorities",
        "a workspace has one authority for each role: adopt these enclaves as a keystore of their own",
    ),
    "revocation-list": ("adopt-revocations", ""),
    "revocation-list-expired": ("adopt-revocations", _ISSUE),
    "revocation-list-not-yet-valid": ("adopt-revocations", _ISSUE),
    "key-mismatch": ("adopt-key-mismatch", "restore the key or the certificate; participants do not start with these"),
    "names-confused": ("names-confused", "'keymint harden names' gives it another name"),
    "pem-altered": ("adopt-encoding", "no action needed: it stays in use"),
    "grant-count": ("adopt-grants", "sign a document with one grant"),
    "grant-subject": ("adopt-grant-subject", "sign permissions for this certificate"),
    "grant-default": ("adopt-default", "sign a document whose default is DENY"),
    "grant-expired": ("adopt-grant-expired", ""),
    "grant-not-yet-valid": ("adopt-grant-expired", ""),
    "grant-never-valid": ("adopt-grant-dates", ""),
    "schema": ("adopt-document", "sign a valid document"),
    "domain-uncovered": (
        "adopt-domain",
        "'ros2 security' takes both from ROS_DOMAIN_ID: sign the permissions again with that of the robots",
    ),
    "document-differs": (
        "adopt-document-differs",
        "write the signed text into it (openssl smime -verify -noverify prints it), or remove it",
    ),
}
"""The code and the help that the finding of a rule has here; without help that of the rule."""
_WARNINGS = frozenset((
    "adopt-encoding", "adopt-grant-expired", "certificate-expired", "certificate-not-yet-valid", "names-confused",
))  # fmt: skip
"""Codes of what can be taken over as it is; other answers of the rules are errors."""
_UNASKED = "grant-slack"
"""Code of what is no matter of the keystore: a period that began today."""
_EVERYTHING = frozenset(("*", "rt/*", "rq/*", "rr/*", "**"))
"""Expressions that leave nothing denied of a kind of ROS names."""


def examine_enclave(
    contents: Contents, place: EnclavePlace, anchors: Mapping[str, TrustAnchor]
) -> tuple[FoundEnclave, list[Diagnostic]]:
    """Return an enclave and the findings on it; an error is a reason why it cannot be taken over as it is.

    Args:
        contents: what the files of the keystore contain.
        place: where those of the enclave are.
        anchors: the authorities of the keystore, by role.
    """
    enclave = _Enclave(contents, place)
    findings = [enclave.viewed(each) for each in enclave.rules(anchors) if each.code != _UNASKED]
    findings += enclave.of_workspace()
    return enclave.found(), [replace(each, subject=place.subject) for each in findings]


class _Enclave(EnclaveRules):
    """One enclave under examination."""

    def __init__(self, contents: Contents, place: EnclavePlace) -> None:
        files = {name: contents.read(path) for name, path in place.files.items()}
        chains = {role: files.get(name) or files.get(layout.CA, b"") for role, name in AUTHORITY_FILES.items()}
        restore = "restore it, or make it again with the tool that made the keystore"
        super().__init__(files, place.place, restore, place.subject, chains)
        self._contents = contents
        self._enclave = place
        authorities = () if layout.CA in files else AUTHORITY_FILES.values()
        self._needed = [layout.CERTIFICATE, *authorities, layout.PERMISSIONS_P7S, layout.GOVERNANCE_P7S]

    def _where(self, name: str) -> Origin:
        return self._contents.place(self._enclave.files.get(name) or f"{self._folder}/{name}")

    # -- the rules of every enclave ------------------------------------------------------------------------------

    def rules(self, anchors: Mapping[str, TrustAnchor]) -> Iterator[Diagnostic]:
        """Yield what the rules of every enclave find, as ``keymint check`` says it."""
        when = self._contents.keystore.now, timedelta(0)
        yield from self.trust(TrustAnchors(anchors, "", ""), self._needed)
        yield from self.encoding(layout.CERTIFICATE)
        yield from self.name()
        yield from self.periods(when)
        yield from (*self.permissions.defects, *self.governance.defects)
        yield from self.documents(self.permissions.document, self.governance.document, when)
        if signed := self.permissions.signed:
            yield from self.plain_text(signed.content)

    def viewed(self, finding: Diagnostic) -> Diagnostic:
        """Return what the finding of a rule means for a keystore that is to be taken over."""
        code, help_ = _VIEW.get(finding.code, (finding.code, ""))
        if finding.code == "revocation-list" and self.revocation:
            code, help_ = "adopt-revoked", _REMOVE
        severity = Severity.WARNING if code in _WARNINGS else Severity.ERROR
        return replace(finding, code=code, severity=severity, help=help_ or finding.help)

    # -- what a workspace requires -------------------------------------------------------------------------------

    def of_workspace(self) -> Iterator[Diagnostic]:
        """Yield the findings on what only a workspace requires."""
        try:
            package_name(self._subject or "/x")
        except KeymintError as error:
            message, where = error.diagnostics[0].message, self._contents.place(self._folder)
            yield Diagnostic.error("adopt-path", message, where, "give the enclave another path")
        if self.certificate is not None:
            yield from self._common_name(to_text(self.certificate.subject))
        if layout.KEY not in self._files:
            message = "is not here: the enclave is taken over without it, and gets no other one"
            where = self._where(layout.KEY)
            yield Diagnostic.note("adopt-key-elsewhere", message, where, "no action needed if the robot has it")
        elif self._key_state() != "unknown":
            yield from exposure(self._contents, self._enclave.files[layout.KEY], self._subject)
        if grant := self._only_grant():
            yield from self._of_grant(grant)
        for rule in self.governance.document.domain_rules if self.governance.document else ():
            domains, open_ = tuple(merged_domains(as_ranges(rule.domains))), rule.unauthenticated
            for text in open_domain(domains, join_controlled=rule.join_controlled, unauthenticated=open_):
                help_ = "sign a governance that puts it under access control, here and on the robots"
                yield self._warning(OPEN_JOIN, layout.GOVERNANCE_P7S, text, f"{help_}, {ACCEPT} afterwards")

    def _common_name(self, subject_name: str) -> Iterator[Diagnostic]:
        longest = max(map(len, self._common_names()), default=0)
        if longest > MAX_COMMON_NAME:
            message = f"has a common name of {longest} characters; X.509 allows {MAX_COMMON_NAME}"
            help_ = "give the enclave a shorter path with the tool that made it; Keymint cannot issue this name again"
            yield self._error("adopt-name-length", layout.CERTIFICATE, message, help_)
        elif subject_name == "CN=/":
            message = (
                "is the root enclave with the name 'CN=/' alone, which on Cyclone DDS can use all other permissions"
            )
            help_ = "it stays as it is; a second RDN in its name mends it afterwards: 'keymint harden names'"
            yield self._warning("adopt-root", layout.CERTIFICATE, message, help_)
        elif not self._subject:
            message = f"is for {subject_name!r}, whose common name is no name of a subject"
            help_ = "put its files into a folder enclaves/<path>/ with the names that ROS 2 reads"
            yield self._error("adopt-name", layout.CERTIFICATE, message, help_)
        elif not self._is_named_like_path():
            message = f"is for {subject_name!r}, but the path of its enclave is {self._subject}"
            yield self._warning("adopt-name", layout.CERTIFICATE, message, "no action needed: the name stays in use")

    def _of_grant(self, grant: DocumentGrant) -> Iterator[Diagnostic]:
        if grant.rules and not self._domains():
            message = "has rules for different domains, and a package has the same domains in all of its rules"
            help_ = "sign a document whose rules have the same"
            yield self._error("adopt-domains", layout.PERMISSIONS_P7S, message, help_)
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
            yield self._warning("adopt-allows-all", layout.PERMISSIONS_P7S, message, help_)

    # -- facts ---------------------------------------------------------------------------------------------------

    def _common_names(self) -> list[str]:
        subject = self.certificate.subject if self.certificate else x509.Name(())
        return [value for kind, value in attributes(subject) if kind == "CN"]

    def _is_named_like_path(self) -> bool:
        """Tell whether the name of the certificate is the path, or the path is made of it."""
        by_content = self._enclave.files.get(layout.CERTIFICATE) == self._folder and bool(self._subject)
        return self.certificate is not None and (by_content or self._common_names() == [self._subject])

    def _key_state(self) -> str:
        """Return whether the private key is that of the certificate, as a report says it."""
        if layout.KEY not in self._files:
            return "elsewhere"
        own, _ = self.own_key
        if own is None or self.certificate is None:
            return "unknown"
        return "matches" if keys.matches(own, self.certificate) else "differs"

    def _grants(self) -> Sequence[DocumentGrant]:
        return self.permissions.document.grants if self.permissions.document else ()

    def _only_grant(self) -> DocumentGrant | None:
        grants = self._grants()
        return grants[0] if len(grants) == 1 else None

    def _domains(self) -> tuple[DomainRange, ...]:
        """Return the domains of the only grant; none if its rules have different ones."""
        grant = self._only_grant()
        found = {tuple(merged_domains(as_ranges(rule.domains))) for rule in grant.rules} if grant else set()
        return found.pop() if len(found) == 1 else ()

    def found(self) -> FoundEnclave:
        """Return what the enclave has."""
        certificate, has_key, grant = self.certificate, self._key_state() == "matches", self._only_grant()
        permissions, governance = self.permissions.signed, self.governance.signed if self.governance.document else None
        signed, rights = {layout.PERMISSIONS_XML: permissions, layout.GOVERNANCE_XML: governance}, None
        if grant and permissions:
            place = self._where(layout.PERMISSIONS_P7S).file, permissions.lines_before
            rights = FoundGrant(permissions.content, *place, grant.subject_name)
        period = STANDARD.period(grant) if grant else None
        return FoundEnclave(
            subject=self._subject,
            files=self._enclave.files,
            certificate=self._files.get(layout.CERTIFICATE, b""),
            key=self._files[layout.KEY] if has_key else b"",
            key_spec=keys.kind_of(certificates.public_key(certificate)) if certificate else None,
            subject_name=to_text(certificate.subject) if certificate else "",
            validity=Validity(*certificates.period(certificate)) if certificate else None,
            grant_validity=Validity(*period) if period and period[0] < period[1] else None,
            domains=self._domains(),
            documents={name: each.content for name, each in signed.items() if each},
            grant=rights,
            facts=self._facts(),
            exposed=has_key and is_exposed(self._contents, self._enclave.files[layout.KEY]),
        )

    def _facts(self) -> dict[str, Any]:
        """Return what a report says; values are those of JSON."""
        certificate, issuer = self.certificate, self._chains[layout.IDENTITY_ROLE]
        files = {name: self._contents.keystore.files[path] for name, path in sorted(self._enclave.files.items())}
        signed, plain = self.permissions.signed, self._files.get(layout.PERMISSIONS_XML)
        governance = self.governance.document.domain_rules if self.governance.document else ()
        governed = as_ranges(each for rule in governance for each in rule.domains)
        return {
            "place": self._folder,
            "links": sum(bool(file.link) for file in files.values()),
            "modes": {name: f"{file.mode:04o}" for name, file in files.items() if not file.link},
            "missing": [name for name in self._needed if name not in self._files],
            "chain": bool(certificate and issuer)
            and not examine.verify_chain(self._files[layout.CERTIFICATE], issuer, None),
            "subject_name": to_text(certificate.subject) if certificate else "",
            "named_like_path": self._is_named_like_path(),
            **({"certificate": dates_of(certificate)} if certificate else {}),
            "key": self._key_state(),
            "signatures": {
                layout.PERMISSIONS: signed is not None,
                layout.GOVERNANCE: self.governance.signed is not None,
            },
            "same_text": plain == signed.content if plain and signed else None,
            "grants": [
                {"subject_name": each.subject_name, "not_before": each.not_before, "not_after": each.not_after}
                for each in self._grants()
            ],
            "domains": _as_json(self._domains()),
            "governance_domains": _as_json(merged_domains(governed)),
        }


def _as_json(domains: Sequence[DomainRange]) -> list[list[int]]:
    return [[each.first, each.last] for each in domains]


def dates_of(certificate: x509.Certificate) -> dict[str, str]:
    """Return the period of a certificate as a report has it."""
    begin, end = certificates.period(certificate)
    return {"not_before": f"{begin:%Y-%m-%dT%H:%M:%SZ}", "not_after": f"{end:%Y-%m-%dT%H:%M:%SZ}"}


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
        end = "'keymint authority replace'"
        if subject:
            name = name_of(subject)
            end = f"'keymint renew --rekey {name}', then 'keymint revoke {name} --reason superseded',"
        help_ = f"chmod 600, here and on the robot; {end} if someone may have copied it"
        yield Diagnostic.warning("adopt-key-exposed", message, contents.place(path), help_)
