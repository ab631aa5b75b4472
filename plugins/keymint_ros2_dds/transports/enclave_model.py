# SPDX-License-Identifier: Apache-2.0
"""Decide about installed enclaves by the models of vendors, and the simulated transports that do.

A participant authenticates itself when it is created, and its peers. It reads its trusted authorities and its
revocation list once, when it is created. Both vendors then require for each certificate, its own first: a trusted
issuer; the present within its period; and, if there is any list, one of the issuer that is in force and does not name
the certificate. ``tests/real/test_keystore_life.py`` measures it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from functools import lru_cache
from itertools import repeat

from cryptography import x509

from comarmor.text import lazy_regex
from keymint.api import Availability, Environment, InstalledEnclave, Tier, Transport, Verdict
from keymint.api.graph import Column, Edge
from keymint.api.transports import EnclavesBySubject, installed_file
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, revocation_lists
from keymint_ros2_dds import enclave_layout as layout
from keymint_ros2_dds.decision import semantics
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator, DomainAccess, topic_rule
from keymint_ros2_dds.decision.semantics import OMG, VARIATIONS, Semantics, Variation
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.signed_governance import DocumentDomainRule, DocumentTopicRule
from keymint_ros2_dds.transports import enclave_files

_LIST = lazy_regex(rb"-----BEGIN X509 CRL-----.*?-----END X509 CRL-----", re.DOTALL)


class Authentication:
    """What the participant of an enclave authenticates with.

    Args:
        enclave: the enclave.
        now: the clock, UTC.

    Attributes:
        certificate: its own.

    Raises:
        KeymintError: a file cannot be read, or is no certificate.
    """

    def __init__(self, enclave: InstalledEnclave, now: datetime) -> None:
        folder = enclave.folder
        trusted = layout.authority_file(folder, layout.IDENTITY_CA)
        bundle, reads = installed_file(folder / trusted), layout.reads_revocations(enclave.distro)
        self.certificate = certificates.load(installed_file(folder / layout.CERTIFICATE), Origin(layout.CERTIFICATE))
        self._now = now
        self._authorities = certificates.load_bundle(bundle, Origin(trusted))
        has_list = reads and (folder / layout.CRL).exists()
        self._listed = revocation_lists.first(installed_file(folder / layout.CRL)) if has_list else None
        self._unread = has_list and self._listed is None
        self._among = tuple(map(revocation_lists.first, _LIST.findall(bundle)))
        self._in_token = (folder / layout.KEY_URI).exists() and not (folder / layout.KEY).exists()

    def refusal(self, semantics: Semantics) -> str:
        """Return why the participant is not created, or an empty text."""
        if self._in_token and not semantics.keys_in_tokens:
            return f"{layout.KEY} is missing, and {layout.KEY_URI} is not read"
        return self.refuses(self.certificate, semantics)

    def refuses(self, certificate: x509.Certificate, semantics: Semantics) -> str:
        """Return why a certificate is refused, in a handshake or at creation; or an empty text."""
        trusted = self._authorities[:1] if semantics.one_authority else self._authorities
        issuer = next((each for each in trusted if _is_issued_by(certificate, each)), None)
        if issuer is None:
            return f"{layout.CERTIFICATE} is by no authority that is trusted"
        period = certificates.period(certificate)
        if problem := _outside(f"the certificate in {layout.CERTIFICATE}", *period, self._now):
            return problem
        if self._unread:
            return f"{layout.CRL} is not a revocation list"
        lists = (self._listed, *(self._among if semantics.lists_among_authorities else ()))
        present = [each for each in lists if each is not None]
        found = next((each for each in present if revocation_lists.is_by(each, issuer)), None)
        if found is None:
            return f"the revocation list in {layout.CRL} is by another authority" if present else ""
        revoked = found.get_revoked_certificate_by_serial_number(certificate.serial_number)
        return _outside(f"the revocation list in {layout.CRL}", *revocation_lists.period(found), self._now) or (
            "" if revoked is None else f"{layout.CRL} revokes the certificate"
        )


_is_issued_by = lru_cache(maxsize=4096)(certificates.is_issued_by)
"""Whether an authority issued a certificate; models of all vendors ask it about each."""


def _outside(what: str, begin: datetime, end: datetime, now: datetime) -> str:
    if now > end:
        return f"{what} has expired"
    return f"{what} is not yet valid" if now < begin else ""


class EnclaveModel:
    """Decides about the endpoints of one enclave in one domain, by the standard and by the model of each vendor.

    Args:
        enclave: the enclave.
        environment: the clock, and what was read before in this run.
        domain: DDS domain id.

    Attributes:
        documents: the signed documents of the enclave; None if they are refused.
        refusal: why they are refused, or an empty text.

    Raises:
        KeymintError: Keymint does not read this form of a signed file, although a vendor may.
    """

    def __init__(self, enclave: InstalledEnclave, environment: Environment, domain: int) -> None:
        unsigned = enclave.folder / layout.PERMISSIONS_XML
        self._rules = str(unsigned if unsigned.exists() else enclave.folder / layout.PERMISSIONS_P7S)
        self._now = environment.now
        self._domain = domain
        self._evaluators: dict[str, tuple[DocumentEvaluator, DomainAccess]] = {}
        self._refusals: dict[str, str] = {}
        self._authentication: Authentication | None = None
        self.documents: enclave_files.SignedDocuments | None = None
        self.refusal = ""
        try:
            documents = enclave_files.signed_documents(enclave.folder, environment)
            self._authentication = Authentication(enclave, environment.now)
            self.documents = documents
        except KeymintError as error:
            enclave_files.raise_if_unread(error, enclave.folder)
            self.refusal = str(error)

    def decide(self, variation: Variation, endpoint: Edge) -> Verdict:
        """Decide whether a participant may have an endpoint, an edge of kind ``topic``."""
        refusal = self.refusal or self.unauthenticated(variation)
        if self.documents is None or refusal:
            return Verdict(allowed=False, reason=refusal)
        evaluator, access = self._evaluators.get(variation.name) or self._opened(variation, self.documents)
        topic = endpoint.object
        return access.decide(evaluator, endpoint.permission, topic.name, topic.partitions)

    def unauthenticated(self, variation: Variation) -> str:
        """Return why an implementation creates no participant with the certificate of the enclave, or an empty text."""
        if self._authentication is None:
            return ""
        if variation.name not in self._refusals:
            self._refusals[variation.name] = self._authentication.refusal(variation.semantics)
        return self._refusals[variation.name]

    def refuses(self, peer: EnclaveModel, variation: Variation) -> bool:
        """Return whether the participant of the enclave refuses that of another one in the handshake."""
        own, other = self._authentication, peer._authentication
        return own is not None and other is not None and bool(own.refuses(other.certificate, variation.semantics))

    def _opened(
        self, variation: Variation, documents: enclave_files.SignedDocuments
    ) -> tuple[DocumentEvaluator, DomainAccess]:
        permissions, governance, subject_name = documents
        evaluator = DocumentEvaluator(permissions, subject_name, self._now, self._domain, variation)
        access = DomainAccess(governance, self._domain, evaluator.semantics)
        self._evaluators[variation.name] = evaluator, access
        return evaluator, access

    def admitted(self, variation: Variation, endpoints: Column) -> bytes:
        """Decide about many endpoints at once, one byte each: 1 admitted, 0 refused; see :meth:`decide`."""
        refused = bytes(len(endpoints.requests))
        if self.documents is None or self.unauthenticated(variation):
            return refused
        evaluator, access = self._evaluators.get(variation.name) or self._opened(variation, self.documents)
        if access.rule is None or access.absent(evaluator) is not None:
            return refused

        def admits(endpoint: Edge, name: str, rule: DocumentTopicRule | None) -> bool:
            if rule is None or not rule.controls(endpoint.permission):
                return rule is not None
            if endpoint.object.partitions:
                return self.decide(variation, endpoint).allowed
            return evaluator.allows(endpoint.permission, name, topic_checked=rule.controlled)

        rules = _topic_rules(endpoints, access.rule, variation)
        return bytes(admits(each, *found) for each, found in zip(endpoints.requests, rules, strict=True))

    def verdict(
        self, variation: Variation, needed: Sequence[Edge], answers: Iterable[tuple[bool, str]] | None = None
    ) -> Verdict:
        """Combine answers about the endpoints of an edge: all must be allowed.

        Args:
            variation: the model of the vendor: it finds the rule that decided, and explains deviations.
            needed: the endpoints.
            answers: whether the vendor allows each, and why, consumed up to the first denial; None: as the model does.
        """
        verdict, deviation = Verdict(False, "this maps to no DDS endpoint", self.place()), ""
        for endpoint, answer in zip(needed, repeat(None) if answers is None else answers, strict=False):
            modelled = self.decide(variation, endpoint)
            place = modelled.where
            # The line of the permissions that decided; 0 if none did. The reason then has the place, if there is one.
            line = place.line if place and place.file == layout.PERMISSIONS_XML else 0
            own = f"{place}: {modelled.reason}" if place and not line else modelled.reason
            allowed, reason = answer or (modelled.allowed, own)
            deviation = deviation or self.deviation(variation, endpoint, allowed=allowed)
            shown = reason or ("it is allowed" if allowed else "it is denied")
            verdict = Verdict(allowed, shown, self.place(line if modelled.allowed == allowed else 0), deviation)
            if not allowed:
                break
        return verdict

    def place(self, line: int = 0) -> Origin:
        """Return a place in the permissions document, for verdicts."""
        return Origin(self._rules, line)

    def deviation(self, variation: Variation, endpoint: Edge, *, allowed: bool) -> str:
        """Return the deviations that explain why a vendor decides differently from the standard.

        Args:
            variation: the model of the vendor.
            endpoint: an edge of kind ``topic``.
            allowed: the vendor's decision. Empty if the standard decides the same, or the model does not.
        """
        if self.refusal or allowed == self.decide(OMG, endpoint).allowed:
            return ""
        if self.decide(variation, endpoint).allowed != allowed:
            return ""
        deviations = semantics.explain(lambda other: self.decide(other, endpoint).allowed, variation)
        return "; ".join(map(str, deviations))


@lru_cache(maxsize=8)
def _topic_rules(
    endpoints: Column, domain_rule: DocumentDomainRule, variation: Variation
) -> Sequence[tuple[str, DocumentTopicRule | None]]:
    """Return the name of each endpoint's topic, in bytes, and the rule of the governance that matches it."""
    names = [each.object.name for each in endpoints.requests]
    rules = {name: topic_rule(domain_rule, name, variation.semantics) for name in names}
    return [(dialects.in_bytes(name), rules[name]) for name in names]


class EnclaveModels:
    """The models of enclaves.

    Args:
        enclaves: the enclaves.
        environment: the clock, and what was read before in this run.
        variation: the model of the vendor that is asked.
        tier: at *exchange* the models of all subjects are kept; otherwise of one, as edges come grouped by subject.

    Attributes:
        enclaves: the enclaves by subject.
        variation: the model of the vendor that is asked.
    """

    def __init__(
        self, enclaves: Iterable[InstalledEnclave], environment: Environment, variation: Variation, tier: Tier
    ) -> None:
        self.variation = variation
        self.enclaves = EnclavesBySubject((enclave.subject, enclave) for enclave in enclaves)
        self._environment = environment
        self._keep_all = tier is Tier.EXCHANGE
        self._models: dict[tuple[str, int], EnclaveModel] = {}

    def of(self, subject: str, domain: int) -> EnclaveModel:
        """Return the model of a subject in a domain.

        Raises:
            KeymintError: the subject has no enclave.
        """
        enclave = self.enclaves[subject]
        key = subject, domain
        if key not in self._models:
            if not self._keep_all and any(kept != subject for kept, _ in self._models):
                self._models.clear()
            self._models[key] = EnclaveModel(enclave, self._environment, domain)
        return self._models[key]


class Simulated(Transport):
    """A transport that decides as the standard, or as the model of a vendor.

    Args:
        name: the model's.
        environment: the clock, and what was read before in this run.
    """

    ADMITS = True

    def __init__(self, name: str, environment: Environment) -> None:
        self._variation = VARIATIONS[name]
        self._environment = environment

    def usable(self) -> Availability:
        """Return that it is usable."""
        version = "1.1" if self._variation is OMG else self._variation.name.rpartition("-")[2]
        return Availability(usable=True, version=version, tiers=(Tier.DECISION,))

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        models = EnclaveModels(enclaves, self._environment, self._variation, tier)
        for edge in edges:
            needed = endpoints(models.enclaves[edge.subject].distro, edge)
            yield edge, models.of(edge.subject, edge.domain).verdict(self._variation, needed)

    def admitted(self, enclave: InstalledEnclave, endpoints: Column, tier: Tier) -> bytes:
        """See :meth:`keymint.api.Transport.admitted`."""
        models = EnclaveModels([enclave], self._environment, self._variation, tier)
        domains = {each.domain for each in endpoints.requests}
        if len(domains) == 1:
            return models.of(enclave.subject, *domains).admitted(self._variation, endpoints)
        asked = ((models.of(enclave.subject, each.domain), each) for each in endpoints.requests)
        return bytes(model.decide(self._variation, each).allowed for model, each in asked)
