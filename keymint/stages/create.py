# SPDX-License-Identifier: Apache-2.0
"""The stages ``init`` and ``create``: a new workspace with its policy, and from the policy to source packages.

It is also asked here where the packages do not follow the policy.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from comarmor.text import did_you_mean, first_few, quantity, quote
from keymint import api
from keymint.errors import Diagnostic, ExitCode, KeymintError, Origin, Severity
from keymint.ir import SubjectRules
from keymint.names import ROOT, refuse_case_collisions, refuse_reserved, subject_of
from keymint.stages.work import NewPackage, PackagePlan, PackageStage, state_after, steps_of
from keymint.store.changes import Action, File, FolderChange, Plan, Step, by_folder, folder_changes, same_file
from keymint.view.stamps import Stamp, digest, digest_of_texts
from keymint.workspace.policy_loading import (
    is_recorded,
    is_unchanged,
    load_policy,
    package_of,
    record_policy,
    recorded_epoch,
    recorded_subjects,
)
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import PROFILE_MARKER, hidden_by, with_place

INIT, STAGE = "init", "create"
_IGNORED = b"# Secrets, and files that Keymint can build again.\n/private/\n/build/\n/install/\n/.keymint/\n"


def plan_init(
    inputs: Inputs, profile_type: str, request: api.Bootstrap, distro: str | None = None, cwd: Path | None = None
) -> Plan:
    """Plan the files of a new workspace; existing files are kept.

    Args:
        inputs: the workspace.
        profile_type: the plugin that makes the profile.
        request: what the profile has.
        distro: the distribution that the user named; None if the default is taken.
        cwd: the current folder, for a word to who makes that a workspace.

    Raises:
        KeymintError: no such profile type, distro or layout; or the folder is a keystore of another tool, or a
            workspace whose profile is lost.
    """
    root, place = inputs.workspace.profile, inputs.workspace.root
    is_new = not inputs.workspace.exists()  # else an interrupted run has just been finished
    if is_new and {("enclaves", True), ("public", True)} <= {*inputs.tree.names(place)}:
        what, help_ = "'ros2 security'", f"keymint adopt {inputs.workspace.shown(place)} POLICY --apply -w WORKSPACE"
        if (place.parent / "profile" / PROFILE_MARKER).is_file():
            what, help_ = "a workspace", f"name the workspace: -w {inputs.workspace.shown(place.parent)}"
        message, where = f"is a keystore of {what}, and no workspace", inputs.workspace.origin(place)
        raise KeymintError(message, where=where, help=help_, code="workspace-keystore")
    if is_new and inputs.state.stamps and distro is None:  # only the owner knows which it had
        raise KeymintError(
            "is missing, but the workspace has packages: it had the distribution, the transports and the layout",
            where=inputs.workspace.origin(root / PROFILE_MARKER),
            help="restore it from version control or a backup; or say what it had: --distro NAME, and --transport, "
            "--layout, --domain and --valid-for unless these were the defaults",
            code="profile-lost",
        )
    files = inputs.plugins.profile_type(profile_type).bootstrap(request)
    missing = {path: File(new) for path, new in sorted(files.items()) if inputs.tree.read(f"{root}/{path}") is None}
    folders = by_folder(root, missing)
    # The marker makes the folder a workspace, so it is the last file to be written.
    changes = [FolderChange(folder, new) for folder, new in folders.items() if folder != root]
    ordered = dict(sorted(folders.get(root, {}).items(), key=lambda item: item[0] == PROFILE_MARKER))
    if inputs.tree.read(inputs.workspace.root / ".gitignore") is None:
        changes.append(FolderChange(inputs.workspace.root, {".gitignore": File(_IGNORED)}))
    changes.append(FolderChange(root, ordered))
    what = f"workspace profile{', in the current folder' if place == cwd else ''}"
    return Plan((Step(INIT, "", Action.CREATED, tuple(changes), what),), inputs.state)


def refuse_unsupported(session: Session) -> None:
    """Refuse a new profile that a build type of its packages cannot serve.

    Raises:
        KeymintError: a build type has no such layout, or its transport does not exist for the distribution.
    """
    profile = session.profile
    for build_type in session.build_types.values():
        if profile.layout not in build_type.LAYOUTS:
            raise KeymintError(
                f"the transport {build_type.TRANSPORT} has no layout {profile.layout!r}",
                help=f"it has {', '.join(build_type.LAYOUTS)}; an older distribution may need another transport",
                code="layout-unsupported",
                exit_code=ExitCode.USAGE,
            )
    session.needed_infrastructure()


def plan_policy(session: Session, policy: str) -> Plan:
    """Plan to change the policy that a workspace's profile names, if it names another one.

    Args:
        session: the workspace and its profile.
        policy: path of the policy relative to the profile space.

    Raises:
        KeymintError: the profile's list of policies was edited by hand.
    """
    profile = session.profile
    wanted = (session.workspace.profile / policy).resolve()
    if [source.path.resolve() for source in profile.policies] == [wanted]:
        return Plan((), session.state)
    files = session.profile_type.with_policy(profile.files, policy)
    changes = folder_changes(session.tree, session.workspace.profile, files)
    return Plan((Step(INIT, "", Action.UPDATED, changes, f"policy {policy}"),), session.state)


def other_domain(session: Session, default: str = "") -> tuple[Diagnostic, ...]:
    """Return a warning if nodes that start with these environment variables use a domain that nothing is signed for.

    Without ``ROS_DOMAIN_ID`` their domain is the default; empty if no node starts here, or not with these variables.
    """
    given = session.environment.get("ROS_DOMAIN_ID", "")
    asked = given or default
    own = session.profile_type.settings(session.profile).get("domain", "") if asked else ""
    ranges = [each.strip().partition("-") for each in own.split(",") if each.strip()]
    known = asked.isdecimal() and any(int(first) <= int(asked) <= int(last or first) for first, _, last in ranges)
    if not ranges or known:
        return ()
    is_ = quote(given) if given else f"not set, which means {default}"
    message = f"ROS_DOMAIN_ID is {is_}, but the workspace is for domain {own}: nodes that start so are refused"
    help_ = f"set ROS_DOMAIN_ID to {own} where nodes start, or change the workspace: 'keymint set domain NUMBER'"
    place = session.workspace.profile / next(iter(session.profile_type.PLACES.get("domain", ())), PROFILE_MARKER)
    return (Diagnostic.warning("domain-environment", message, session.workspace.origin(place), help_),)


def library_changes(session: Session, distro: str) -> tuple[FolderChange, ...]:
    """Return what gives a profile the policy library of another distribution; files that were edited stay as they are.

    Raises:
        KeymintError: the distribution is not known.
    """
    library, shipped = session.profile.library, session.profile_type.library
    before, after = shipped(session.profile.distro), shipped(distro)
    if library is None or not session.tree.names(library):
        return ()
    files: dict[str, File] = {}
    for path in sorted(after.rglob("*.xml")):
        name = path.relative_to(after).as_posix()
        former = (before / name).read_bytes() if (before / name).exists() else None
        if session.tree.read(library / name) == former:
            files[name] = File(path.read_bytes())
    return folder_changes(session.tree, library, files)


def policy_path(policy: Path, profile: Path) -> str:
    """Return a policy's path as a profile names it: relative, so that a checkout works anywhere."""
    return os.path.relpath(policy.resolve(), profile.resolve())


def packages_to_create(session: Session, policy: api.LoadedPolicy) -> tuple[str, ...]:
    """Return the packages of every subject that the policy names exactly, and all existing packages of subjects.

    Existing packages follow the policy even if it no longer names them: withdrawn permissions must not remain in their
    sources.
    """
    exact = [package_of(policy, subject) for subject in policy.subjects()]
    existing = session.packages()
    return tuple(sorted({*exact, *existing}.difference(session.infrastructure())))


def stale(session: Session, policy: api.LoadedPolicy, names: Sequence[str]) -> Mapping[str, tuple[Diagnostic, ...]]:
    """Return the packages of subjects that differ from the policy, each with the errors that prevent its update.

    Args:
        session: the workspace and its profile.
        policy: its policy.
        names: names of existing packages.

    Raises:
        KeymintError: names collide.
    """
    stage = CreateStage(session, policy)
    refuse_case_collisions([*stage.existing, *names])
    differing: dict[str, tuple[Diagnostic, ...]] = {}
    for name in (each for each in names if session.role(each) is api.Role.SUBJECT):
        try:
            each = stage.package(name)
        except KeymintError as error:  # a file that is no file, or too large
            differing[name] = error.diagnostics
            continue
        if each.step is None or each.step.action is not Action.UNCHANGED:
            differing[name] = each.errors
    return differing


class CreateStage(PackageStage):
    """The stage ``create``; what packages share is computed once.

    Args:
        session: the workspace and its profile.
        policy: its policy.
        force: replace documents of rules that were edited by hand.
        valid_for: length of validity that the packages get in their own documents, an ISO 8601 duration; empty to
            leave these alone.
    """

    NAME = STAGE

    def __init__(self, session: Session, policy: api.LoadedPolicy, *, force: bool = False, valid_for: str = "") -> None:
        self._session = session
        self._valid_for = valid_for
        self._policy = policy
        self._force = force
        self.existing = frozenset(session.packages())
        seen = (part for path, value in sorted(policy.seen.items()) for part in (str(path), value))
        self._epoch = digest(digest(*seen), session.profile_digest)
        self._is_followed = recorded_epoch(session.state) == self._epoch
        self._package_type = session.package_type
        self._files: dict[str, File] = {}

    def subjects(self, names: Sequence[str], settled: Collection[str] = ()) -> tuple[str, ...]:
        """Return the names that are packages of subjects, not of infrastructure.

        Args:
            names: names of packages.
            settled: those that are known to be packages of subjects.

        Raises:
            KeymintError: names collide, are reserved, or the policy names a package of infrastructure.
        """
        session, infrastructure = self._session, self._session.needed_infrastructure()
        policy = self._policy
        named = set(policy.subjects()).intersection(map(subject_of, infrastructure))
        for name in (each for each in infrastructure if subject_of(each) in named):
            profiles = policy.profiles(subject_of(name))
            raise KeymintError(
                f"the policy names {subject_of(name)}, which is {infrastructure[name][0]} and no subject of the policy",
                where=profiles[-1].where if profiles else None,
                help="rename the subject, or give the package of the transport another name in the profile",
                code="infrastructure-named",
            )
        unknown = self.existing.intersection(names).difference(settled)
        others = {name for name in unknown if session.role(name) is not api.Role.SUBJECT}
        subjects = [name for name in names if name not in infrastructure and name not in others]
        refuse_case_collisions([*self.existing, *subjects, *infrastructure])
        reserved = [each for layout in session.layouts for each in layout.reserved]
        for name in (*subjects, *infrastructure):
            refuse_reserved(name, reserved)
        if ROOT in subjects and not all(layout.enclaves for layout in session.layouts):
            raise KeymintError(
                f"the layout {session.profile.layout!r} has no place for the root enclave '/': enclaves lie at the top "
                "of the install space",
                where=session.profile_marker(),
                help="name the nodes as subjects, or use another layout",
                code="root-enclave",
            )
        return tuple(subjects)

    def plan(self, planned: Sequence[PackagePlan]) -> Plan:
        """Put the plans for some packages together, and add the packages of infrastructure."""
        session = self._session
        needed = session.needed_infrastructure().items()
        planned = [*planned, *(self._infrastructure(name, build_type) for name, (_, build_type) in needed)]
        steps = steps_of(planned)
        diagnostics = tuple(diagnostic for each in planned for diagnostic in each.diagnostics)
        names = {each.name for each in planned}
        epoch = self._epoch if self._is_followed or names >= self.existing else ""
        policy = self._policy
        recorded = record_policy(session, policy.seen, policy.subjects(), epoch, policy.root_profiles())
        gone = [name for name in recorded.stamps.get(STAGE, ()) if name not in names and name not in self.existing]
        return Plan(steps, state_after(recorded, STAGE, planned, gone), diagnostics)

    def follows(self, name: str) -> bool:
        """Tell whether a package was created from the rules that its subject has now, and from the profile."""
        stamp = self._session.state.stamp(STAGE, name)
        return stamp is not None and (self._is_followed or stamp.inputs == self._inputs(self._written(name)))

    def _written(self, name: str) -> str:
        return self._policy.rules_digest(subject_of(name)) or ""

    def _inputs(self, rules: str) -> str:
        """Return the digest of everything that the sources of a package are made of; of the policy, if it can tell."""
        return digest_of_texts(rules, self._session.profile_digest) if rules else self._epoch

    def package(self, name: str) -> PackagePlan:
        """Return the plan for a package."""
        session, force = self._session, self._force
        folder = session.workspace.src / name
        stamp = session.state.stamp(STAGE, name)
        digests = session.file_digests(name)
        outputs = _outputs(digests)
        is_kept = stamp is not None and stamp.outputs == outputs and not force and not self._valid_for
        if is_kept and self.follows(name):  # other subjects may have other rules now
            return PackagePlan(name, Step(STAGE, name, Action.UNCHANGED))
        files = session.package_files(name) if digests else {}
        known = name in self.existing
        rules = self._policy.rules(subject_of(name))
        unnamed: tuple[Diagnostic, ...] = ()
        if rules is None:
            unnamed = (_nothing_applies(name, self._policy, known=known),)
            rules = SubjectRules(subject_of(name), ())
        errors = () if known else unnamed
        try:
            new = self._package_type.create(session.profile, rules, files, force=force)
            new = {**new, **self._with_validity(rules, {**files, **new}), **self._with_generation(name)}
        except KeymintError as error:
            in_the_way = (with_place(diagnostic, session.workspace.src) for diagnostic in error.diagnostics)
            return PackagePlan(name, None, None, unnamed if known else (), (*errors, *in_the_way))
        written = marker_last(self._package_type, new)
        changes = folder_changes(session.tree, folder, written)
        action = (Action.UPDATED if known else Action.CREATED) if changes else Action.UNCHANGED
        step = Step(STAGE, name, action, changes)
        outputs |= _outputs({file: new_file.digest for file, new_file in written.items()})
        # Documents of former versions that are replaced.
        former = self._package_type.former_rules(rules, files) if changes and files else ()
        found = (*(unnamed if known else ()), *(with_place(each, session.workspace.src) for each in former))
        return PackagePlan(name, step, Stamp(self._inputs(self._written(name)), outputs), found, errors)

    def new(self, new: NewPackage) -> PackagePlan:
        """See :meth:`keymint.stages.work.PackageStage.new`."""
        session, name, marker = self._session, new.name, self._package_type.MARKER
        made = self._package_type.create(session.profile, new.rules, {}, force=False)
        ordered = sorted(made.items(), key=lambda item: item[0] == marker)
        new.sources = {file: same_file(self._files, file, content) for file, content in ordered}
        step = Step(STAGE, name, Action.CREATED, (FolderChange(f"{session.workspace.src}/{name}", new.sources),))
        digests = {file: each.digest for file, each in new.sources.items()}
        return PackagePlan(name, step, Stamp(self._inputs(new.written), _outputs(digests)))

    def _with_validity(self, rules: SubjectRules, files: Mapping[str, bytes]) -> Mapping[str, bytes]:
        """Return the files of a package that change so that it has the requested validity."""
        session = self._session
        if not self._valid_for:
            return {}
        changed = self._package_type.with_validity(session.profile, rules, files, self._valid_for, session.now)
        if changed is None:
            raise KeymintError(
                f"packages of the type {session.profile.package_type!r} have no validity of their own",
                where=session.profile_marker(),
                help="leave out --valid-for, and write it into their sources",
                code="validity-unsupported",
            )
        return changed

    def _with_generation(self, name: str) -> Mapping[str, bytes]:
        """Return the file that makes a new package go on where certificates of its name ended."""
        session, package_type = self._session, self._package_type
        if name in self.existing or not session.tree.has_file(session.workspace.register):
            return {}
        from keymint.life.workspace_register import register_of  # noqa: PLC0415 - imports cryptography, which takes 0.1 s

        generation = register_of(session).generation(name)
        decided = package_type.with_issuance(api.Issuance(generation)) if generation else {}
        return {file: content for file, content in decided.items() if file not in session.file_digests(name)}

    def _infrastructure(self, name: str, build_type: str) -> PackagePlan:
        """Return the plan for a package that a transport needs, which does not follow the policy."""
        session = self._session
        folder = session.workspace.src / name
        if name in self.existing:
            if session.role(name) is api.Role.INFRASTRUCTURE:
                return PackagePlan(name, Step(STAGE, name, Action.UNCHANGED))
            message = "the package is that of a subject, but a transport needs one of this name"
            help_ = f"remove src/{name}, or give the package of the transport another name in the profile"
            where = session.package_marker(name)
            return PackagePlan(name, errors=(Diagnostic.error("infrastructure-taken", message, where, help_),))
        files = session.package_files(name)
        new = self._package_type.create_infrastructure(session.profile, name, build_type, files)
        written = marker_last(self._package_type, new)
        outputs = {**session.file_digests(name), **{file: new.digest for file, new in written.items()}}
        step = Step(STAGE, name, Action.CREATED, folder_changes(session.tree, folder, written))
        return PackagePlan(name, step, Stamp(self._epoch, _outputs(outputs)))


def marker_last(package_type: api.PackageType, new: Mapping[str, bytes]) -> dict[str, File]:
    """Return the files of a new package; the marker goes last: until then a later run sees no package."""
    ordered = sorted(new.items(), key=lambda item: item[0] == package_type.MARKER)
    return {file: File(content) for file, content in ordered}


def _outputs(digests: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in digests.items() if "/" not in name}


def _nothing_applies(name: str, policy: api.LoadedPolicy, *, known: bool) -> Diagnostic:
    subject = subject_of(name)
    message = f"no profile of the policy applies to {subject}"
    if known:
        message, help_ = (
            f"{message} any more: it is left without permissions",
            f"'keymint remove {subject}' removes it and revokes its certificate; or name it in the policy",
        )
        return Diagnostic.warning("subject-unnamed", message, None, help_, subject)
    hint = did_you_mean(subject, policy.subjects(), "attach a profile to it")
    return Diagnostic.error("subject-unknown", message, None, hint, subject)


def not_pruned(session: Session, policy: api.LoadedPolicy, told: Collection[str]) -> tuple[Diagnostic, ...]:
    """Return a warning on packages that no profile applies to, for a user who expects that they are pruned, if any.

    Args:
        session: the workspace and its profile.
        policy: its policy.
        told: subjects that a warning is about already.
    """
    own = (name for name in session.packages() if session.role(name) is api.Role.SUBJECT)
    subjects = [each for each in map(subject_of, own) if each not in told and policy.rules_digest(each) is None]
    left = [each for each in subjects if policy.rules(each) is None]
    if not left:
        return ()
    message = f"no profile of the policy applies to {first_few(left)}, whose package is still there"
    help_ = f"'keymint remove {left[0]}' removes package, enclave and key, and revokes its certificate"
    return (Diagnostic.warning("subject-unnamed", message, None, help_),)


CHANGED = "policy-changed"
"""Code of the warning that packages are not what the policy says now."""
UNCREATED = "subjects-uncreated"
"""Code of the finding on subjects that have no source package."""


def policy_changed(session: Session) -> tuple[Diagnostic, ...]:
    """Return a warning if the packages were created from another policy.

    The record is only a hint: a comment, another default of the profile or a copy of the workspace changes no package.
    So the policy is loaded and compared with the packages where the record differs.
    """
    if not is_recorded(session) or is_unchanged(session):
        return ()
    try:
        policy = load_policy(session)
        existing, before = session.packages(), recorded_subjects(session)
        # Those that differ from the policy, and those of subjects that it did not name before.
        new = {package_of(policy, subject) for subject in policy.subjects() if subject not in before}
        names = sorted({*stale(session, policy, existing), *(new - set(existing))})
    except KeymintError as error:
        message = f"the policy changed since the packages were created, and cannot be read: {error.diagnostics[0]}"
        return (Diagnostic.warning(CHANGED, message, None, "fix it, then run 'keymint create --all'"),)
    if not names:
        return ()
    shown = first_few([subject_of(name) for name in names])
    message = f"{quantity(len(names), 'source package')} out of date with the policy, which changed: {shown}"
    file = session.workspace.shown(session.profile.policies[0].path)
    help_ = f"run 'keymint create --all', or 'keymint provision {file}' for all stages"
    return (Diagnostic.warning(CHANGED, message, Origin(file), help_),)


def subjects_without_package(inputs: Inputs, policy: api.LoadedPolicy, known: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return a finding on the subjects that the policy names exactly and that have no source package, if any.

    A workspace may deliberately create some subjects only. But without any package nothing is checked, and no verb may
    report that as success.

    Args:
        inputs: the workspace.
        policy: its policy.
        known: names of its packages. If there are none, subjects that a KEYMINT_IGNORE hides count as well, because
            otherwise nothing at all would be checked.
    """
    src, created = inputs.workspace.src, set(known)
    missing = [name for name in (package_of(policy, subject) for subject in policy.subjects()) if name not in created]
    missing = [name for name in missing if not known or hidden_by(inputs.tree, src, name) is None]
    if not missing:
        return ()
    shown = first_few([subject_of(name) for name in missing])
    subjects = "a subject that has" if len(missing) == 1 else f"{len(missing)} subjects that have"
    marker = hidden_by(inputs.tree, src, missing[0])
    return (
        Diagnostic(
            UNCREATED,
            Severity.NOTE if known else Severity.WARNING,
            f"the policy names {subjects} no source package: {shown}",
            inputs.workspace.origin(marker) if marker else None,
            "remove this file" if marker else "run 'keymint create --all', then build and install",
        ),
    )
