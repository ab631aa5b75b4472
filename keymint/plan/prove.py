"""The stage ``prove``: prove claims about installed enclaves. It writes nothing but the record of proofs.

The proof of an enclave whose claims were all proven is cached until its files, its policy or the tool change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Severity
from keymint import __version__
from keymint.api import Claim, DomainRange, LoadedPolicy, Package, Proof, ProofTask, Prover, ValidityTerm
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.plan import authority_evidence, terms
from keymint.plan.authority_files import trusted_chains
from keymint.plan.enclaves import INSTALLED, TAKEN, enclave_files
from keymint.plan.trust_anchors import anchors_of
from keymint.session import Session
from keymint.state import Stamp, State, digest, digest_files

STAGE = "prove"
NO_PROVER = "proof-unsupported"
"""Code of the finding on an enclave whose build type proves nothing."""


@dataclass(frozen=True, slots=True)
class ProofEffort:
    """The limits of the search.

    Attributes:
        states: states that one search may visit.
        deadline: called for each enclave; returns a function that tells whether to continue.
    """

    states: int
    deadline: Callable[[], Callable[[], bool]]


@dataclass(frozen=True, slots=True)
class EnclaveProof:
    """The result for one enclave.

    Attributes:
        subject: its subject.
        claims: by model, action and domains; none if the enclave could not be read.
        remembered: the proof is cached: every claim was proven before, and nothing changed.
        diagnostics: files that could not be read, or that do not rest on the workspace's authorities.
        terms: when the documents are in force.
    """

    subject: str
    claims: tuple[Claim, ...]
    remembered: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    terms: tuple[ValidityTerm, ...] = ()

    def of_claim(self, claim: Claim) -> tuple[ValidityTerm, ...]:
        """Return the terms that a claim needs."""
        return terms.terms_of(self.terms, {claim.model})


@dataclass(frozen=True, slots=True)
class ProofResults:
    """The results for all enclaves.

    Attributes:
        enclaves: the result for each.
        state: the record to keep.
        assumptions: assumptions of the claims, by model.
        now: the time at which the claims are judged, UTC.
    """

    enclaves: tuple[EnclaveProof, ...]
    state: State
    assumptions: Mapping[str, Sequence[str]]
    now: datetime


def prove(
    session: Session,
    names: Sequence[str],
    policy: LoadedPolicy,
    effort: ProofEffort,
    on_enclave: Callable[[str], None] = lambda _name: None,
    *,
    standard_only: bool = False,
    folder: Callable[[str], Path] | None = None,
) -> ProofResults:
    """Prove or refute the claims about the enclaves of some packages.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        policy: the policy that the enclaves are compared with.
        effort: limits of the search.
        on_enclave: called with each name after its proof.
        standard_only: accept differences between vendors and claim only what the standard says; nothing is recorded.
        folder: the folder of a package's documents in messages, if not its enclave.

    Raises:
        KeymintError: a package has defects.
    """
    stage = _ProofRun(session, policy, effort, standard_only, folder)
    for name in names:
        stage.prove(name)
        on_enclave(name)
    return stage.results()


class _ProofRun:
    """Proves enclaves one by one, and collects the results."""

    def __init__(
        self,
        session: Session,
        policy: LoadedPolicy,
        effort: ProofEffort,
        standard_only: bool,
        folder: Callable[[str], Path] | None,
    ) -> None:
        self._session = session
        self._policy = policy
        self._effort = effort
        self._standard_only = standard_only
        self._folder = folder
        self._chains = trusted_chains(session)
        self._contradictions = authority_evidence.contradictions(session)
        self._seen = digest(*(f"{path} {value.hex()}" for path, value in sorted(policy.seen.items())))
        self._proofs: list[EnclaveProof] = []
        self._stamps: dict[str, Stamp] = {}
        self._refuted: set[str] = set()
        self._provers: set[str] = set()
        self._assumptions: dict[str, Sequence[str]] = {}

    def results(self) -> ProofResults:
        """Return the results so far, and the record of them."""
        state = self._session.state
        if self._stamps or any(state.stamp(STAGE, name) for name in self._refuted):
            state = state.updated(STAGE, self._stamps, self._refuted)
        return ProofResults(tuple(self._proofs), state, self._assumptions, self._session.now)

    def prove(self, name: str) -> None:
        """Prove the claims about one enclave, unless the proof is cached."""
        inputs = self._session
        folder = inputs.workspace.enclaves(self._session.profile.layout) / name
        source = self._session.package_files(name)
        files, unread = enclave_files(inputs, folder, f"/{name}")
        if defects := self._of_enclave(name, unread):
            self._proofs.append(EnclaveProof(f"/{name}", (), diagnostics=defects))
            self._refuted.add(name)
            return
        if self._contradictions and (
            contradictions := authority_evidence.contradictions_for(self._contradictions, self._session.package(name))
        ):
            self._proofs.append(EnclaveProof(f"/{name}", (), diagnostics=contradictions))
            return
        wanted = self._wanted(source, files)
        stamp = inputs.state.stamp(STAGE, name)
        known = terms.load(stamp.outputs.get(_TERMS, ""), self._shown(name)) if stamp is not None else None
        if stamp is not None and known is not None and stamp.inputs == wanted and self._same_rules(name, stamp):
            # The cache does not depend on the clock: whether documents are in force is checked at each run.
            self._proofs.append(EnclaveProof(f"/{name}", _cached_claims(stamp), remembered=True, terms=known))
            self._assume(stamp.outputs[_BUILD_TYPE], name)
            return
        package = self._session.package(name)
        rules = _rules(self._policy, package.subject)
        self._proofs.append(self._claimed(package, rules, files))
        if self._standard_only:
            return
        if self._proofs[-1].diagnostics or any(claim.proof is not Proof.PROVEN for claim in self._proofs[-1].claims):
            self._refuted.add(name)
        else:
            outputs = {_key(claim): "\n".join((claim.universe, *claim.excepted)) for claim in self._proofs[-1].claims}
            outputs[_RULES] = _meaning(rules)
            outputs[_TERMS] = terms.dump(self._proofs[-1].terms, self._shown(name))
            outputs[_BUILD_TYPE] = package.build_type
            self._stamps[name] = Stamp(wanted, outputs, context=self._seen)

    def _of_enclave(self, name: str, unread: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
        """Return the diagnostics of unreadable files that belong to the enclave, by the record or by their names."""
        stamp = self._session.state.stamp(INSTALLED, name)
        names = [found.where.file.rpartition("/")[2] if found.where else "" for found in unread]
        return tuple(
            found
            for found, file in zip(unread, names, strict=True)
            if stamp is None or file in {*stamp.outputs, ""} or file.endswith(TAKEN)
        )

    def _same_rules(self, name: str, stamp: Stamp) -> bool:
        """Tell whether the policy has the same rules for a subject as when the stamp was made."""
        if stamp.context == self._seen:
            return True
        if stamp.outputs.get(_RULES) != _meaning(_rules(self._policy, f"/{name}")):
            return False
        self._stamps[name] = replace(stamp, context=self._seen)
        return True

    def _shown(self, name: str) -> str:
        """Return the path of an enclave's files in messages, as the user would type it."""
        folder = self._session.workspace.enclaves(self._session.profile.layout) / name
        return self._session.workspace.shown(self._folder(name) if self._folder else folder)

    def _claimed(self, package: Package, rules: SubjectRules, files: Mapping[str, bytes]) -> EnclaveProof:
        inputs = self._session
        prover = self._assume(package.build_type, package.name)
        if prover is None:
            message = f"the build type {package.build_type} proves nothing"
            marker = inputs.package_marker(package.name)
            said = Diagnostic(NO_PROVER, Severity.ERROR, message, marker, "", package.subject)
            return EnclaveProof(package.subject, (), diagnostics=(said,))
        task = ProofTask(
            rules,
            package.distro,
            package.permissions.domains,
            files,
            self._shown(package.name),
            anchors_of(self._session, package, self._chains),
            self._effort.states,
            self._effort.deadline(),
            self._standard_only,
            package.governance,
        )
        return _prove(prover, task, package.name)

    def _assume(self, name: str, package: str) -> Prover | None:
        """Return the prover of a build type and keep its assumptions; None if the build type has no prover."""
        build_type = self._session.plugins.build_type(name, self._session.package_marker(package))
        if not isinstance(build_type, Prover):
            return None
        if name not in self._provers:
            self._provers.add(name)
            self._assumptions.update(build_type.assumptions())
        return build_type

    def _wanted(self, source: Mapping[str, bytes], files: Mapping[str, bytes]) -> str:
        """Return the digest of everything that a proof depends on, except the policy."""
        return digest(
            digest_files(files),
            digest_files(source),
            digest_files(self._chains),
            self._session.profile_digest,
            self._session.plugins.versions,
            __version__,
        )


_RULES, _BUILD_TYPE, _TERMS = "rules", "build type", "terms"
"""Keys of a stamp that are not claims."""


def _rules(policy: LoadedPolicy, subject: str) -> SubjectRules:
    return policy.rules(subject) or SubjectRules(subject, ())


def _meaning(rules: SubjectRules) -> str:
    """Return a digest of rules, independent of where they are written."""
    return digest(*(repr((r.effect, r.kind, r.permissions, r.expressions, r.partitions)) for r in rules.rules))


def _prove(prover: Prover, task: ProofTask, name: str) -> EnclaveProof:
    subject = task.rules.subject
    if not task.files:
        message, help_ = f"the enclave {subject} is not installed", f"run 'keymint install {name}'"
        said = Diagnostic("enclave-missing", Severity.ERROR, message, Origin(task.folder), help_, subject)
        return EnclaveProof(subject, (), diagnostics=(said,))
    try:
        claims = tuple(prover.prove(task))
        documents_terms = prover.terms(task.files, task.folder, task.anchors)
    except KeymintError as error:
        return EnclaveProof(
            subject, (), diagnostics=tuple(replace(each, subject=subject) for each in error.diagnostics)
        )
    return EnclaveProof(subject, claims, terms=terms.terms_of(documents_terms, {claim.model for claim in claims}))


def _key(claim: Claim) -> str:
    domains = ",".join(f"{each.first}-{each.last}" for each in claim.domains)
    return f"{claim.model} {claim.action} {domains}"


def _cached_claims(stamp: Stamp) -> tuple[Claim, ...]:
    """Return the proven claims that a stamp has."""
    claims: list[Claim] = []
    for key, value in stamp.outputs.items():
        if key not in {_RULES, _BUILD_TYPE, _TERMS}:
            universe, *excepted = value.split("\n")
            model, action, ranges = key.rsplit(" ", 2)
            ends = (each.split("-") for each in ranges.split(","))
            domains = tuple(DomainRange(int(first), int(last)) for first, last in ends)
            claims.append(Claim(model, action, domains, universe, Proof.PROVEN, excepted=tuple(excepted)))
    return tuple(claims)
