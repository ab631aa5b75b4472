# SPDX-License-Identifier: Apache-2.0
"""What is planned: for a package by a stage, and so far as a whole, with the workspace as it will be then.

A stage plans each package by itself, and then puts the plans together. Only the second part looks at several packages.
So other processes may do the first part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from functools import reduce
from typing import Any, Self

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api import Artifact, BuildOptions
from keymint.errors import KeymintError
from keymint.life.register import IssuedCertificate, SignedRights
from keymint.life.terms import Term
from keymint.store.changes import Action, Plan, Step
from keymint.view.stamps import Stamp, State
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import IDENTITY_KEYS, with_recorded_keys


@dataclass(frozen=True, slots=True)
class InstallRequest:
    """What a run that installs is asked for; all that conducts the stages gets the whole of it.

    Attributes:
        force: discard manual edits.
        rekey: packages that get new private keys.
        prune: remove installed enclaves that have no source package.
        new_authority: authorities that get a new key and certificate.
        prove: refuse what is not proven.
        allow_vendor_specific: prove by the standards only; vendors may differ.
        strict: exceptions of claims count as not proven.
        revoke_superseded: revoke the certificates of packages whose new signed rights are narrower.
        build: options of the build; None for those that each package was built with last.
    """

    force: bool = False
    rekey: frozenset[str] = frozenset()
    prune: bool = False
    new_authority: tuple[str, ...] = ()
    prove: bool = True
    allow_vendor_specific: bool = False
    strict: bool = False
    revoke_superseded: bool = False
    build: BuildOptions | None = None

    def resumed(self, *, resumes: bool) -> InstallRequest:
        """Return what is left to do if an interrupted run made the new keys already."""
        return replace(self, new_authority=(), rekey=frozenset()) if resumes else self


@dataclass(frozen=True, slots=True)
class PackagePlan:
    """What a stage plans for one package, or the errors that prevent it.

    Attributes:
        name: the package, or the key of the record of the documents over all packages of a build type.
        step: what is written.
        stamp: the record of it; None if nothing changes.
        diagnostics: warnings about the package.
        errors: what prevents the step.
        fingerprint: fingerprint of the subject's key, if it is to be recorded.
        lifetimes: validity of the package's grant and certificate.
        build_types: the package's build types, if its enclave changes.
        artifacts: the files of its enclave that may be copied for all enclaves, if it changes.
        outdated: the package's sources changed after its documents were built.
        issued: the certificate of its enclave and the rights that were signed for it, if its enclave changes.
        signed: the documents that its holder presents, if its enclave changes.
        rights: what its subject gains and loses (:class:`keymint.analysis.policy_diff.SubjectChanges`); of documents
            over all packages, what all subjects do.
        withdrawn: why no certificate is issued to it, although it is built; see
            :meth:`keymint.life.register.Register.barred`.
    """

    name: str
    step: Step | None = None
    stamp: Stamp | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    errors: tuple[Diagnostic, ...] = ()
    fingerprint: str = ""
    lifetimes: tuple[Term, ...] = ()
    build_types: tuple[str, ...] = ()
    artifacts: Mapping[str, Artifact] = field(default_factory=dict)
    outdated: bool = False
    issued: IssuedCertificate | None = None
    signed: tuple[SignedRights, ...] = ()
    rights: tuple[Any, ...] = ()
    withdrawn: str = ""


class PackageStage:
    """A stage, as far as it looks at one package at a time."""

    NAME: str

    def package(self, name: str) -> Any:
        """Return the result for a package; it depends on no other package."""
        raise NotImplementedError


class Crew:
    """Who plans packages, and the clock that limits proofs; this one plans them here, one after the other.

    Attributes:
        monotonic: returns seconds.
    """

    monotonic: Callable[[], float]

    def start(
        self, session: Session, names: Sequence[str], stages: Sequence[Callable[[Session], PackageStage]]
    ) -> None:
        """Let processes plan some packages, if that is worth it; they begin at once.

        Args:
            session: the workspace and its profile.
            names: the packages.
            stages: what makes each stage, in their order.
        """

    def planned(self, stage: PackageStage, names: Sequence[str]) -> list[Any]:
        """Return what a stage plans for each package.

        Raises:
            KeymintError: the stage cannot plan at all, or a process ended before it had planned its part.
        """
        return [stage.package(name) for name in names]

    def close(self) -> None:
        """End all processes; what they did not stage is lost."""


def steps_of(planned: Sequence[PackagePlan]) -> tuple[Step, ...]:
    """Return the steps of some plans.

    Raises:
        KeymintError: the errors of all packages.
    """
    if errors := [error for each in planned for error in each.errors]:
        raise KeymintError.of(errors)
    return tuple(each.step for each in planned if each.step)


def state_after(state: State, stage: str, planned: Sequence[PackagePlan], removed: Iterable[str] = ()) -> State:
    """Return the state with the stamps and the keys of some plans, and without the stamps of what is removed."""
    removed = {*removed, *(each.name for each in planned if each.step and each.step.action is Action.REMOVED)}
    state = state.updated(stage, {each.name: each.stamp for each in planned if each.stamp}, removed)
    fingerprints = {each.name: each.fingerprint for each in planned if each.fingerprint}
    return with_recorded_keys(state, IDENTITY_KEYS, fingerprints)


def session_after(session: Session, stage: str, planned: Sequence[PackagePlan]) -> Session:
    """Return a session as it is once the plans of a stage are carried out; errors as :func:`steps_of`."""
    return session.after(Plan(steps_of(planned), state_after(session.state, stage, planned)))


@dataclass(frozen=True, slots=True)
class Work:
    """What is planned so far, and the workspace as it will be once that is carried out.

    This is the only place that adds a plan to others and takes it into account for those that follow.

    Attributes:
        session: the workspace after all plans, with its profile as it is then.
        parts: the plans in the order in which they are carried out, each with the name of what made it, or none.
        rights: what subjects gain and lose by it, as those of a plan for a package.
    """

    session: Session
    parts: tuple[tuple[str, Plan], ...] = ()
    rights: tuple[Any, ...] = ()

    @classmethod
    def after(cls, inputs: Inputs, plan: Plan) -> Self:
        """Return the work that begins with the plan of a profile.

        Raises:
            KeymintError: the new profile has defects.
        """
        return cls(inputs.after(plan).session(), (("", plan),))

    def then(self, plan: Plan, part: str = "", *, before: str = "") -> Self:
        """Return this work followed by a plan that was made on top of it.

        Args:
            plan: the plan. If it changes the profile, that is loaded again.
            part: what made it.
            before: the plan takes its place before this part, which was needed to make it and is carried out later.

        Raises:
            KeymintError: the changed profile has defects.
        """
        if not plan.steps and not plan.first and plan.state is self.session.state:
            return self.noting(*plan.diagnostics) if plan.diagnostics else self
        after = self.session.after(plan)
        profile = f"{self.session.workspace.profile}/"
        if any(f"{change.folder}/".startswith(profile) for change in plan.changes()):
            after = after.session()
        names = [name for name, _ in self.parts]
        place = names.index(before) if before and before in names else len(names)
        return replace(self, session=after, parts=(*self.parts[:place], (part, plan), *self.parts[place:]))

    def noting(self, *diagnostics: Diagnostic, part: str = "") -> Self:
        """Return this work with further diagnostics."""
        noted = Plan((), self.session.state, diagnostics)
        return replace(self, parts=(*self.parts, (part, noted))) if diagnostics else self

    def recording(self, state: State) -> Self:
        """Return this work with another record."""
        return replace(self, session=replace(self.session, state=state))

    def of(self, *names: str) -> Plan:
        """Return the plan of some parts, or of all if none is named; its record is that of the whole work."""
        parts = (plan for name, plan in self.parts if name in names or not names)
        return replace(reduce(Plan.then, parts, Plan((), self.session.state)), state=self.session.state)

    @property
    def plan(self) -> Plan:
        """All plans as one."""
        return self.of()
