"""The stage ``prove``: claims about installed enclaves. It writes nothing but the record of what was proven.

An enclave whose every claim was proven is not looked at again until its files, the policy on it, or the tool change.
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
from keymint.plan.authorities import trusted_chains
from keymint.plan.enclaves import INSTALLED, TAKEN, enclave_files
from keymint.plan.trust_anchors import anchors_of
from keymint.session import Session
from keymint.state import Stamp, State, digest, digest_files

STAGE = "prove"
NO_PROVER = "proof-unsupported"
"""Code of the finding on an enclave whose build type proves nothing."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much may be spent.

    Attributes:
        states: states that a question may visit.
        deadline: called for each enclave; returns what tells whether to go on.
    """

    states: int
    deadline: Callable[[], Callable[[], bool]]


@dataclass(frozen=True, slots=True)
class Proven:
    """What is known of one enclave.

    Attributes:
        subject: its subject.
        claims: by model, action and domains; none if the enclave could not be read.
        remembered: every claim was proven before, and nothing changed.
        diagnostics: what could not be read, or does not rest on the workspace's authorities.
        terms: when what was claimed is in force.
    """

    subject: str
    claims: tuple[Claim, ...]
    remembered: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    terms: tuple[ValidityTerm, ...] = ()

    def of_claim(self, claim: Claim) -> tuple[ValidityTerm, ...]:
        """Return the terms that a claim needs."""
        return terms.read_by(self.terms, {claim.model})


@dataclass(frozen=True, slots=True)
class Findings:
    """What is known of all enclaves.

    Attributes:
        enclaves: what is known of each.
        state: the record to keep.
        assumptions: what the claims take for granted, by model.
        now: the time at which the claims are judged, UTC.
    """

    enclaves: tuple[Proven, ...]
    state: State
    assumptions: Mapping[str, Sequence[str]]
    now: datetime


def prove(
    session: Session,
    names: Sequence[str],
    policy: LoadedPolicy,
    effort: Effort,
    on_enclave: Callable[[str], None] = lambda _name: None,
    *,
    standard_only: bool = False,
    folder: Callable[[str], Path] | None = None,
) -> Findings:
    """Prove, or refute, the claims about the enclaves of some packages.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        policy: what the enclaves are held against.
        effort: how much may be spent.
        on_enclave: called with each name when it is done.
        standard_only: claim nothing of vendors, as their differences are accepted; nothing is recorded then.
        folder: where messages say that the documents of a package lie, if not in its enclave.

    Raises:
        KeymintError: a package has defects.
    """
    stage = _Stage(session, policy, effort, standard_only, folder)
    for name in names:
        stage.prove(name)
        on_enclave(name)
    return stage.findings()


class _Stage:
    """What is found out so far."""

    def __init__(
        self,
        session: Session,
        policy: LoadedPolicy,
        effort: Effort,
        standard_only: bool,
        folder: Callable[[str], Path] | None,
    ) -> None:
        self._session = session
        self._policy = policy
        self._effort = effort
        self._standard_only = standard_only
        self._folder = folder
        self._chains = trusted_chains(session)
        self._doubts = authority_evidence.doubts(session)
        self._seen = digest(*(f"{path} {value.hex()}" for path, value in sorted(policy.seen.items())))
        self._found: list[Proven] = []
        self._stamps: dict[str, Stamp] = {}
        self._refuted: set[str] = set()
        self._provers: set[str] = set()
        self._assumptions: dict[str, Sequence[str]] = {}

    def findings(self) -> Findings:
        """Return what was found, and the record of it."""
        state = self._session.state
        if self._stamps or any(state.stamp(STAGE, name) for name in self._refuted):
            state = state.updated(STAGE, self._stamps, self._refuted)
        return Findings(tuple(self._found), state, self._assumptions, self._session.now)

    def prove(self, name: str) -> None:
        """Prove the claims about one enclave, unless they are known."""
        inputs = self._session
        folder = inputs.workspace.enclaves(self._session.profile.layout) / name
        source = self._session.package_files(name)
        files, unread = enclave_files(inputs, folder, f"/{name}")
        if defects := self._of_enclave(name, unread):
            self._found.append(Proven(f"/{name}", (), diagnostics=defects))
            self._refuted.add(name)
            return
        if self._doubts and (doubts := authority_evidence.about(self._doubts, self._session.package(name))):
            self._found.append(Proven(f"/{name}", (), diagnostics=doubts))
            return
        wanted = self._wanted(source, files)
        stamp = inputs.state.stamp(STAGE, name)
        known = terms.load(stamp.outputs.get(_TERMS, ""), self._shown(name)) if stamp is not None else None
        if stamp is not None and known is not None and stamp.inputs == wanted and self._same_rules(name, stamp):
            # Only what does not depend on the clock is remembered. Whether it is in force is judged at each run.
            self._found.append(Proven(f"/{name}", _recalled(stamp), remembered=True, terms=known))
            self._assume(stamp.outputs[_BUILD_TYPE], name)
            return
        package = self._session.package(name)
        rules = _rules(self._policy, package.subject)
        self._found.append(self._claimed(package, rules, files))
        if self._standard_only:
            return
        if self._found[-1].diagnostics or any(claim.proof is not Proof.PROVEN for claim in self._found[-1].claims):
            self._refuted.add(name)
        else:
            outputs = {_key(claim): "\n".join((claim.universe, *claim.excepted)) for claim in self._found[-1].claims}
            outputs[_RULES] = _meaning(rules)
            outputs[_TERMS] = terms.dump(self._found[-1].terms, self._shown(name))
            outputs[_BUILD_TYPE] = package.build_type
            self._stamps[name] = Stamp(wanted, outputs, context=self._seen)

    def _of_enclave(self, name: str, unread: Sequence[Diagnostic]) -> tuple[Diagnostic, ...]:
        """Return the files that cannot be read and belong to the enclave: by the record, or by their names."""
        stamp = self._session.state.stamp(INSTALLED, name)
        names = [found.where.file.rpartition("/")[2] if found.where else "" for found in unread]
        return tuple(
            found
            for found, file in zip(unread, names, strict=True)
            if stamp is None or file in {*stamp.outputs, ""} or file.endswith(TAKEN)
        )

    def _same_rules(self, name: str, stamp: Stamp) -> bool:
        """Tell whether the policy says the same of a subject as when the stamp was made."""
        if stamp.context == self._seen:
            return True
        if stamp.outputs.get(_RULES) != _meaning(_rules(self._policy, f"/{name}")):
            return False
        self._stamps[name] = replace(stamp, context=self._seen)
        return True

    def _shown(self, name: str) -> str:
        """Return where messages say that the files of an enclave lie, as the user would type it."""
        folder = self._session.workspace.enclaves(self._session.profile.layout) / name
        return self._session.workspace.shown(self._folder(name) if self._folder else folder)

    def _claimed(self, package: Package, rules: SubjectRules, files: Mapping[str, bytes]) -> Proven:
        inputs = self._session
        prover = self._assume(package.build_type, package.name)
        if prover is None:
            message = f"the build type {package.build_type} proves nothing"
            marker = inputs.package_marker(package.name)
            said = Diagnostic(NO_PROVER, Severity.ERROR, message, marker, "", package.subject)
            return Proven(package.subject, (), diagnostics=(said,))
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
        """Return what proves, and keep what its claims take for granted; None for a build type that proves nothing."""
        build_type = self._session.plugins.build_type(name, self._session.package_marker(package))
        if not isinstance(build_type, Prover):
            return None
        if name not in self._provers:
            self._provers.add(name)
            self._assumptions.update(build_type.assumptions())
        return build_type

    def _wanted(self, source: Mapping[str, bytes], files: Mapping[str, bytes]) -> str:
        """Return the digest of all that a proof depends on beside the policy."""
        return digest(
            digest_files(files),
            digest_files(source),
            digest_files(self._chains),
            self._session.profile_digest,
            self._session.plugins.versions,
            __version__,
        )


_RULES, _BUILD_TYPE, _TERMS = "rules", "build type", "terms"
"""What a stamp has beside claims."""


def _rules(policy: LoadedPolicy, subject: str) -> SubjectRules:
    return policy.rules(subject) or SubjectRules(subject, ())


def _meaning(rules: SubjectRules) -> str:
    """Return a digest of rules, wherever they are written."""
    return digest(*(repr((r.effect, r.kind, r.permissions, r.expressions, r.partitions)) for r in rules.rules))


def _prove(prover: Prover, task: ProofTask, name: str) -> Proven:
    subject = task.rules.subject
    if not task.files:
        message, help_ = f"the enclave {subject} is not installed", f"run 'keymint install {name}'"
        said = Diagnostic("enclave-missing", Severity.ERROR, message, Origin(task.folder), help_, subject)
        return Proven(subject, (), diagnostics=(said,))
    try:
        claims = tuple(prover.prove(task))
        found = prover.terms(task.files, task.folder, task.anchors)
    except KeymintError as error:
        return Proven(subject, (), diagnostics=tuple(replace(each, subject=subject) for each in error.diagnostics))
    return Proven(subject, claims, terms=terms.read_by(found, {claim.model for claim in claims}))


def _key(claim: Claim) -> str:
    domains = ",".join(f"{each.first}-{each.last}" for each in claim.domains)
    return f"{claim.model} {claim.action} {domains}"


def _recalled(stamp: Stamp) -> tuple[Claim, ...]:
    """Return the claims that a stamp says were proven."""
    found: list[Claim] = []
    for key, value in stamp.outputs.items():
        if key not in {_RULES, _BUILD_TYPE, _TERMS}:
            universe, *excepted = value.split("\n")
            model, action, listed = key.rsplit(" ", 2)
            ends = (each.split("-") for each in listed.split(","))
            domains = tuple(DomainRange(int(first), int(last)) for first, last in ends)
            found.append(Claim(model, action, domains, universe, Proof.PROVEN, excepted=tuple(excepted)))
    return tuple(found)
