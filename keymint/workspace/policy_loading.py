# SPDX-License-Identifier: Apache-2.0
"""Load the workspace's policy, and record what it was read from."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from comarmor.values import Data, replace
from comarmor.xml.package_folders import CopiedPackages, PackageFolders
from keymint import api
from keymint.api import AppliedProfile, LoadedPolicy, PolicyDecision, PolicyStructure
from keymint.api.plugin_loader import Plugins
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.ir import SubjectRules
from keymint.names import package_name
from keymint.store.changes import Plan
from keymint.view.stamps import Stamp, State, digest
from keymint.workspace import shipped_profiles
from keymint.workspace.session import Session
from keymint.workspace.shipped_profiles import installed_packages, refuse_unaccepted

POLICY, _FILES, _SUBJECTS, _PROFILES = "policy", "seen", "subjects", "profiles"
"""Keys of the record of the policy: the paths that it was read from, the subjects that it names, and its profiles."""
_MOST_PROFILES = 1_000
"""About how many profiles the record names: enough to know a policy again."""


def load_policy(session: Session, *, trust_links: bool = False) -> LoadedPolicy:
    """Load the policy that the profile names; errors as :meth:`keymint.api.PolicyType.load`.

    A library that is only planned yet is read from where it will be copied from, and named by its future path.

    Args:
        session: the workspace and its profile.
        trust_links: follow symbolic links out of the folders of ROS packages, also where the owner did not decide it.

    Raises:
        UnacceptedPackagesError: it includes files of ROS packages that its owner did not accept as they are now.
    """
    policy = _load(session, installed_packages(session, trust_links=trust_links))
    refuse_unaccepted(session, policy, functools.partial(accepted_policy, session, absent_is_empty=True))
    return policy


def accepted_policy(session: Session, *, absent_is_empty: bool = False) -> LoadedPolicy:
    """Load the policy with the files of ROS packages as its owner accepted them, wherever they are installed.

    Args:
        session: the workspace and its profile.
        absent_is_empty: a file that was not accepted counts as empty.

    Raises:
        KeymintError: as of :func:`load_policy`; without ``absent_is_empty`` also if a copy is missing.
    """
    copies = session.profile.package_copies
    return _load(session, CopiedPackages(copies, absent_is_empty) if copies else installed_packages(session))


def policy_in_force(session: Session) -> tuple[LoadedPolicy, tuple[Diagnostic, ...]]:
    """Return the policy for documents that are issued again, and warnings; see :func:`lazy_policy`.

    A package that was updated, or that this shell does not find, must keep nobody from renewing and revoking. So where
    the policy cannot be read with what packages ship, it is read with what its owner accepted of that.

    Raises:
        KeymintError: it cannot be read so either; the error is that of :func:`lazy_policy`.
    """
    try:
        return lazy_policy(session), ()
    except KeymintError as error:
        if not session.profile.packages:
            raise
        try:
            policy = accepted_policy(session)
            refuse_unaccepted(session, policy, lambda: policy)
        except KeymintError:
            raise error from None
        return policy, tuple(
            replace(each, severity=Severity.WARNING, message=f"{each.message}; here it counts as it was accepted")
            for each in error.diagnostics
        )


def plan_acceptance(session: Session, named: Mapping[str, str], *, trust_links: bool) -> Plan:
    """Plan to accept what ROS packages ship; see :func:`keymint.workspace.shipped_profiles.plan_acceptance`."""
    return shipped_profiles.plan_acceptance(session, named, functools.partial(_load, session), trust_links=trust_links)


def _load(session: Session, folders: PackageFolders) -> LoadedPolicy:
    profile = session.profile
    library, shown = profile.library, None
    if library is not None and not library.is_dir():
        library, shown = session.profile_type.library(profile.distro), library
    try:
        return session.policy_type.load(profile.policies, library, shown, folders)
    except KeymintError as error:
        paths = [source.path for source in profile.policies]
        foreign = foreign_policy(session.plugins, paths, profile.policy_type)
        if foreign is None:
            raise
        raise foreign.refusal(session.workspace.shown(foreign.path), str(session.profile_marker())) from error


def lazy_policy(session: Session) -> LoadedPolicy:
    """Return the policy; if its files did not change, it is loaded only when rules or decisions are asked for.

    Loading a large policy costs more than everything else in a run without changes. The record has the paths that the
    policy was read from and the subjects that it names.
    """
    recorded = recorded_files(session)
    if recorded is None or not is_unchanged(session):
        return load_policy(session)
    seen = {Path(path): bytes.fromhex(value) for path, value in recorded.items()}
    return _LazyPolicy(seen, tuple(sorted(recorded_subjects(session))), functools.partial(load_policy, session))


def is_recorded(session: Session) -> bool:
    """Tell whether the record has the policy."""
    return session.state.stamp(POLICY, _FILES) is not None


def is_unchanged(session: Session) -> bool:
    """Tell whether the policy would be read from the recorded files with the recorded content."""
    recorded, fingerprint = recorded_files(session), session.policy_type.fingerprint
    return (
        recorded is not None
        and session.state.stamp(POLICY, _SUBJECTS) is not None
        and all(fingerprint(Path(path)).hex() == value for path, value in recorded.items())
    )


def recorded_files(session: Session) -> Mapping[str, str] | None:
    """Return the paths that the policy was read from, each with its fingerprint.

    The result is None if the record has none, or has those of another place: the workspace is a copy.
    """
    recorded = session.state.stamp(POLICY, _FILES)
    return recorded.outputs if recorded is not None and recorded.inputs == locations_digest(session) else None


def recorded_subjects(session: Session) -> frozenset[str]:
    """Return the subjects that the policy named when it was recorded."""
    return _recorded(session, _SUBJECTS)


def recorded_profiles(session: Session) -> frozenset[str]:
    """Return outermost profiles of the policy that the packages were made from, wherever the workspace was then."""
    return _recorded(session, _PROFILES)


def _recorded(session: Session, key: str) -> frozenset[str]:
    recorded = session.state.stamp(POLICY, key)
    return frozenset(recorded.outputs if recorded is not None else ())


def recorded_epoch(state: State) -> str:
    """Return the digest of the policy and the profile that all packages on record follow; empty if it is not known."""
    recorded = state.stamp(POLICY, _FILES)
    return recorded.context if recorded is not None else ""


def record_policy(
    session: Session, seen: Mapping[Path, bytes], subjects: Iterable[str], epoch: str = "", profiles: Sequence[str] = ()
) -> State:
    """Return the state with a policy on record.

    Args:
        session: the workspace and its profile.
        seen: the paths that the policy was read from, each with its fingerprint; see :attr:`LoadedPolicy.seen`.
        subjects: the subjects that it names.
        epoch: see :func:`recorded_epoch`.
        profiles: its outermost profiles; none if it was not loaded, so that they are those on record.
    """
    locations, outputs = locations_digest(session), {str(path): value.hex() for path, value in seen.items()}
    stamps = {
        _FILES: Stamp(locations, outputs, context=epoch),
        _SUBJECTS: Stamp(locations, dict.fromkeys(subjects, "")),
    }
    if profiles:
        some = profiles[:: len(profiles) // _MOST_PROFILES + 1]
        stamps[_PROFILES] = Stamp(locations, dict.fromkeys(some, ""))
    return session.state.updated(POLICY, stamps)


def package_of(policy: LoadedPolicy, subject: str) -> str:
    """Return the package of a subject; the error for an illegal name has its location in the policy."""
    try:
        return package_name(subject)
    except KeymintError as error:
        where = next((applied.where for applied in policy.profiles(subject)), None)
        raise error.at(where) from None


def locations_digest(session: Session) -> str:
    """Return the digest of the paths that the policy is read from; a copy of the workspace has another one."""
    profile = session.profile
    paths = [source.path for source in profile.policies]
    if profile.packages:
        installed = installed_packages(session)
        paths += (path for name in profile.packages for path in installed.looked_at(name))
    return digest(session.profile_digest, str(profile.library), *map(str, paths))


class _LazyPolicy(LoadedPolicy):
    """A policy whose subjects come from the record; the policy itself is loaded at the first question about rules."""

    seen: Mapping[Path, bytes] = {}

    def __init__(self, seen: Mapping[Path, bytes], subjects: tuple[str, ...], load: Callable[[], LoadedPolicy]) -> None:
        self.seen = seen
        self._subjects = subjects
        self._load = functools.cache(load)

    def subjects(self) -> tuple[str, ...]:
        """Return the subjects that the policy names exactly."""
        return self._subjects

    def root_profiles(self) -> tuple[str, ...]:
        """Return nothing: the record knows them."""
        return ()

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject."""
        return self._load().rules(subject)

    def rules_digest(self, subject: str) -> str | None:
        """Return the digest of the rules of a subject, if the type of the policy knows it."""
        return self._load().rules_digest(subject)

    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject."""
        return self._load().profiles(subject)

    def structure(self) -> PolicyStructure | None:
        """Return the structure of the policy, if its type provides one."""
        return self._load().structure()

    def decide(self, edge: api.Edge) -> PolicyDecision:
        """Return the policy's decision about an edge."""
        return self._load().decide(edge)


class ForeignPolicy(Data):
    """A file that a policy type recognises.

    Attributes:
        path: the file.
        policy_type: name of the policy type.
        noun: what its files are called, with its article.
        imported: its type translates it; else it is used as it is.
    """

    path: Path
    policy_type: str
    noun: str
    imported: bool

    def refusal(self, shown: str, profile: str = "") -> KeymintError:
        """Return the error that the file must be imported first, or that its type must be named.

        Args:
            shown: its path as the user would type it.
            profile: path of the document that names the type of the policy, if a workspace has the file.
        """
        if self.imported:
            help_ = f"keymint import {shown} -o comarmor.d"
        elif profile:
            help_ = f"write <policy_type>{self.policy_type}</policy_type> into {profile}, or make a new workspace"
        else:
            help_ = "'keymint lint', 'keymint query' and 'keymint provision' read it"
        return KeymintError(f"this is {self.noun}", where=Origin(shown), help=help_, code="policy-foreign")


def foreign_policy(plugins: Plugins, paths: Iterable[Path], expected: str = "") -> ForeignPolicy | None:
    """Return the first file of some policies that another policy type recognises, or None.

    Args:
        plugins: the plugins.
        paths: files, and folders with policies directly in them.
        expected: name of the policy type that could not load them; empty if none was tried.
    """
    known = {name: policy_type for name, policy_type in plugins.policy_types().items() if name != expected}
    for path in (file for each in paths for file in _files(each)):
        for name, policy_type in known.items():
            if policy_type.recognises(path):
                return ForeignPolicy(path, name, policy_type.NOUN, bool(policy_type.TOOL))
    return None


def _files(path: Path) -> Iterator[Path]:
    """Yield a file, or the files of a folder that may be roots of a policy."""
    try:
        yield from sorted(path.glob("*.xml")) if path.is_dir() else (path,)
    except OSError:
        return
