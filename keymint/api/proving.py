"""Proving: what is claimed of installed documents over all names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic, Origin
from keymint.api.packages import DomainRange, Governance
from keymint.api.policies import PolicyDecision
from keymint.api.transports import Verdict
from keymint.graph import Edge
from keymint.ir import SubjectRules


@dataclass(frozen=True, slots=True)
class TrustAnchor:
    """An authority of the workspace that an enclave must trust.

    Attributes:
        name: its name in the profile.
        file: its certificate, as the user would type it.
        chain: PEM of its certificate, followed by those of the authorities above it; empty if the workspace has none.
    """

    name: str
    file: str
    chain: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class TrustAnchors:
    """What an enclave must rest on. It comes from the workspace: an enclave cannot vouch for itself.

    Attributes:
        identity: the authority that issues the identity's certificate.
        permissions: the authority that signs permissions and governance.
        subject_name: the identity's distinguished name, as the package says it.
        layout: ``sros2`` or ``flat``.
    """

    identity: TrustAnchor
    permissions: TrustAnchor
    subject_name: str
    layout: str


@dataclass(frozen=True, slots=True)
class ProofTask:
    """What is to be proven: the documents of an enclave permit exactly what a policy says, over all names.

    Attributes:
        rules: what the policy says of the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the policy holds.
        files: the enclave's files by name, as they are installed.
        folder: the enclave's folder as the user would type it.
        anchors: the authorities that the enclave must rest on.
        states: how many states a question may visit.
        go_on: asked again and again; a question is given up when it returns False.
        standard_only: claims about vendors are not wanted, as what they decide differently is accepted.
        governance: what the sources say of the protection of domains and topics; None where that is not known, and
            nothing may be left open.
    """

    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    files: Mapping[str, bytes] = field(repr=False)
    folder: str
    anchors: TrustAnchors
    states: int
    go_on: Callable[[], bool]
    standard_only: bool = False
    governance: Governance | None = None


class Proof(StrEnum):
    """How a claim stands; one that is unknown is not proven."""

    PROVEN = "proven"
    COUNTEREXAMPLE = "counterexample"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Counterexample:
    """A name about which policy and document differ; none is shorter.

    Attributes:
        endpoint: the edge of kind ``topic``, with its partition if that matters.
        meaning: the edge on a ROS name that needs it, or None.
        policy: what the policy says, and by which rule.
        document: what the document says, and in which of its lines.
        help: how to mend it, if it is not the permissions that are wrong.
    """

    endpoint: Edge
    meaning: Edge | None
    policy: PolicyDecision
    document: Verdict
    help: str = ""


@dataclass(frozen=True, slots=True)
class Claim:
    """That the documents, as a model reads them, permit an action exactly where the policy does.

    Attributes:
        model: whose reading: the standard's, or a vendor's.
        action: ``publish`` or ``subscribe``. Only where it does not hold: ``join``, that no participant is let into a
            domain without a rule, and ``protect``, that topics are protected as the sources say.
        domains: the DDS domains it is about.
        universe: the names it is about, in words.
        proof: how it stands.
        reason: why it is unknown, in one line.
        spent: it is unknown since it was given up; with more states, or time, it may be decided.
        counterexample: if there is one.
        excepted: what the governance leaves open on purpose, one line each: it is no part of the claim.
    """

    model: str
    action: str
    domains: tuple[DomainRange, ...]
    universe: str
    proof: Proof
    reason: str = ""
    counterexample: Counterexample | None = None
    spent: bool = False
    excepted: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ValidityTerm:
    """When something holds without which an enclave is permitted nothing: a certificate, or its grants.

    Attributes:
        code: ``certificate``, ``authority``, ``grant`` or ``revocation-list``.
        what: the same in words, with its name.
        where: its place.
        periods: when it holds, both ends included; sorted, and apart from each other. None at all is never.
        models: whose reading that is; empty: everybody's.
    """

    code: str
    what: str
    where: Origin
    periods: tuple[tuple[datetime, datetime], ...]
    models: tuple[str, ...] = ()


@runtime_checkable
class Prover(Protocol):
    """What a build type may offer beside :class:`BuildType`: proofs about what it installs."""

    def assumptions(self) -> Mapping[str, Sequence[str]]:
        """Return what every claim takes for granted, one line each, by model: that of the standard first."""

    def differences(self, files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> Sequence[Diagnostic]:
        """Return what does not rest on the workspace's authorities; each is an error, and its code is stable.

        Args:
            files: an enclave's files by name.
            folder: its folder as the user would type it.
            anchors: what it must rest on.
        """

    def terms(self, files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> Sequence[ValidityTerm]:
        """Return the times in which an enclave is permitted anything, as each model reads dates; no clock is read.

        Args:
            files: an enclave's files by name.
            folder: its folder as the user would type it.
            anchors: what it must rest on.

        Raises:
            KeymintError: a file cannot be read, or does not rest on the anchors.
        """

    def prove(self, task: ProofTask) -> Sequence[Claim]:
        """Return a claim for each model, action and group of domains.

        Raises:
            KeymintError: the enclave has no document that can be read, or does not rest on its anchors.
        """
