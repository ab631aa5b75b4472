# SPDX-License-Identifier: Apache-2.0
"""The stage ``prove``: prove claims about installed enclaves. It writes nothing but the record of proofs.

The proof of an enclave whose claims were all proven is cached until its files, its policy or the tool change.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING

from comarmor.values import replace
from keymint import __version__, api
from keymint.authority.authority_files import chains_digest, trusted_chains
from keymint.authority.examine import contradictions_for
from keymint.errors import Defects, Diagnostic, KeymintError, Severity, require_none
from keymint.ir import SubjectRules
from keymint.life import terms
from keymint.names import name_of, subject_of
from keymint.pki import distinguished_names
from keymint.stages import proof_results
from keymint.stages.documents import documents_digest, enclaves_of, installed_documents
from keymint.stages.identities import missing_enclave
from keymint.stages.proof_results import EnclaveProof, ProofEffort, ProofResults
from keymint.stages.trust_anchors import anchors_of, shared_anchors, unread_of
from keymint.stages.work import NewPackage, PackageStage
from keymint.view.stamps import Stamp, digest, digest_files, digest_of_texts, stamp_of
from keymint.workspace import package_build_types
from keymint.workspace.installed_enclaves import enclave_digests, enclave_files
from keymint.workspace.package_build_types import SHARED
from keymint.workspace.session import Session

if TYPE_CHECKING:
    from keymint.host.pool import Pool

STAGE = "prove"
LEAST = 50
"""Enclaves for which a process of its own is worth its start."""
NO_PROVER = "proof-unsupported"
"""Code of the finding on an enclave whose build type proves nothing."""


def policy_digest(policy: api.LoadedPolicy) -> str:
    """Return the digest of the files that a policy was read from."""
    return digest(*(f"{path} {value.hex()}" for path, value in sorted(policy.seen.items())))


def proofs(
    session: Session,
    policy: api.LoadedPolicy,
    effort: ProofEffort,
    names: Sequence[str],
    on_enclave: Callable[[str], None],
    pool: Pool,
) -> ProofResults:
    """Prove or refute the claims about the installed enclaves of some packages, and those across subjects.

    Args:
        session: the workspace and its profile.
        policy: the policy that the enclaves are compared with.
        effort: what to claim, and limits of the search.
        names: names of packages.
        on_enclave: called with each name after its proof.
        pool: the processes to prove in.

    Raises:
        KeymintError: a package has defects, or the pool is lost.
    """
    stage = ProofStage(session, policy, effort)
    recorded = {name: stage.recorded(name) for name in names}  # to find one takes less than to send it
    left = [name for name in names if recorded[name] is None]
    made: Iterator[EnclaveProof] = map(stage.package, left)
    if len(parts := pool.parts(left, LEAST)) > 1:
        made = chain.from_iterable(pool.map(lambda part: [stage.package(name) for name in part], parts))
    proven: list[EnclaveProof] = []
    for name in names:
        proven.append(recorded[name] or next(made))
        on_enclave(name)
    return stage.results(proven)


class ProofStage(PackageStage):
    """The stage ``prove``: proves enclaves one by one, and then the claims across them.

    Args:
        session: the workspace and its profile.
        policy: the policy that the enclaves are compared with.
        effort: what to claim, and limits of the search.
        unsigned: the documents are about to be signed: messages cite the unsigned ones in the build space.
    """

    NAME = STAGE

    def __init__(
        self, session: Session, policy: api.LoadedPolicy, effort: ProofEffort, *, unsigned: bool = False
    ) -> None:
        self._session = session
        self._policy = policy
        self._effort = effort
        self._unsigned = unsigned
        self._policy_digest = policy_digest(policy)
        self._chains_digest = chains_digest(session)
        workspace = session.workspace
        self._shared_folder = workspace.shown(workspace.build / SHARED if unsigned else workspace.install)

    def results(self, proven: Sequence[EnclaveProof]) -> ProofResults:
        """Put the proofs of some packages together, and add the claims across subjects."""
        names = {each.name for each in proven}
        of_types = package_build_types.users(self._session).items()
        across = tuple(self._across(name, of_type) for name, of_type in of_types if not names.isdisjoint(of_type))
        stamps = {each.name: each.stamp for each in (*proven, *across) if each.stamp}
        refuted = {each.name for each in (*proven, *across) if each.refuted}
        state = self._session.state
        if stamps or any(state.stamp(STAGE, name) for name in refuted):
            state = state.updated(STAGE, stamps, refuted)
        assumptions: dict[str, Sequence[str]] = {}
        standards: set[str] = set()
        evidence: dict[str, str] = {}
        for name in dict.fromkeys(name for each in proven for name in each.build_types):
            build_type = self._session.plugins.build_type(name)
            if prover := build_type.prover:
                assumptions |= prover.assumptions()
                standards.update([*prover.assumptions()][:1])
                evidence |= build_type.models()
        known = frozenset(standards), evidence
        return ProofResults(tuple(proven), across, state, assumptions, *known, self._session.now)

    def package(self, name: str) -> EnclaveProof:
        """Prove the claims about one enclave, unless the proof is cached."""
        session = self._session
        digests = enclave_digests(session, name)
        files: Mapping[str, bytes] | None = None
        if digests is None:
            files, unread = enclave_files(session, name)
            if defects := unread_of(session, session.package(name), unread):
                return EnclaveProof(name, subject_of(name), diagnostics=defects, refuted=True)
            digests = {file: digest(content) for file, content in files.items()}
        if contradictions := contradictions_for(session, name):
            return EnclaveProof(name, subject_of(name), diagnostics=contradictions)
        if recorded := self._of_files(name, digests):
            return recorded
        package, folder = session.package(name), self._folder(name)
        files = enclave_files(session, name)[0] if files is None else files
        build_types = tuple(package_build_types.build_types_of(session, package)) if files else ()
        inputs = self._inputs_digest(name, digests, build_types)
        rules = self._rules(package.subject)
        proof = self._proof(package, rules, files, folder)
        return self._kept(proof, (rules,), inputs, build_types, folder)

    def recorded(self, name: str) -> EnclaveProof | None:
        """Return the proof of an enclave that is on record, or None if :meth:`package` must be asked."""
        with suppress(KeymintError):  # raised again there
            digests = enclave_digests(self._session, name)
            if digests is not None and not contradictions_for(self._session, name):
                return self._of_files(name, digests)
        return None

    def _of_files(self, name: str, digests: Mapping[str, str]) -> EnclaveProof | None:
        """Return the proof on record of an enclave whose files have some digests; None if there is none.

        The record does not depend on the clock: whether documents are in force is checked at each run.
        """
        stamp = self._session.state.stamp(STAGE, name)
        known = self._inputs_digest(name, digests, stamp.build_types) if stamp else ""
        found = self._recorded(name, (subject_of(name),), known, self._folder(name))
        return found and replace(found, subject=subject_of(name))

    def _folder(self, name: str) -> str:
        """Return the folder of the documents of a package, as messages show it."""
        workspace = self._session.workspace
        return workspace.shown(workspace.build / name if self._unsigned else self._session.enclave_folder(name))

    def new(self, new: NewPackage) -> EnclaveProof | None:
        """See :meth:`keymint.stages.work.PackageStage.new`; the files are those of the enclave that is planned."""
        session, build_types = self._session, new.package.build_types
        digests = {file: each.digest for file, each in new.files.items()}
        inputs = self._digest(new.inputs, digests, build_types, session.vendors_of)
        form = new.forms.of(STAGE, new.kind)
        own = distinguished_names.written_name(new.package.identity.subject_name).values
        is_of_policy = new.package.grant.rules.kind == new.rules.kind and new.package.subject == new.rules.subject
        if form and new.form and is_of_policy and _differing(form[1], own) == form[2]:
            first, values, _ = form
            if new.form.holds(new, trusted_chains(session)):
                outputs = self._outputs_like(first, new, (values, own))
                stamp = Stamp(inputs, outputs, context=self._policy_digest, build_types=build_types)
                return EnclaveProof(new.name, new.package.subject, first.claims, build_types=build_types, stamp=stamp)
        if new.form:
            return None
        proof = self.package(new.name)
        if proof.stamp:
            new.forms.learn(STAGE, new, (proof, own, new), self._form)
        return proof

    def _form(
        self,
        one: tuple[EnclaveProof, tuple[str, ...], NewPackage],
        other: tuple[EnclaveProof, tuple[str, ...], NewPackage],
    ) -> tuple[EnclaveProof, tuple[str, ...], tuple[bool, ...]] | None:
        """Return a proof whose record tells that of all enclaves of a kind, with its values and which of them differ.

        None if it does not.

        Args:
            one: the proof of an enclave, the values of its package, and the package.
            other: those of another one.
        """
        (first, values, _), (second, others, new) = one, other
        if not first.stamp or not second.stamp or first.claims != second.claims:
            return None
        is_same = self._outputs_like(first, new, (values, others)) == stamp_of(second.stamp).outputs
        is_in_force = not any(terms.findings((*first.terms, *second.terms), self._session.now))
        return (first, values, _differing(values, others)) if is_same and is_in_force else None

    def _outputs_like(
        self, first: EnclaveProof, new: NewPackage, values: tuple[tuple[str, ...], tuple[str, ...]]
    ) -> Mapping[str, str]:
        """Return the record of a proof that is that of another one, but for the rules and the values of a package."""
        written = {proof_results.WRITTEN: digest(new.written)} if new.written else {}
        own = {proof_results.RULES: proof_results.placeless_digest((new.rules,)), **written}
        outputs, names = stamp_of(first.stamp).outputs if first.stamp else {}, dict(zip(*values, strict=False))
        dates = _any_of(values[0]).sub(
            lambda value: names.get(value[0], value[0]), outputs.get(proof_results.TERMS, "")
        )
        return {**outputs, **own, proof_results.TERMS: dates}

    def _across(self, name: str, names: Sequence[str]) -> EnclaveProof:
        """Prove the claims across the subjects of some packages of a build type, unless these are on record."""
        session, key, folder = self._session, package_build_types.record_key(name), self._shared_folder
        build_type = session.plugins.build_type(name)
        enclaves = enclaves_of(session, name)
        digests = {subject: digest_files(files) for subject, files in enclaves.items()}
        inputs, subjects = self._inputs_digest(key, digests, (name,)), [subject_of(each) for each in names]
        if recorded := self._recorded(key, subjects, inputs, folder):
            return recorded
        rules = {subject: self._rules(subject) for subject in subjects}
        try:
            packages = package_build_types.load_packages(session, name)
            task = api.SharedProofTask(
                packages,
                rules,
                enclaves,
                session.workspace.shown(session.workspace.build if self._unsigned else session.enclaves),
                installed_documents(session, name),
                folder,
                shared_anchors(session, packages, build_type),
                self._effort.states,
                self._effort.deadline(),
                self._unsigned,
            )
            with self._effort.limit(rule for each in rules.values() for rule in each.rules):
                claims = _with_rules(build_type.prove_shared(task), rules.values())
            proof = EnclaveProof(key, "", claims)
        except KeymintError as error:
            proof = EnclaveProof(key, "", diagnostics=tuple(error.diagnostics))
        return self._kept(proof, rules.values(), inputs, (name,), folder)

    def _recorded(self, name: str, subjects: Sequence[str], inputs: str, folder: str) -> EnclaveProof | None:
        """Return the proof on record if it is of the same files and the same rules of some subjects, else None."""
        stamp = self._session.state.stamp(STAGE, name)
        known = proof_results.load_proof(stamp, folder) if stamp and stamp.inputs == inputs else None
        if stamp is None or known is None or not self._same_rules(stamp, subjects):
            return None
        proof = EnclaveProof(name, "", known[0], cached=True, terms=known[1], build_types=stamp.build_types)
        return replace(proof, stamp=self._of_policy(stamp, subjects))

    def _kept(
        self,
        proof: EnclaveProof,
        rules: Collection[SubjectRules],
        inputs: str,
        build_types: tuple[str, ...],
        folder: str,
    ) -> EnclaveProof:
        """Return a proof with its record if all its claims are proven."""
        if self._effort.standard_only:
            return replace(proof, build_types=build_types)
        if proof.diagnostics or any(claim.proof is not api.Proof.PROVEN for claim in proof.claims):
            return replace(proof, build_types=build_types, refuted=True)
        outputs = proof_results.dump_proof(proof.claims, proof.terms, rules, folder)
        if written := self._written(each.subject for each in rules):
            outputs = {**outputs, proof_results.WRITTEN: written}
        stamp = Stamp(inputs, outputs, context=self._policy_digest, build_types=build_types)
        return replace(proof, build_types=build_types, stamp=stamp)

    def _same_rules(self, stamp: Stamp, subjects: Iterable[str]) -> bool:
        """Tell whether the policy has the same rules for some subjects as when the stamp was made."""
        if stamp.context == self._policy_digest:
            return True
        if (written := self._written(subjects)) and stamp.outputs.get(proof_results.WRITTEN) == written:
            return True
        rules = proof_results.placeless_digest(self._rules(subject) for subject in subjects)
        return stamp.outputs.get(proof_results.RULES) == rules

    def _written(self, subjects: Iterable[str]) -> str:
        """Return a digest that is the same if the rules of some subjects are, and their files; or an empty text."""
        digests = [self._policy.rules_digest(subject) for subject in subjects]
        return "" if None in digests else digest(*map(str, digests))

    def _of_policy(self, stamp: Stamp, subjects: Iterable[str]) -> Stamp | None:
        """Return a stamp as the present policy has it, or None if it tells that already."""
        written = "" if stamp.context == self._policy_digest else self._written(subjects)
        if stamp.context == self._policy_digest or (written and stamp.outputs.get(proof_results.WRITTEN) == written):
            return None
        outputs = {**stamp.outputs, proof_results.WRITTEN: written} if written else stamp.outputs
        return replace(stamp, context=self._policy_digest, outputs=outputs)

    def _proof(
        self, package: api.Package, rules: SubjectRules, files: Mapping[str, bytes], folder: str
    ) -> EnclaveProof:
        subject = package.subject
        if not files:
            missing = missing_enclave(self._session, package)
            return EnclaveProof(package.name, subject, diagnostics=(replace(missing, severity=Severity.ERROR),))
        claims: list[api.Claim] = []
        validity: list[api.ValidityTerm] = []
        defects = Defects()
        build_types = package_build_types.build_types_of(self._session, package)
        for name, build_type in build_types.items():
            prover = build_type.prover
            if prover is None:
                message, marker = f"the build type {name} proves nothing", self._session.package_marker(package.name)
                defects.found.append(Diagnostic.error(NO_PROVER, message, marker))
                continue
            with defects:
                shared = installed_documents(self._session, name)
                anchors = anchors_of(self._session, package, build_type)
                enclave = api.EnclaveFiles(files, folder, anchors, shared, self._shared_folder)
                effort = self._effort
                task = api.ProofTask(
                    package, rules, enclave, effort.states, effort.deadline(), effort.standard_only, self._unsigned
                )
                own = _with_rules(self._claims(prover, task), (rules,))
                periods = prover.terms(enclave)
                claims += own
                models = {claim.model for claim in own} or prover.assumptions().keys()
                validity += terms.terms_of(periods, models)
        of_subject = tuple(replace(each, subject=subject) for each in dict.fromkeys(defects.found))
        periods = tuple(validity if len(build_types) == 1 else dict.fromkeys(validity))
        return EnclaveProof(package.name, subject, tuple(claims), diagnostics=of_subject, terms=periods)

    def _claims(self, prover: api.Prover, task: api.ProofTask) -> Sequence[api.Claim]:
        """Return the claims about an enclave; the policy grants nothing to infrastructure, which must be ours though.

        Raises:
            KeymintError: the enclave cannot be read, or the anchors do not vouch for it.
        """
        if task.package.role is api.Role.SUBJECT:
            with self._effort.limit(task.rules.rules):
                return prover.prove(task)
        require_none(prover.differences(task.enclave))
        return ()

    def _inputs_digest(self, name: str, digests: Mapping[str, str], build_types: Iterable[str]) -> str:
        """Return the digest of everything that a proof depends on, except the policy."""
        # What holds across subjects is the same for all vendors.
        of_vendors = "" if package_build_types.shared_type(name) else self._session.vendors_of
        return self._digest(package_build_types.inputs_digest(self._session, name), digests, build_types, of_vendors)

    def _digest(self, built: str, digests: Mapping[str, str], build_types: Iterable[str], vendors_of: str) -> str:
        shared = (documents_digest(self._session, each) for each in build_types)
        files = chain.from_iterable(sorted(digests.items()))
        of_vendors = [vendors_of] if vendors_of else []
        return digest_of_texts(built, self._chains_digest, __version__, *of_vendors, *shared, "", *files)

    def _rules(self, subject: str) -> SubjectRules:
        """Return the policy's rules for a subject; none for infrastructure, even if a profile is for every subject."""
        of_subject = self._session.role(name_of(subject)) is api.Role.SUBJECT
        return (self._policy.rules(subject) if of_subject else None) or SubjectRules(subject, ())


@lru_cache(maxsize=64)
def _any_of(values: tuple[str, ...]) -> re.Pattern[str]:
    return re.compile("|".join(map(re.escape, sorted(values, key=len, reverse=True))) or "(?!)")


def _differing(values: Sequence[str], others: Sequence[str]) -> tuple[bool, ...]:
    return tuple(value != other for value, other in zip(values, others, strict=False))


def _with_rules(claims: Iterable[api.Claim], rules: Iterable[SubjectRules]) -> tuple[api.Claim, ...]:
    """Return claims; those that took too many steps also name the rules that are likely to blame."""
    if not any(each.spent for each in claims):
        return tuple(claims)
    places = proof_results.costliest(rule for each in rules for rule in each.rules)
    return tuple(replace(each, reason=each.reason + places) if each.spent else each for each in claims)
