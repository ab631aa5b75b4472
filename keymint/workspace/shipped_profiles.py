# SPDX-License-Identifier: Apache-2.0
"""The profiles that ROS packages ship: a workspace uses them only as its owner accepted them (docs/packages.md)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from comarmor.text import did_you_mean, first_few, quantity, quote
from comarmor.values import replace
from comarmor.xml.package_folders import InstalledPackages, ShippedFile
from keymint.api import AcceptedPackage, LoadedPolicy
from keymint.errors import Diagnostic, ExitCode, KeymintError
from keymint.store.changes import Action, FolderChange, Plan, Step, folder_changes
from keymint.workspace.session import Session

STAGE = "create"
_NOTHING = AcceptedPackage({})


class UnacceptedPackagesError(KeymintError):
    """The policy includes files of packages that its owner did not accept as they are now.

    Attributes:
        files: these files, each with the SHA-256 of what was accepted of it, in hex; empty if nothing was.
        before: loads the policy with what was accepted of them, which is nothing of a file that is new.
        after: the policy with what the packages ship.
    """

    files: Mapping[ShippedFile, str]
    before: Callable[[], LoadedPolicy]
    after: LoadedPolicy


def installed_packages(session: Session, named: Iterable[str] = (), *, trust_links: bool = False) -> InstalledPackages:
    """Return the installed packages.

    Args:
        session: the workspace and its profile, which has the packages whose symbolic links are followed.
        named: further ones.
        trust_links: follow those of all packages.
    """
    accepted = (name for name, each in session.profile.packages.items() if each.follows_links)
    return InstalledPackages(session.environment, None if trust_links else frozenset((*accepted, *named)))


def refuse_unaccepted(session: Session, policy: LoadedPolicy, before: Callable[[], LoadedPolicy]) -> None:
    """Refuse a policy with files of packages that the owner of the workspace did not accept as they are.

    Args:
        session: the workspace and its profile.
        policy: the policy, as it was read.
        before: loads it with the accepted copies.

    Raises:
        UnacceptedPackagesError: there are such files.
        KeymintError: a copy of what was accepted was edited.
    """
    shipped = policy.shipped
    if not shipped:
        return
    _refuse_edited_copies(session, shipped)
    accepted = {each: _accepted(session, each.package, each.path) for each in shipped}
    found = {each: value for each, value in accepted.items() if each.sha256 != value}
    if not found:
        return
    error = UnacceptedPackagesError.of(_diagnostics(shipped, found))
    error.files, error.before, error.after = found, before, policy
    raise error


def package_digest(files: Mapping[str, str]) -> str:
    """Return the digest of a package's files: that of what ``sha256sum`` prints for them, sorted by path.

    Args:
        files: SHA-256 of each file, in hex, by its path.
    """
    return hashlib.sha256("".join(f"{value}  {path}\n" for path, value in sorted(files.items())).encode()).hexdigest()


def plan_acceptance(
    session: Session,
    named: Mapping[str, str],
    load: Callable[[InstalledPackages], LoadedPolicy],
    *,
    trust_links: bool,
) -> Plan:
    """Plan to accept the profiles of packages as they are now: their digests, and copies to compare with later.

    Args:
        session: the workspace and its profile.
        named: the packages, each with the :func:`package_digest` that it must have, or an empty text.
        load: loads the policy with the installed packages.
        trust_links: follow the symbolic links of these packages, from now on.

    Raises:
        KeymintError: the policy includes nothing of a package, or has defects, or a package has another digest, or the
            profile cannot keep it.
    """
    profile = session.profile
    if session.profile_type.with_packages({}) is None or profile.package_copies is None:
        message = f"the profile type {profile.profile_type!r} cannot keep what was accepted of packages"
        help_ = "copy the files into the policy, and include the copies"
        raise KeymintError(message, where=session.profile_marker(), help=help_, code="profile-without-packages")
    by_package: dict[str, list[ShippedFile]] = {}
    for each in load(installed_packages(session, named if trust_links else ())).shipped or ():
        by_package.setdefault(each.package, []).append(each)
    accepted = dict(profile.packages)
    steps: list[Step] = []
    for name, wanted in named.items():
        if name not in by_package:
            message = f"the policy includes no file of a package {quote(name)}"
            help_ = did_you_mean(name, by_package, f"write package://{name}/FILE.xml into a profile first")
            raise KeymintError(message, help=help_, code="package-unknown", exit_code=ExitCode.USAGE)
        before = accepted.get(name, _NOTHING)
        files = {each.path: each.sha256 for each in by_package[name]}
        if wanted and wanted != (now := package_digest(files)):
            message = f"the package {quote(name)} ships something else than what is to be accepted: its digest is {now}"
            where, help_ = by_package[name][0].where, "leave out --trust-package to see what it would change now"
            raise KeymintError(message, where=where, help=help_, code="package-changed")
        accepted[name] = AcceptedPackage(files, before.follows_links or trust_links)
        copies = {each.path: each.content for each in by_package[name]}
        changes = (
            *folder_changes(session.tree, profile.package_copies / name, copies),
            *_removed(session, name, (path for path in before.files if path not in copies)),
        )
        action = Action.UPDATED if changes or accepted[name] != before else Action.UNCHANGED
        detail = f"accepted {quantity(len(files), 'file')} of the package {name}"
        steps.append(Step(STAGE, "", action, changes, detail))
    return _with_lock(session, steps, accepted)


def _with_lock(session: Session, steps: list[Step], accepted: Mapping[str, AcceptedPackage]) -> Plan:
    """Return a plan of some steps, of which the last one that changes copies also writes what was accepted."""
    root = session.workspace.profile
    lock = session.profile_type.with_packages(accepted) or {}
    written = folder_changes(session.tree, root, lock) if accepted else (FolderChange(root, removed=tuple(lock)),)
    last = max((at for at, step in enumerate(steps) if step.action is Action.UPDATED), default=None)
    if last is not None:
        steps[last] = replace(steps[last], changes=(*steps[last].changes, *written))
    return Plan(tuple(steps), session.state)


def plan_release(session: Session, policy: LoadedPolicy) -> Plan:
    """Plan to drop what was accepted of files that the policy does not include any more.

    An acceptance that outlives its include would let a later include grant rights that nobody decides about.

    Args:
        session: the workspace and its profile.
        policy: its policy. One that is not loaded has not changed, and drops nothing.
    """
    profile = session.profile
    shipped = policy.shipped
    if not profile.packages or shipped is None:
        return Plan((), session.state)
    included = {(each.package, each.path) for each in shipped}
    kept: dict[str, AcceptedPackage] = {}
    steps: list[Step] = []
    for name, each in profile.packages.items():
        files = {path: value for path, value in each.files.items() if (name, path) in included}
        if files:
            kept[name] = AcceptedPackage(files, each.follows_links)
        if dropped := [path for path in each.files if path not in files]:
            detail = f"dropped {quantity(len(dropped), 'file')} of the package {name}, no longer included"
            steps.append(Step(STAGE, "", Action.UPDATED, tuple(_removed(session, name, dropped)), detail))
    return _with_lock(session, steps, kept)


def _removed(session: Session, name: str, paths: Iterable[str]) -> Iterator[FolderChange]:
    """Yield the removal of copies of a package, if they are there."""
    copies = session.profile.package_copies
    for path in (copies / name / each for each in paths if copies is not None):
        if session.tree.read(path) is not None:
            yield FolderChange(path.parent, removed=(path.name,))


def _refuse_edited_copies(session: Session, shipped: Sequence[ShippedFile]) -> None:
    """Refuse copies that are not what was accepted: the comparison with them would not tell what changes."""
    copies = session.profile.package_copies
    if copies is None:
        return
    packages = dict.fromkeys(each.package for each in shipped)
    named = [(name, path) for name in packages for path in session.profile.packages.get(name, _NOTHING).files]
    for name, path in dict.fromkeys((*named, *((each.package, each.path) for each in shipped))):
        content = session.tree.read(copies / name / path)
        if content is not None and hashlib.sha256(content).hexdigest() != _accepted(session, name, path):
            raise KeymintError(
                f"is not the copy of what was accepted of the package {quote(name)}; an edit here grants nothing",
                where=session.workspace.origin(copies / name / path),
                help="restore it, or remove it; to change rights, write them into the policy",
                code="package-copy-edited",
            )


def _diagnostics(shipped: Sequence[ShippedFile], found: Mapping[ShippedFile, str]) -> Iterator[Diagnostic]:
    """Yield an error for each package; it has the digest, so that exactly what was seen can be accepted."""
    for name in dict.fromkeys(each.package for each in found):
        own = [each for each in found if each.package == name]
        paths = first_few([each.path for each in own])
        known = any(found[each] for each in own)
        message = (
            f"the package {quote(name)} ships something else than what was accepted: {paths}"
            if known
            else f"what the package {quote(name)} ships was not accepted yet: {paths}"
        )
        value = package_digest({each.path: each.sha256 for each in shipped if each.package == name})
        help_ = (
            f"if what it changes is right, repeat the command with --trust-package {name}={value}; "
            "'keymint create --all' and 'keymint provision' list who gains and who loses what by it"
        )
        code = "package-changed" if known else "package-unaccepted"
        yield Diagnostic.error(code, message, own[0].where, help_)


def _accepted(session: Session, package: str, path: str) -> str:
    """Return the SHA-256 of a file that was accepted, or an empty text."""
    return session.profile.packages.get(package, _NOTHING).files.get(path, "")
