"""Simulated transports: the decision point on the signed documents of installed enclaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path

from comarmor.errors import Origin
from keymint.api import Availability, Enclave, Environment, Tier, Verdict
from keymint.errors import KeymintError
from keymint.graph import Edge
from keymint.pki import smime
from keymint_ros2_dds import decision
from keymint_ros2_dds.decision import OMG, DecisionOutcome, DocumentEvaluator, EndpointDecision, Variation
from keymint_ros2_dds.decision.access import DomainAccess
from keymint_ros2_dds.layout import CERTIFICATE, GOVERNANCE_P7S, PERMISSIONS_P7S
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.reading import signed_governance
from keymint_ros2_dds.transports import enclave_files


class EnclaveModel:
    """Decides about one enclave in one domain, by the standard and by every implementation.

    Args:
        folder: the enclave's folder.
        now: the clock, UTC.
        domain: DDS domain id.

    Raises:
        KeymintError: a signed file is in a form that is not read here, though a vendor may read it.
    """

    def __init__(self, folder: Path, now: datetime, domain: int) -> None:
        self._folder = folder
        self._now = now
        self._domain = domain
        self._known: dict[str, tuple[DocumentEvaluator, DomainAccess]] = {}
        self.refusal = ""
        try:
            authority = enclave_files.authority(folder, permissions=True)
            signed = {name: enclave_files.content(folder, name) for name in (PERMISSIONS_P7S, GOVERNANCE_P7S)}
            verified = {
                name: smime.verify(content, authority, at=now, where=Origin(name)) for name, content in signed.items()
            }
            self._document = decision.read(verified[PERMISSIONS_P7S])
            self._governance = signed_governance.read(verified[GOVERNANCE_P7S])
            self._subject_name = enclave_files.subject_name(
                enclave_files.content(folder, CERTIFICATE), Origin(CERTIFICATE)
            )
        except KeymintError as error:
            enclave_files.raise_if_unread(error, folder)
            self.refusal = str(error)

    @cached_property
    def document(self) -> decision.PermissionsDocument:
        """The permissions document; only if there is no refusal."""
        return self._document

    def decide(self, variation: Variation, endpoint: Edge) -> EndpointDecision:
        """Return what is decided about an endpoint, an edge of kind ``topic``."""
        if self.refusal:
            return EndpointDecision(DecisionOutcome.ERROR, 0, self.refusal)
        evaluator, governed = self._read(variation)
        found = endpoint.object
        return governed.decide(evaluator, endpoint.permission, found.name, found.partitions)

    def _read(self, variation: Variation) -> tuple[DocumentEvaluator, DomainAccess]:
        known = self._known.get(variation.name)
        if known is None:
            evaluator = DocumentEvaluator(self._document, self._subject_name, self._now, self._domain, variation)
            governed = DomainAccess.of(self._governance, self._domain, evaluator.semantics)
            known = self._known[variation.name] = evaluator, governed
        return known

    def deviation(self, variation: Variation, endpoint: Edge, *, allowed: bool) -> str:
        """Return which deviations explain that an implementation does not decide as the standard does.

        Args:
            variation: the model of the implementation.
            endpoint: an edge of kind ``topic``.
            allowed: what the implementation decided; empty when the model or the standard has it otherwise.
        """
        if self.refusal or allowed == self.decide(OMG, endpoint).allowed:
            return ""
        if self.decide(variation, endpoint).allowed != allowed:
            return ""
        found = decision.explain(lambda asked: self.decide(asked, endpoint).allowed, variation)
        return "; ".join(map(str, found))


class EnclaveModels:
    """The models of the subjects of edges; as edges come grouped by subject, only those of one subject are kept."""

    def __init__(self, enclaves: Sequence[Enclave], now: datetime) -> None:
        self._enclaves = enclave_files.by_subject(enclaves)
        self._now = now
        self._subject = ""
        self._models: dict[int, EnclaveModel] = {}

    def enclave(self, subject: str) -> Enclave:
        """Return the enclave of a subject.

        Raises:
            KeymintError: there is none.
        """
        if subject not in self._enclaves:
            raise KeymintError(
                f"{subject} has no installed enclave", help="run 'keymint install'", code="enclave-missing"
            )
        return self._enclaves[subject]

    def of(self, subject: str, domain: int) -> EnclaveModel:
        """Return the enclave_model of a subject in a domain.

        Raises:
            KeymintError: the subject has no enclave.
        """
        enclave = self.enclave(subject)
        if subject != self._subject:
            self._subject, self._models = subject, {}
        if domain not in self._models:
            self._models[domain] = self.fresh(enclave, domain)
        return self._models[domain]

    def fresh(self, enclave: Enclave, domain: int) -> EnclaveModel:
        """Return a enclave_model of an enclave that is the caller's to keep."""
        return EnclaveModel(enclave.folder, self._now, domain)


@dataclass(frozen=True, slots=True)
class Simulated:
    """A transport that is the standard, or the model of an implementation."""

    variation: Variation
    now: datetime

    @classmethod
    def of(cls, name: str, environment: Environment) -> Simulated:
        """Return the simulated transport of this name."""
        return cls(decision.VARIATIONS[name], environment.now)

    def usable(self) -> Availability:
        """Tell that it is."""
        versions = {"omg": "1.1"}
        version = versions.get(self.variation.name) or self.variation.name.rpartition("-")[2]
        return Availability(usable=True, version=version, tiers=(Tier.DECISION,))

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        del tier
        models = EnclaveModels(enclaves, self.now)
        for edge in edges:
            enclave_model = models.of(edge.subject, edge.domain)
            yield edge, self._verdict(enclave_model, endpoints(models.enclave(edge.subject).distro, edge))

    def _verdict(self, enclave_model: EnclaveModel, needed: Sequence[Edge]) -> Verdict:
        deviation = ""
        verdict = Verdict(allowed=False, reason="no DDS endpoint stands for this")
        for endpoint in needed:
            found = enclave_model.decide(self.variation, endpoint)
            deviation = deviation or enclave_model.deviation(self.variation, endpoint, allowed=found.allowed)
            verdict = Verdict(found.allowed, found.reason, found.line, deviation, found.where)
            if not found.allowed:
                break
        return verdict
