"""The stage ``create``: from the policy to source packages."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.text import counted, did_you_mean, first_few
from keymint.api import AppliedProfile, LoadedPolicy, PolicyDecision, Structure
from keymint.errors import KeymintError
from keymint.graph import Edge
from keymint.ir import SubjectRules
from keymint.names import package_name, refuse_case_collisions, refuse_reserved
from keymint.plan.inputs import Inputs, LoadedProfile, Sources, changed, placed
from keymint.plan.model import Action, File, Plan, Step
from keymint.state import Stamp, State, digest
from keymint.workspace import packages

STAGE = "create"
POLICY = "policy"
"""Where the record has what the policy was read from."""
CHANGED = "policy-changed"
"""Code of the warning that packages are not what the policy says now."""
_SHOWN = 5
"""Packages that a message names."""


def load_policy(inputs: Inputs, loaded: LoadedProfile) -> LoadedPolicy:
    """Load the policy that the profile names; errors as :meth:`keymint.api.PolicyType.load`.

    A library that is only planned yet is read where it will be copied from, and named by its place to be.
    """
    profile = loaded.profile
    policy_type = inputs.plugins.policy_type(profile.policy_type, inputs.profile_marker())
    if profile.library is None or profile.library.is_dir():
        return policy_type.load(profile.policies, profile.library)
    shipped = inputs.plugins.profile_type(profile.profile_type).library(profile.distro)
    return _Relocated(policy_type.load(profile.policies, shipped), shipped, profile.library)


def recall_policy(inputs: Inputs, loaded: LoadedProfile) -> LoadedPolicy:
    """Return the policy as :func:`load_policy` does, or as the record has it when nothing of it changed.

    Loading a large policy costs more than all else that a run without changes does. What the record has is which
    subjects the policy names; rules are loaded when they are asked for.
    """
    recorded = inputs.state.stamp(POLICY, "seen")
    subjects = inputs.state.stamp(POLICY, "subjects")
    fingerprint = inputs.plugins.policy_type(loaded.profile.policy_type, inputs.profile_marker()).fingerprint
    if (
        recorded is None
        or subjects is None
        or recorded.inputs != _read_from(loaded)
        or any(fingerprint(Path(path)).hex() != value for path, value in recorded.outputs.items())
    ):
        return load_policy(inputs, loaded)
    seen = {Path(path): bytes.fromhex(value) for path, value in recorded.outputs.items()}
    return _Recalled(seen, tuple(sorted(subjects.outputs)), functools.partial(load_policy, inputs, loaded))


def policy_changed(inputs: Inputs, loaded: LoadedProfile, sources: Sources) -> Sequence[Diagnostic]:
    """Return a warning when the policy is not what the packages were made from.

    What the record has is only a hint: a comment, another default of the profile or a copy of the workspace changes no
    package. So the packages are asked; the policy is loaded for that only where the record differs.
    """
    recorded = inputs.state.stamp(POLICY, "seen")
    if recorded is None or _as_recorded(inputs, loaded, recorded):
        return ()
    try:
        behind = _behind(inputs, loaded, sources)
    except KeymintError as error:
        message = f"the policy changed since the packages were made from it, and cannot be read: {error.diagnostics[0]}"
        return (Diagnostic(CHANGED, Severity.WARNING, message, None, "mend it, then run 'keymint create --all'"),)
    if not behind:
        return ()
    shown = first_few([f"/{name}" for name in behind], _SHOWN)
    message = f"{counted(len(behind), 'source package')} out of date with the policy: {shown}"
    return (Diagnostic(CHANGED, Severity.WARNING, message, None, "run 'keymint create --all'"),)


def _behind(inputs: Inputs, loaded: LoadedProfile, sources: Sources) -> list[str]:
    """Return the packages that differ from the policy, and those of subjects that it did not name before."""
    policy = load_policy(inputs, loaded)
    existing = packages(inputs.tree, inputs.workspace.src)
    recorded = inputs.state.stamp(POLICY, "subjects")
    before = set(recorded.outputs) if recorded is not None else set()
    new = {package_name(subject) for subject in policy.subjects() if subject not in before}
    return sorted({*stale(inputs, loaded, policy, existing, sources), *(new - set(existing))})


def _as_recorded(inputs: Inputs, loaded: LoadedProfile, recorded: Stamp) -> bool:
    """Tell whether the policy would be read from the same files with the same content."""
    fingerprint = inputs.plugins.policy_type(loaded.profile.policy_type).fingerprint
    return recorded.inputs == _read_from(loaded) and all(
        fingerprint(Path(path)).hex() == value for path, value in recorded.outputs.items()
    )


def _read_from(loaded: LoadedProfile) -> str:
    """Return the digest of where a policy is read from: in the copy of a workspace it is another place."""
    profile = loaded.profile
    return digest(loaded.digest, str(profile.library), *(str(source.path) for source in profile.policies))


class _Recalled:
    """A policy of which the record knows what it was read from and whom it names."""

    def __init__(self, seen: Mapping[Path, bytes], subjects: tuple[str, ...], load: Callable[[], LoadedPolicy]) -> None:
        self.seen = seen
        self._subjects = subjects
        self._load = functools.cache(load)

    def subjects(self) -> tuple[str, ...]:
        """Return the subjects that the policy names exactly."""
        return self._subjects

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject; loads the policy."""
        return self._load().rules(subject)

    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject; loads the policy."""
        return self._load().profiles(subject)

    def decide(self, edge: Edge) -> PolicyDecision:
        """Return what the policy says about an edge; loads the policy."""
        return self._load().decide(edge)


class _Relocated:
    """A policy whose library is read from one folder and named by another."""

    def __init__(self, policy: LoadedPolicy, source: Path, place: Path) -> None:
        self._policy = policy
        self._source = f"{source}/"
        self._place = f"{place}/"

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """What was looked at, by its place to be."""
        return {Path(self._moved(str(path))): value for path, value in self._policy.seen.items()}

    def subjects(self) -> tuple[str, ...]:
        """Return the subjects that the policy names exactly."""
        return self._policy.subjects()

    @functools.cache  # noqa: B019 - lives as long as the run
    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, with their origins' place to be."""
        found = self._policy.rules(subject)
        if found is None:
            return None
        return SubjectRules(subject, tuple(replace(rule, origin=self._origin(rule.origin)) for rule in found.rules))

    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject, with their place to be."""
        return tuple(replace(found, where=self._origin(found.where)) for found in self._policy.profiles(subject))

    def decide(self, edge: Edge) -> PolicyDecision:
        """Return what the policy says about an edge, with the rule's place to be."""
        found = self._policy.decide(edge)
        return replace(found, where=self._origin(found.where) if found.where else None)

    def structure(self) -> Structure | None:
        """Return the policy as it is written, if its type tells; its profiles have their place to be."""
        of = getattr(self._policy, "structure", None)
        found = of() if of else None
        if not isinstance(found, Structure):
            return None
        profiles = tuple(replace(profile, where=self._origin(profile.where)) for profile in found.profiles)
        return replace(found, profiles=profiles)

    @functools.cache  # noqa: B019 - lives as long as the run
    def _origin(self, origin: Origin) -> Origin:
        return replace(origin, file=self._moved(origin.file), chain=tuple(map(self._origin, origin.chain)))

    def _moved(self, file: str) -> str:
        return self._place + file.removeprefix(self._source) if file.startswith(self._source) else file


def everything(inputs: Inputs, policy: LoadedPolicy) -> tuple[str, ...]:
    """Return the packages of every subject that the policy names exactly, and those that are there already.

    A package that is there follows the policy whatever the policy says of it now: permissions that were
    withdrawn must not live on in its sources.
    """
    exact = [package_of(policy, subject) for subject in policy.subjects()]
    return tuple(sorted({*exact, *packages(inputs.tree, inputs.workspace.src)}))


def package_of(policy: LoadedPolicy, subject: str) -> str:
    """Return the package of a subject; the error for a name that cannot be one has the place in the policy."""
    try:
        return package_name(subject)
    except KeymintError as error:
        where = next((applied.where for applied in policy.profiles(subject)), None)
        raise KeymintError.of(replace(found, where=where) for found in error.diagnostics) from None


def plan_create(
    inputs: Inputs,
    loaded: LoadedProfile,
    policy: LoadedPolicy,
    names: Sequence[str],
    sources: Sources,
    *,
    force: bool,
) -> Plan:
    """Plan the source packages of some subjects.

    Args:
        inputs: the workspace.
        loaded: its profile.
        policy: its policy.
        names: package names, legal.
        sources: the packages' files.
        force: replace documents of rules that were edited by hand.

    Raises:
        KeymintError: no profile of the policy applies to a name, names collide, or an edit by hand is in the way;
            all of them together.
    """
    one_by_one = _Packages(inputs, loaded, policy, sources)
    refuse_case_collisions([*one_by_one.existing, *names])
    for name in names:
        refuse_reserved(name, loaded.profile.layout)
    planned = {name: one_by_one.planned(name, force=force) for name in names}
    if errors := [error for each in planned.values() for error in each.errors]:
        raise KeymintError.of(errors)
    steps = tuple(each.step for each in planned.values() if each.step)
    stamps = {name: each.stamp for name, each in planned.items() if each.stamp}
    diagnostics = tuple(said for each in planned.values() for said in each.diagnostics)
    return Plan(steps, _recorded(inputs, loaded, policy).updated(STAGE, stamps), diagnostics)


def stale(
    inputs: Inputs, loaded: LoadedProfile, policy: LoadedPolicy, names: Sequence[str], sources: Sources
) -> Mapping[str, tuple[Diagnostic, ...]]:
    """Return the packages that differ from what the policy says, each with what is in the way of their update.

    Args:
        inputs: the workspace.
        loaded: its profile.
        policy: its policy.
        names: names of packages that are there.
        sources: the packages' files.

    Raises:
        KeymintError: names collide.
    """
    one_by_one = _Packages(inputs, loaded, policy, sources)
    refuse_case_collisions([*one_by_one.existing, *names])
    found: dict[str, tuple[Diagnostic, ...]] = {}
    for name in names:
        try:
            each = one_by_one.planned(name, force=False)
        except KeymintError as error:  # a file that is no file, or too large
            found[name] = error.diagnostics
            continue
        if each.step is None or each.step.action is not Action.UNCHANGED:
            found[name] = tuple(each.errors)
    return found


@dataclass(frozen=True, slots=True)
class _Planned:
    """What is planned for one package: a step, or the errors that are in the way of one."""

    step: Step | None = None
    stamp: Stamp | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    errors: tuple[Diagnostic, ...] = ()


class _Packages:
    """Plans packages one by one; what they share is found out once."""

    def __init__(self, inputs: Inputs, loaded: LoadedProfile, policy: LoadedPolicy, sources: Sources) -> None:
        self._inputs = inputs
        self._loaded = loaded
        self._policy = policy
        self._sources = sources
        self.existing = frozenset(packages(inputs.tree, inputs.workspace.src))
        self._policy_digest = digest(
            *(part for path, value in sorted(policy.seen.items()) for part in (str(path), value))
        )
        self._package_type = inputs.plugins.package_type(loaded.profile.package_type, inputs.profile_marker())

    def planned(self, name: str, *, force: bool) -> _Planned:
        """Return what is planned for a package."""
        inputs = self._inputs
        folder = inputs.workspace.src / name
        files = self._sources.files(inputs, name)
        stamp = inputs.state.stamp(STAGE, name)
        wanted = digest(self._policy_digest, self._loaded.digest)
        if stamp and stamp.inputs == wanted and _outputs(files) == stamp.outputs and not force:
            return _Planned(Step(STAGE, name, Action.UNCHANGED))
        known = name in self.existing
        rules = self._policy.rules(f"/{name}")
        said: tuple[Diagnostic, ...] = ()
        if rules is None:
            said = (_nothing_applies(name, self._policy, known=known),)
            rules = SubjectRules(f"/{name}", ())
        errors = () if known else said
        try:
            new = self._package_type.create(self._loaded.profile, rules, files, force=force)
        except KeymintError as error:
            in_the_way = (placed(diagnostic, inputs.workspace.src) for diagnostic in error.diagnostics)
            return _Planned(None, None, said if known else (), (*errors, *in_the_way))
        # The marker goes last: until then a later run sees no package, and makes what is missing of one.
        ordered = sorted(new.items(), key=lambda item: item[0] == self._package_type.MARKER)
        changes = changed(inputs.tree, folder, {file: File(content) for file, content in ordered})
        action = (Action.UPDATED if known else Action.CREATED) if changes else Action.UNCHANGED
        step = Step(STAGE, name, action, changes)
        return _Planned(step, Stamp(wanted, _outputs(files | dict(new))), said if known else (), errors)


def _recorded(inputs: Inputs, loaded: LoadedProfile, policy: LoadedPolicy) -> State:
    """Return the record with what the policy was read from, and whom it names."""
    read_from = _read_from(loaded)
    seen = Stamp(read_from, {str(path): value.hex() for path, value in policy.seen.items()})
    return inputs.state.updated(
        POLICY, {"seen": seen, "subjects": Stamp(read_from, dict.fromkeys(policy.subjects(), ""))}
    )


def _outputs(files: dict[str, bytes]) -> dict[str, str]:
    return {name: digest(content) for name, content in files.items() if "/" not in name}


def _nothing_applies(name: str, policy: LoadedPolicy, *, known: bool) -> Diagnostic:
    if known:
        return Diagnostic(
            "subject-unnamed",
            Severity.WARNING,
            f"no profile of the policy applies to /{name} any more: it is left without permissions",
            None,
            f"remove src/{name}, or name it in the policy",
            f"/{name}",
        )
    hint = did_you_mean(f"/{name}", policy.subjects(), "attach a profile to it")
    return Diagnostic(
        "subject-unknown",
        Severity.ERROR,
        f"no profile of the policy applies to /{name}",
        None,
        hint,
        f"/{name}",
    )
