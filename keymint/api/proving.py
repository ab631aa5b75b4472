# SPDX-License-Identifier: Apache-2.0

"""Provers: prove that installed documents permit exactly what the policy allows, for all names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING

from comarmor.values import Data, field
from keymint.api.packages import DomainRange, Package
from keymint.api.policies import PolicyDecision
from keymint.errors import Diagnostic, Origin
from keymint.ir import Rule, SubjectRules

if TYPE_CHECKING:
    from keymint.api.graph import Edge
    from keymint.api.transports import Endpoint, Verdict


class TrustAnchor(Data):
    """An authority of the workspace that an enclave must trust.

    Attributes:
        name: its name in the profile.
        file: its certificate, as the user would type it.
        chain: PEM of its certificate, followed by those of the authorities above it; empty if the workspace has none.
    """

    name: str
    file: str
    chain: bytes = field(repr=False)


class TrustAnchors(Data):
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


class EnclaveFiles(Data):
    """The installed files of an enclave, and what they must rest on.

    Attributes:
        files: the files by name, those of other build types included.
        folder: the enclave's folder as the user would type it.
        anchors: the authorities that the enclave must trust.
        shared: installed shared documents of the build type, and what belongs to them, by path.
        shared_folder: the folder that these paths are relative to, as the user would type it.
    """

    files: Mapping[str, bytes] = field(repr=False)
    folder: str
    anchors: TrustAnchors
    shared: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    shared_folder: str = ""


class ProofTask(Data):
    """A proof to attempt: the documents of an enclave permit exactly what the policy allows, for all names.

    Attributes:
        package: the package of the enclave, with the distribution and the domains in which the policy applies.
        rules: the policy's rules for the subject.
        enclave: the files of the enclave.
        states: the most states that the search for one claim may visit.
        go_on: polled; the search ends when it returns False.
        standard_only: omit the claims about vendors, because their deviations are accepted.
        unsigned: the documents are about to be signed: cite the unsigned ones, in the folders of the enclave.
    """

    package: Package
    rules: SubjectRules
    enclave: EnclaveFiles
    states: int
    go_on: Callable[[], bool]
    standard_only: bool = False
    unsigned: bool = False


class SharedProofTask(Data):
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


class ComparisonTask(Data):
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


class Proof(StrEnum):
    """The result of a proof; a claim that is unknown is not proven."""

    PROVEN = "proven"
    COUNTEREXAMPLE = "counterexample"
    UNKNOWN = "unknown"


class Counterexample(Data):
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


class Claim(Data):
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


class ValidityTerm(Data):
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


class InstalledRights(Data):
    """What the documents of an enclave grant.

    Attributes:
        rules: rules in which DENY overrides ALLOW, each of one permission without parts and one expression, on names of
            the application where the documents say so; their places are those of the documents.
        domains: the domains in which they apply.
    """

    rules: tuple[Rule, ...]
    domains: tuple[DomainRange, ...]


class Prover(ABC):
    """Proves claims about installed documents."""

    @abstractmethod
    def assumptions(self) -> Mapping[str, Sequence[str]]:
        """Return the assumptions of every claim, one line each, by model; the standard comes first."""

    @abstractmethod
    def differences(self, enclave: EnclaveFiles) -> Sequence[Diagnostic]:
        """Return an error for each file that the workspace's authorities do not vouch for; their codes are stable."""

    @abstractmethod
    def terms(self, enclave: EnclaveFiles) -> Sequence[ValidityTerm]:
        """Return the periods in which an enclave is permitted anything, as each model reads dates; reads no clock.

        Raises:
            KeymintError: a file cannot be read, or the anchors do not vouch for it.
        """

    @abstractmethod
    def prove(self, task: ProofTask) -> Sequence[Claim]:
        """Return a claim for each model, action and group of domains.

        Raises:
            KeymintError: no document of the enclave can be read, or the anchors do not vouch for it.
        """

    def rights(
        self, enclave: EnclaveFiles, subject: str, built: Mapping[str, bytes] | None = None
    ) -> InstalledRights | None:
        """Return what an enclave is granted by its signed documents, or by documents that are about to be signed.

        What a run takes from a subject is told, and asked for, only if its build type has this method.

        Args:
            enclave: the enclave.
            subject: its subject.
            built: the unsigned documents by name, shared ones by path, for the subject name of the anchors; None for
                those that are installed, for the name of the installed certificate.

        Returns:
            The rights; None if there is no such document.

        Raises:
            KeymintError: the anchors do not vouch for a document, it cannot be read, or no policy can say what it
                grants.
        """
        del enclave, subject, built
        return None
