# SPDX-License-Identifier: Apache-2.0
"""What is planned: for a package by a stage, and so far as a whole, with the workspace as it will be then.

A stage plans each package by itself, and then puts the plans together. Only the second part looks at several packages.
So other processes may do the first part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, Self

from comarmor.values import Data, field, replace
from keymint.api import Artifact, BuildOptions, LoadedPolicy, Package
from keymint.authority.examine import contradictions
from keymint.errors import Diagnostic, KeymintError, require_none
from keymint.ir import SubjectRules
from keymint.life.register import IssuedCertificate, SignedRights
from keymint.life.revocation_lists_in_force import lists
from keymint.life.terms import Term
from keymint.life.workspace_register import register_of
from keymint.names import ROOT, subject_of
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.stamps import Stamp, StampRow, State
from keymint.workspace.package_build_types import may_share
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import IDENTITY_KEYS, with_recorded_keys


class InstallRequest(Data):
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


class PackagePlan(Data):
    """What a stage plans for one package, or the errors that prevent it.

    Attributes:
        name: the package, or the key of the record of the documents over all packages of a build type.
        step: what is written.
        stamp: the record of it, perhaps as it is written; None if nothing changes.
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
    stamp: Stamp | StampRow | None = None
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


class Forms:
    """What the results of a stage for the packages of a kind have in common: further ones are filled in from it.

    Attributes:
        package: the first new package, and its sources.
    """

    def __init__(self) -> None:
        self.package: tuple[Package, Mapping[str, bytes]] | None = None
        self._first: dict[tuple[str, object], tuple[str, Any]] = {}
        self._known: dict[tuple[str, object], Any] = {}

    def of(self, stage: str, kind: object) -> Any:
        """Return the form of a kind; None if there is none yet, or none at all."""
        return self._known.get((stage, kind))

    def learn(self, stage: str, new: NewPackage, result: Any, common: Callable[[Any, Any], Any]) -> None:
        """Make the form of a kind as soon as there are results for two of its members.

        Args:
            stage: the stage.
            new: a member; one that is of no kind is ignored.
            result: what the stage made of it in full.
            common: returns what two results have in common; None if others cannot be filled in from it.
        """
        key = stage, new.kind
        if new.kind is None or key in self._known:
            return
        name, first = self._first.setdefault(key, (new.name, result))
        if name != new.name:  # a member that is planned once more would have all in common with itself
            self._known[key] = common(first, result)
            del self._first[key]


class NewPackage(Data, frozen=False):
    """A package of which nothing is there, on its way through the stages; each sets what the next ones need.

    Attributes:
        name: the package.
        rules: its rules, as the policy has them.
        forms: the forms of the kinds of packages.
        written: the digest of its rules and their files (:meth:`keymint.api.LoadedPolicy.rules_digest`).
        sources: the files of its folder, once it is created.
        package: what they say, once it is built; so are the following.
        kind: what it shares with all packages whose results may be filled in from a form; None if it is of no kind.
        inputs: the digest of all that its documents are made from.
        documents: its unsigned documents.
        key: the change that stores its private key.
        built: the plan of the build.
        files: the files of its enclave, once it is installed.
        form: the form that these were filled in from (:mod:`keymint.stages.enclave_forms`); None if made in full.
    """

    name: str
    rules: SubjectRules
    forms: Forms
    written: str
    sources: Mapping[str, File] = field(init=False)
    package: Package = field(init=False)
    kind: object = field(init=False)
    inputs: str = field(init=False)
    documents: Mapping[str, File] = field(init=False)
    key: FolderChange = field(init=False)
    built: PackagePlan = field(init=False)
    files: Mapping[str, File] = field(init=False)
    form: Any = field(init=False, default=None)


class PackageStage:
    """A stage, as far as it looks at one package at a time."""

    NAME: str

    def new(self, new: NewPackage) -> Any:
        """Return the result for a package of which nothing is there, as :meth:`package` does; None leaves that to it.

        Raises:
            KeymintError: the package has defects.
        """
        raise NotImplementedError

    def package(self, name: str) -> Any:
        """Return the result for a package; it depends on no other package."""
        raise NotImplementedError


class NewPackages:
    """Packages of which nothing is there yet, on their way through the stages, without a view of the planned files.

    Where nothing is in the way, a stage has nothing to compare, and what it makes is what the next one needs. Every
    package that has something of its own goes the usual way: sources, documents, a key, an enclave, a record, an entry
    in the register; and so it does from the first stage on that has something to say about it.

    Args:
        session: the workspace before the stages.
        policy: the policy to create and to prove.
        stages: the names of the stages: create, build, and those that fill in enclaves from forms.
    """

    def __init__(self, session: Session, policy: LoadedPolicy, stages: Sequence[str]) -> None:
        self._session = session
        self._policy = policy
        self._first, _, *self._filling = stages
        self._existing = frozenset(session.packages())
        workspace = session.workspace
        layouts = (layout for each in session.build_types.values() for layout in each.LAYOUTS.values())
        installed = (workspace.install / layout.enclaves for layout in layouts)
        spaces = map(str, (workspace.src, workspace.build, workspace.identities, *installed))
        self._spaces = tuple(dict.fromkeys(each for each in spaces if session.tree.status(each)))
        self._on_the_way: dict[str, NewPackage] = {}
        self._forms = Forms()

    @classmethod
    def of(cls, session: Session, policy: LoadedPolicy, stages: Sequence[str]) -> NewPackages | None:
        """Return the same; None if packages depend on others, or an authority is in doubt or revoked something."""
        try:
            if session.needed_infrastructure() or may_share(session, ()) or contradictions(session) or lists(session):
                return None
            return cls(session, policy, stages)
        except KeymintError:  # raised again by the stage whose turn it is
            return None

    def planned(self, stage: PackageStage, name: str) -> Any:
        """Return what a stage plans for a package, or None if it must look at it as at any; stages come in order."""
        try:
            new = self._starting(name) if self._first == stage.NAME else self._on_the_way.pop(name, None)
            found = stage.new(new) if new else None
        except KeymintError:  # raised again below
            found = None
        if new is None or found is None or found.diagnostics or not found.stamp:
            return None
        if isinstance(found, PackagePlan):  # not the proof, after which nothing more is needed
            self._on_the_way[name] = new
        return found

    def is_filled_in(self, name: str) -> bool:
        """Tell whether the next stage, or after the build all that are left, need nothing that is planned for it."""
        new = self._on_the_way.get(name)
        if new is None or self._forms.package is None:
            return False
        return not hasattr(new, "kind") or all(self._forms.of(stage, new.kind) for stage in self._filling)

    def _starting(self, name: str) -> NewPackage | None:
        """Return a package if nothing of it is there, and it has no record and no entry in the register."""
        session = self._session
        if name == ROOT or name in self._existing or any(name in each for each in session.state.stamps.values()):
            return None
        if any(session.tree.status(f"{space}/{name}") for space in self._spaces) or register_of(session).of(name):
            return None
        subject = subject_of(name)
        rules, written = self._policy.rules(subject), self._policy.rules_digest(subject)
        return NewPackage(name, rules, self._forms, written or "") if rules else None


def planned_apart(
    session: Session,
    names: Sequence[str],
    stages: Iterable[Callable[[Session], PackageStage]],
    new: NewPackages | None,
) -> Iterator[list[Any]]:
    """Yield what each stage plans for some packages as far as it looks at one package at a time.

    What is planned for a package becomes part of the workspace only when a stage needs to look at it there.

    Args:
        session: the workspace before the first stage.
        names: the packages.
        stages: what makes each stage.
        new: the packages that are new, if some may be.
    """
    waiting: list[tuple[str, dict[str, PackagePlan]]] = []

    def with_plans_of(needed: Iterable[str]) -> Session:
        after = session
        for stage, plans in waiting:
            if found := [plans.pop(name) for name in needed if name in plans]:
                after = session_after(after, stage, found)
        return after

    for start in stages:
        session = with_plans_of([name for name in names if not (new and new.is_filled_in(name))])
        stage = start(session)
        found = {name: new and new.planned(stage, name) for name in names}
        whole = with_plans_of([name for name, each in found.items() if not each])
        if whole is not session:
            session, stage = whole, start(whole)
        planned = [found[name] or stage.package(name) for name in names]
        yield planned
        plans = [each for each in planned if isinstance(each, PackagePlan)]
        if any(each.errors for each in plans):
            return
        waiting.append((stage.NAME, {each.name: each for each in plans}))
        installed = [each for each in plans if not each.withdrawn]
        names = [each.name for each in installed if each.step is None or each.step.action is not Action.KEPT]


class Crew:
    """Who plans packages, and the clock that limits proofs; this one plans them here, one after the other.

    Attributes:
        monotonic: returns seconds.
        new: the packages that are new, if some may be.
    """

    monotonic: Callable[[], float]
    new: NewPackages | None = None

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
        return [(self.new and self.new.planned(stage, name)) or stage.package(name) for name in names]

    def close(self) -> None:
        """End all processes; what they did not stage is lost."""


def steps_of(planned: Sequence[PackagePlan]) -> tuple[Step, ...]:
    """Return the steps of some plans.

    Raises:
        KeymintError: the errors of all packages.
    """
    require_none(error for each in planned for error in each.errors)
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


class Work(Data):
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
        if any(f"{folder}/".startswith(profile) for folder, _, _ in plan.names()):
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
