# SPDX-License-Identifier: Apache-2.0
"""The stage ``prove``: prove claims about installed enclaves. It writes nothing but the record of proofs.

The proof of an enclave whose claims were all proven is cached until its files, its policy or the tool change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from comarmor.errors import Diagnostic, Severity
from keymint import __version__
from keymint.api import BuildType, Claim, LoadedPolicy, Package, Proof, ProofTask, Prover, ValidityTerm
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.plan import authority_evidence, proof_record, terms
from keymint.plan.authority_files import trusted_chains
from keymint.plan.build_types import build_types_of, issuers_of, suffixes_read
from keymint.plan.enclaves import INSTALLED, enclave_files, not_installed
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
        cached: every claim was proven before, and nothing changed.
        diagnostics: files that could not be read, or that do not rest on the workspace's authorities.
        terms: when the documents are in force.
    """

    subject: str
    claims: tuple[Claim, ...]
    cached: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    terms: tuple[ValidityTerm, ...] = ()


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
    unsigned: bool = False,
) -> ProofResults:
    """Prove or refute the claims about the enclaves of some packages.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        policy: the policy that the enclaves are compared with.
        effort: limits of the search.
        on_enclave: called with each name after its proof.
        standard_only: accept differences between vendors and claim only what the standard says; nothing is recorded.
        unsigned: the documents are about to be signed: messages cite the unsigned ones in the build space.

    Raises:
        KeymintError: a package has defects.
    """
    run = _ProofRun(session, policy, effort, standard_only, unsigned)
    for name in names:
        run.prove(name)
        on_enclave(name)
    return run.results()


class _ProofRun:
    """Proves enclaves one by one, and collects the results."""

    def __init__(
        self,
        session: Session,
        policy: LoadedPolicy,
        effort: ProofEffort,
        standard_only: bool,
        unsigned: bool,
    ) -> None:
        self._session = session
        self._policy = policy
        self._effort = effort
        self._standard_only = standard_only
        self._unsigned = unsigned
        self._chains = trusted_chains(session)
        self._contradictions = authority_evidence.contradictions(session)
        self._policy_digest = digest(*(f"{path} {value.hex()}" for path, value in sorted(policy.seen.items())))
        self._proofs: list[EnclaveProof] = []
        self._stamps: dict[str, Stamp] = {}
        self._refuted: set[str] = set()
        self._assumptions: dict[str, Sequence[str]] = {}

    def results(self) -> ProofResults:
        """Return the results so far, and the record of them."""
        state = self._session.state
        if self._stamps or any(state.stamp(STAGE, name) for name in self._refuted):
            state = state.updated(STAGE, self._stamps, self._refuted)
        return ProofResults(tuple(self._proofs), state, self._assumptions, self._session.now)

    def prove(self, name: str) -> None:
        """Prove the claims about one enclave, unless the proof is cached."""
        session = self._session
        files, unread = enclave_files(session, name)
        stamp = session.state.stamp(STAGE, name)
        if defects := self._of_enclave(name, unread):
            self._proofs.append(EnclaveProof(f"/{name}", (), diagnostics=defects))
            self._refuted.add(name)
            return
        if self._contradictions and (
            contradictions := authority_evidence.contradictions_for(
                self._contradictions, issuers_of(session, session.package(name))
            )
        ):
            self._proofs.append(EnclaveProof(f"/{name}", (), diagnostics=contradictions))
            return
        inputs = self._inputs_digest(session.package_files(name), files)
        cached = proof_record.load(stamp, self._shown(name)) if stamp and stamp.inputs == inputs else None
        if stamp and cached and self._same_rules(name, stamp):
            claims, validity = cached
            # The cache does not depend on the clock: whether documents are in force is checked at each run.
            self._proofs.append(EnclaveProof(f"/{name}", claims, cached=True, terms=validity))
            for build_type in stamp.build_types:
                self._prover(session.plugins.build_type(build_type, session.package_marker(name)))
            return
        package = session.package(name)
        rules = _rules(self._policy, package.subject)
        proof = self._proof(package, rules, files)
        self._proofs.append(proof)
        if self._standard_only:
            return
        if proof.diagnostics or any(claim.proof is not Proof.PROVEN for claim in proof.claims):
            self._refuted.add(name)
        else:
            outputs = proof_record.dump(proof.claims, proof.terms, (rules,), self._shown(name))
            build_types = tuple(build_types_of(session, package))
            self._stamps[name] = Stamp(inputs, outputs, context=self._policy_digest, build_types=build_types)

    def _of_enclave(self, name: str, unread: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
        """Return the diagnostics of unreadable files that belong to the enclave, by the record or by their names."""
        if not unread:
            return ()
        suffixes = suffixes_read(self._session, self._session.package(name))
        stamp = self._session.state.stamp(INSTALLED, name)
        files = [each.where.file.rpartition("/")[2] if each.where else "" for each in unread]
        return tuple(
            each
            for each, file in zip(unread, files, strict=True)
            if stamp is None or file in {*stamp.outputs, ""} or file.endswith(suffixes)
        )

    def _same_rules(self, name: str, stamp: Stamp) -> bool:
        """Tell whether the policy has the same rules for a subject as when the stamp was made."""
        if stamp.context == self._policy_digest:
            return True
        if not proof_record.has_rules(stamp, (_rules(self._policy, f"/{name}"),)):
            return False
        self._stamps[name] = replace(stamp, context=self._policy_digest)
        return True

    def _shown(self, name: str) -> str:
        """Return the path of an enclave's files in messages, as the user would type it."""
        workspace = self._session.workspace
        folder = workspace.build if self._unsigned else self._session.enclaves
        return workspace.shown(folder / name)

    def _proof(self, package: Package, rules: SubjectRules, files: Mapping[str, bytes]) -> EnclaveProof:
        subject, folder = package.subject, self._shown(package.name)
        if not files:
            return EnclaveProof(subject, (), diagnostics=(not_installed(package.name, folder),))
        claims: list[Claim] = []
        validity: list[ValidityTerm] = []
        diagnostics: list[Diagnostic] = []
        for name, build_type in build_types_of(self._session, package).items():
            prover = self._prover(build_type)
            if prover is None:
                message, marker = f"the build type {name} proves nothing", self._session.package_marker(package.name)
                diagnostics.append(Diagnostic(NO_PROVER, Severity.ERROR, message, marker))
                continue
            try:
                anchors = anchors_of(self._session, package, build_type, self._chains)
                task = ProofTask(
                    package,
                    rules,
                    files,
                    folder,
                    anchors,
                    self._effort.states,
                    self._effort.deadline(),
                    self._standard_only,
                    self._unsigned,
                )
                own = prover.prove(task)
                terms_ = prover.terms(files, folder, anchors, task.shared, task.shared_folder)
            except KeymintError as error:
                diagnostics += error.diagnostics
                continue
            claims += own
            validity += terms.terms_of(terms_, {claim.model for claim in own})
        of_subject = tuple(replace(each, subject=subject) for each in dict.fromkeys(diagnostics))
        return EnclaveProof(subject, tuple(claims), diagnostics=of_subject, terms=tuple(dict.fromkeys(validity)))

    def _prover(self, build_type: BuildType) -> Prover | None:
        """Return a build type as a prover and keep its assumptions; None if it is none."""
        if not isinstance(build_type, Prover):
            return None
        self._assumptions.update(build_type.assumptions())
        return build_type

    def _inputs_digest(self, source: Mapping[str, bytes], files: Mapping[str, bytes]) -> str:
        """Return the digest of everything that a proof depends on, except the policy."""
        return digest(
            digest_files(files),
            digest_files(source),
            digest_files(self._chains),
            self._session.profile_digest,
            self._session.plugins.versions,
            __version__,
        )


def _rules(policy: LoadedPolicy, subject: str) -> SubjectRules:
    return policy.rules(subject) or SubjectRules(subject, ())
