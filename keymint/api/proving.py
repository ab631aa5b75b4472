# SPDX-License-Identifier: Apache-2.0
"""Provers: prove that installed documents permit exactly what the policy allows, for all names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from datetime import datetime
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from comarmor.errors import Diagnostic, Origin
from comarmor.values import dataclass
from keymint.api.graph import Edge
from keymint.api.packages import DomainRange, Package
from keymint.api.policies import PolicyDecision
from keymint.api.transports import Endpoint, Verdict
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
    """The trust anchors of an enclave. They come from the workspace, because an enclave cannot vouch for itself.

    Attributes:
        authorities: by role, as :meth:`keymint.api.BuildType.authorities` names them.
        subject_name: the identity's distinguished name, from the package.
        layout: name of the layout.
        public_key: the subject's public key (PEM), from the package, if its private key is elsewhere; then the enclave
            need not have that, and its certificate must be for this key. Empty if the workspace has the private key.
        key_uri: URI of the private key in the subject's token, from the package; empty if it lies in a file.
        distro: ROS 2 distribution, whose nodes may look for other files, and whose vendors have other versions.
    """

    authorities: Mapping[str, TrustAnchor]
    subject_name: str
    layout: str
    public_key: bytes = b""
    key_uri: str = ""
    distro: str = ""


@dataclass(frozen=True, slots=True)
class ProofTask:
    """A proof to attempt: the documents of an enclave permit exactly what the policy allows, for all names.

    Attributes:
        package: the package of the enclave, with the distribution and the domains in which the policy applies.
        rules: the policy's rules for the subject.
        files: the enclave's installed files by name, those of other build types included.
        folder: the enclave's folder as the user would type it.
        anchors: the authorities that the enclave must trust.
        states: the most states that the search for one claim may visit.
        go_on: polled; the search ends when it returns False.
        standard_only: omit the claims about vendors, because their deviations are accepted.
        unsigned: the documents are about to be signed: cite the unsigned ones, in ``folder`` and ``shared_folder``.
        shared: installed shared documents of the build type, and what belongs to them, by path.
        shared_folder: the folder that these paths are relative to, as the user would type it.
    """

    package: Package
    rules: SubjectRules
    files: Mapping[str, bytes] = field(repr=False)
    folder: str
    anchors: TrustAnchors
    states: int
    go_on: Callable[[], bool]
    standard_only: bool = False
    unsigned: bool = False
    shared: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    shared_folder: str = ""


@dataclass(frozen=True, slots=True)
class SharedProofTask:
    """A proof of claims across subjects to attempt.

    Attributes:
        packages: all packages of the build type, infrastructure included, sorted by name.
        rules: the policy's rules by subject.
        enclaves: files of each installed enclave by subject.
        folder: the folder of all enclaves as the user would type it.
        shared: installed shared documents of the build type, and what belongs to them, by path.
        shared_folder: the folder that these paths are relative to, as the user would type it.
        anchors: the authorities by role; the chains that the packages have in a role, each once.
        states: the most states that the search for one claim may visit.
        go_on: polled; the search ends when it returns False.
        unsigned: the documents are about to be signed: cite the unsigned ones, in ``folder`` and ``shared_folder``.
    """

    packages: Sequence[Package]
    rules: Mapping[str, SubjectRules]
    enclaves: Mapping[str, Mapping[str, bytes]] = field(repr=False)
    folder: str
    shared: Mapping[str, bytes] = field(repr=False)
    shared_folder: str
    anchors: Mapping[str, TrustAnchor]
    states: int
    go_on: Callable[[], bool]
    unsigned: bool = False


class Proof(StrEnum):
    """The result of a proof; a claim that is unknown is not proven."""

    PROVEN = "proven"
    COUNTEREXAMPLE = "counterexample"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Counterexample:
    """A shortest name on which policy and document differ.

    Attributes:
        endpoint: the action and the shortest name, with its partition if that matters.
        meaning: the edge on a ROS name that the endpoint implements, or None.
        policy: the policy's decision, with its rule.
        document: the document's decision, with its place.
        help: how to fix it, if the rules are not the cause.
        cause: the place to fix, if the rules are not the cause.
        difference: what differs, in words; empty if the document permits the endpoint and the policy does not, or the
            other way round.
    """

    endpoint: Endpoint
    meaning: Edge | None
    policy: PolicyDecision
    document: Verdict
    help: str = ""
    cause: Origin | None = None
    difference: str = ""


@dataclass(frozen=True, slots=True)
class Claim:
    """The claim that the documents, as a model reads them, permit an action exactly where the policy allows it.

    Attributes:
        model: the standard, or a vendor.
        action: the action, in the words of the prover; or what else it proves, e.g. that nobody else may join.
        domains: the domains that the claim covers.
        universe: the names that the claim covers, in words.
        proof: the result.
        reason: why it is unknown, in one line.
        spent: it is unknown because a limit was reached; with more states or time it may be decided.
        counterexample: if there is one.
        excepted: what the claim excludes, because the sources leave it open or the transport cannot decide it; one line
            each.
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
    """The validity of a certificate or grant without which an enclave is permitted nothing.

    Attributes:
        code: ``certificate``, ``authority``, ``grant`` or ``revocation-list``.
        what: description with the name.
        where: its place.
        periods: periods of validity, both ends included, sorted and disjoint; empty if it is never valid.
        models: the models that read the dates so; empty for all.
    """

    code: str
    what: str
    where: Origin
    periods: tuple[tuple[datetime, datetime], ...]
    models: tuple[str, ...] = ()


@runtime_checkable
class InstalledDistro(Protocol):
    """Optional capability of a build type: signed documents tell for which distribution they were made."""

    def distro_of(self, paths: Iterable[str], content: Callable[[str], bytes | None]) -> str:
        """Return the distribution of the signed documents among some files, or an empty text if they do not tell it.

        Args:
            paths: the paths of the files.
            content: returns the content of a file; None if it cannot be read.
        """


@dataclass(frozen=True, slots=True)
class Holder:
    """A certificate in force. Whoever has its key may present any document that is signed for its name.

    Attributes:
        subject: the subject that it is for; empty if no package has this name.
        name: its distinguished name in certificate order, as :func:`keymint.pki.distinguished_names.parse` reads it.
        until: its end, UTC.
        rules: the policy's rules for the subject; none if no profile names it.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the rules apply.
    """

    subject: str
    name: str
    until: datetime
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]


@dataclass(frozen=True, slots=True)
class PresentableDocument:
    """A document that an authority of the workspace signed, so that a holder may present it.

    Attributes:
        content: what is signed.
        where: its file, as the user would type it.
        lines_before: number of lines before the content in that file.
        proven_for: name of the certificate beside it, whose rights are proven apart; empty if there is none.
    """

    content: bytes = field(repr=False)
    where: Origin
    lines_before: int = 0
    proven_for: str = ""


@dataclass(frozen=True, slots=True)
class PresentationTask:
    """The question which holders are permitted something beyond the policy by a document that they may present.

    Attributes:
        holders: all certificates in force.
        documents: all signed documents; of two with the same content the first one counts.
        now: the time from which on documents count, UTC.
        states: the most states that the search for one answer may visit.
        go_on: polled; the search ends when it returns False.
        distro: ROS 2 distribution for whose vendors each enclave is proven apart; empty: that of the holder.
    """

    holders: Sequence[Holder]
    documents: Sequence[PresentableDocument]
    now: datetime
    states: int
    go_on: Callable[[], bool]
    distro: str = ""


@dataclass(frozen=True, slots=True)
class ExcessRights:
    """A holder is permitted something beyond the policy, or may be, by a document that it may present.

    Attributes:
        holder: the holder.
        document: the document.
        claims: the claims that fail, by model.
        until: the end of the document or of the certificate, UTC.
    """

    holder: Holder
    document: PresentableDocument
    claims: tuple[Claim, ...]
    until: datetime


@runtime_checkable
class Presentation(Protocol):
    """Optional capability of a build type whose enclaves present signed documents to each other."""

    PRESENTED: str
    """Name of the file of an enclave that they present."""

    def presented_until(self, content: bytes) -> datetime | None:
        """Return the end of the rights that a signed document grants, UTC; None if it grants none to anybody.

        Args:
            content: what is signed.
        """

    def choosers(self) -> Sequence[str]:
        """Return the models that choose the rights in a document, each by its own comparison of names."""

    def trusting_any_signer(self) -> Sequence[str]:
        """Return the models that take a document whose signer the right authority certified as anybody at all."""

    def excess(self, task: PresentationTask) -> Sequence[ExcessRights]:
        """Return every holder and document by which an implementation permits more than the policy."""


@runtime_checkable
class Prover(Protocol):
    """Optional capability of a build type: proofs about installed documents."""

    def assumptions(self) -> Mapping[str, Sequence[str]]:
        """Return the assumptions of every claim, one line each, by model; the standard comes first."""

    def differences(
        self,
        files: Mapping[str, bytes],
        folder: str,
        anchors: TrustAnchors,
        shared: Mapping[str, bytes],
        shared_folder: str,
    ) -> Sequence[Diagnostic]:
        """Return an error for each file that the workspace's authorities do not vouch for; their codes are stable.

        Args:
            files: an enclave's files by name, those of other build types included.
            folder: its folder as the user would type it.
            anchors: the authorities that it must trust.
            shared: installed shared documents of the build type, and what belongs to them, by path.
            shared_folder: the folder that these paths are relative to, as the user would type it.
        """

    def terms(
        self,
        files: Mapping[str, bytes],
        folder: str,
        anchors: TrustAnchors,
        shared: Mapping[str, bytes],
        shared_folder: str,
    ) -> Sequence[ValidityTerm]:
        """Return the periods in which an enclave is permitted anything, as each model reads dates; reads no clock.

        The arguments are those of :meth:`differences`.

        Raises:
            KeymintError: a file cannot be read, or the anchors do not vouch for it.
        """

    def prove(self, task: ProofTask) -> Sequence[Claim]:
        """Return a claim for each model, action and group of domains.

        Raises:
            KeymintError: no document of the enclave can be read, or the anchors do not vouch for it.
        """


@runtime_checkable
class RemoteProver(Protocol):
    """Optional capability of a prover: what is costly, and needs no secret, can be proven on other machines."""

    def question(self, task: ProofTask) -> object:
        """Verify the files of an enclave as :meth:`Prover.prove` does, and return what is to be proven, as plain data.

        Raises:
            KeymintError: the files cannot be read, or the anchors do not vouch for them.
        """

    def proving(self) -> Callable[[Any, Sequence[Any]], Sequence[Sequence[Claim]]]:
        """Return the function of a module that a worker calls with questions; claims for each, or none."""

    def know(self, question: Any, claims: Sequence[Claim]) -> None:
        """Keep proven claims for :meth:`Prover.prove`, which decides all others itself."""


# -- comparison of a document that is in force with the rules of a policy: which of them permits more, and where ------


class Relation(StrEnum):
    """How what a document permits is related to what rules allow, over all names.

    ``narrower``: it permits less, and nothing else; ``wider``: it permits all of it, and more; ``different``: each has
    something that the other lacks; ``unknown``: the document cannot be read, or the comparison was given up.
    """

    EQUAL = "equal"
    NARROWER = "narrower"
    WIDER = "wider"
    DIFFERENT = "different"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class ComparisonTask:
    """A document to compare with rules.

    Attributes:
        document: the document, unsigned; its signature was verified.
        file: its file, for places.
        offset: number of lines before it in that file, e.g. the header of a signed one.
        subject_name: distinguished name of the identity, in the order of RFC 2253, e.g. ``CN=/talker,OU=0f``.
        rules: the rules of the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the rules apply; elsewhere nothing is allowed.
        states: the most states that the search for one answer may visit.
        go_on: polled; the search ends when it returns False.
    """

    document: bytes = field(repr=False)
    file: str
    offset: int
    subject_name: str
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    states: int
    go_on: Callable[[], bool]


@dataclass(frozen=True, slots=True)
class DocumentComparison:
    """What a comparison found.

    Attributes:
        relation: the relation of the document to the rules.
        missing: a shortest name for which the rules allow something that the document does not permit, or None.
        excess: a shortest name for which the document permits something that the rules do not allow, or None.
        reason: why the relation is unknown; else empty.
    """

    relation: Relation
    missing: Counterexample | None = None
    excess: Counterexample | None = None
    reason: str = ""


@runtime_checkable
class DocumentComparer(Protocol):
    """Optional capability of a build type: compares a document of an enclave with rules."""

    def compared(self, task: ComparisonTask) -> DocumentComparison:
        """Compare a document, as the transport's standard reads it, with the rules of a subject.

        Dates are not compared: each grant that is ever in force must permit what the rules allow.

        Raises:
            KeymintError: a rule cannot be mapped; with ``file:line``. A document that cannot be read is ``unknown``.
        """

    def compared_with(self, content: bytes, name: str, package: Package) -> DocumentComparison:
        """Compare a signed document, as the transport's standard reads it, with the rules of a package.

        Args:
            content: what is signed.
            name: distinguished name of the certificate that it is presented with; see :attr:`keymint.api.Holder.name`.
            package: the package.

        Raises:
            KeymintError: a rule cannot be mapped. A document that cannot be read is ``unknown``.
        """
