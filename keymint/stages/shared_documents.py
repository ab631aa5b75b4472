# SPDX-License-Identifier: Apache-2.0
"""Documents over all packages of a build type, in the folder ``shared.d`` of the build space.

They hold the rights of everybody, so each run brings them up to date, whichever packages it is about.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from comarmor.errors import Defects, Diagnostic
from comarmor.regex import lazy_regex
from keymint.api import BuildOptions, BuildResult, Package
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.stages.built_documents import kept_documents_step, refuse_edits
from keymint.stages.package_stage import PackagePlan
from keymint.store.changes import Action, File, FolderChange, Step, by_folder
from keymint.view.stamps import Stamp, digest
from keymint.workspace.package_build_types import BUILD, build_types_of, inputs_digest, shared_builder
from keymint.workspace.session import Session, once

FOLDER = "shared.d"
"""Folder of the build space; a dot is illegal in names of packages."""
STAGE = BUILD
_PATH = lazy_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]*(?:/[A-Za-z0-9_][A-Za-z0-9_.-]*)*")

Users = Mapping[str, tuple[str, ...]]
"""Names of the packages that each build type with shared documents has, sorted."""


def record_key(build_type: str) -> str:
    """Return the key of the record of a build type's shared documents; it is no name of a package."""
    return f"{FOLDER}/{build_type}"


@once
def users(session: Session) -> Users:
    """Return the packages of each build type that has shared documents; build types without packages are omitted.

    Packages that did not change since they were built are not loaded.

    Raises:
        KeymintError: which build types a package has is unknown, because its sources have defects.
    """
    names, before = session.packages(), session.state.stamps.get(STAGE, {})
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        with contextlib.suppress(KeymintError):  # raised below, if there are shared documents
            known = before[name].build_types if name in before else ()
            found[name] = known or tuple(build_types_of(session, session.package(name)))
    if not (shared := _shared(session, found)):
        return {}
    defects = Defects()
    for name in names:
        if name not in found or (name in before and before[name].inputs != inputs_digest(session, name)):
            with defects, _blocking(session, shared, name):
                found[name] = tuple(build_types_of(session, session.package(name)))
    defects.require_none()
    return {
        build_type: tuple(name for name in names if build_type in found[name]) for build_type in _shared(session, found)
    }


def _shared(session: Session, build_types: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the build types of some packages that have shared documents, sorted."""
    known = {build_type for of_package in build_types.values() for build_type in of_package}
    return sorted(build_type for build_type in known if shared_builder(session, build_type))


def load_packages(session: Session, build_type: str) -> tuple[Package, ...]:
    """Return the packages of a build type.

    Raises:
        KeymintError: the sources of a package have defects, so the shared documents cannot be built.
    """
    loaded: list[Package] = []
    defects = Defects()
    for name in users(session)[build_type]:
        with defects, _blocking(session, [build_type], name):
            loaded.append(session.package(name))
    defects.require_none()
    return tuple(loaded)


@contextlib.contextmanager
def _blocking(session: Session, build_types: Iterable[str], name: str) -> Iterator[None]:
    """Say of the defects of a package that they block the shared documents of some build types; a context."""
    try:
        yield
    except KeymintError as error:
        of_types = ", ".join(build_types)
        message = (
            f"the sources of {subject_of(name)} have defects, so the shared documents of {of_types} cannot be built"
        )
        where, help_ = session.package_marker(name), "fix it: they hold the rights of all packages"
        blocked = Diagnostic.error("shared-blocked", message, where, help_)
        raise KeymintError.of((blocked, *error.diagnostics)) from None


def sources_digest(session: Session, build_type: str) -> str:
    """Return the digest of everything that the shared documents of a build type are built from, except the options."""
    names = users(session)[build_type]
    return digest(session.profile.layout, *(part for name in names for part in (name, inputs_digest(session, name))))


def is_current(session: Session, build_type: str) -> bool:
    """Tell whether the shared documents of a build type were built from the present sources, with any options."""
    stamp = session.state.stamp(STAGE, record_key(build_type))
    return stamp is not None and stamp.inputs == sources_digest(session, build_type)


def built_shared(session: Session, build_type: str) -> dict[str, bytes] | None:
    """Return the unsigned shared documents of a build type by path; None if they were not built or one is missing."""
    stamp = session.state.stamp(STAGE, record_key(build_type))
    if stamp is None:
        return None
    contents = {path: session.tree.read(shared_folder(session) / path) for path in stamp.outputs}
    found = {path: content for path, content in contents.items() if content is not None}
    return found if len(found) == len(contents) else None


def shared_folder(session: Session) -> Path:
    """Return the folder of the unsigned shared documents."""
    return session.workspace.build / FOLDER


def build_shared(session: Session, name: str, loaded: Sequence[Package], options: BuildOptions) -> BuildResult:
    """Return the shared documents of a build type.

    Args:
        session: the workspace and its profile.
        name: name of the build type.
        loaded: its packages.
        options: options of the build.

    Raises:
        KeymintError: the packages contradict each other.
        ValueError: the build type breaks the rules for paths.
    """
    builder = session.plugins.build_type(name)
    result = builder.build_shared(loaded, options)
    layout = builder.LAYOUTS[session.profile.layout]
    for path in result.documents:
        if not _PATH.fullmatch(path) or (layout.enclaves and f"{path}/".startswith(f"{layout.enclaves}/")):
            raise ValueError(f"{name} has a shared document with an illegal path: {path!r}")
    return result


def plan_shared_build(session: Session, options: BuildOptions, *, force: bool) -> list[PackagePlan]:
    """Return the plans for the unsigned shared documents of all build types.

    Args:
        session: the workspace and its profile, with the record of the packages that this run builds.
        options: options of the build.
        force: rebuild, and overwrite documents that were edited by hand.

    Raises:
        KeymintError: a package has defects, or packages contradict each other.
    """
    planned = [_plan_documents(session, name, options, force=force) for name in users(session)]
    writers: dict[str, str] = {}
    for name, plan in zip(users(session), planned, strict=True):
        for path in (plan.stamp or session.state.stamps[STAGE][plan.name]).outputs:
            if writers.setdefault(path, name) != name:
                raise KeymintError(
                    f"the build types {writers[path]} and {name} both have a shared document {path}",
                    where=session.profile_marker(),
                    help="use them in different workspaces",
                    code="file-conflict",
                )
    return [*planned, *obsolete(session, STAGE, shared_folder(session))]


def obsolete(session: Session, stage: str, folder: Path) -> Iterator[PackagePlan]:
    """Yield what removes the documents of build types that no package has any more.

    Args:
        session: the workspace and its profile.
        stage: the stage that recorded them.
        folder: the folder that the recorded paths are relative to.
    """
    for key, stamp in session.state.stamps.get(stage, {}).items():
        kind, _, build_type = key.partition("/")
        if kind == FOLDER and build_type not in users(session):
            changes = removals(session, folder, stamp.outputs)
            yield PackagePlan(key, Step(stage, "", Action.REMOVED, changes, f"shared documents of {build_type}"))


def removals(session: Session, folder: Path, paths: Iterable[str]) -> tuple[FolderChange, ...]:
    """Return the changes that remove files, given by path relative to a folder; missing ones are skipped."""
    existing = [path for path in sorted(paths) if session.tree.has_file(folder / path)]
    folders = by_folder(folder, dict.fromkeys(existing, File(b"")))
    return tuple(FolderChange(parent, removed=tuple(names)) for parent, names in folders.items())


def file_changes(folder: Path, files: Mapping[str, File]) -> tuple[FolderChange, ...]:
    """Return the changes that write files, given by path relative to a folder."""
    return tuple(FolderChange(parent, of_folder) for parent, of_folder in by_folder(folder, files).items())


def _plan_documents(session: Session, name: str, options: BuildOptions, *, force: bool) -> PackagePlan:
    key, folder = record_key(name), shared_folder(session)
    stamp = session.state.stamp(STAGE, key)
    inputs, context = sources_digest(session, name), digest(repr(options))
    is_same = stamp is not None and (stamp.inputs, stamp.context) == (inputs, context) and not force
    if stamp and is_same and (step := kept_documents_step(session, stamp, folder, "", ", ".join(stamp.outputs))):
        return PackagePlan(key, step)
    built = build_shared(session, name, load_packages(session, name), options)
    left_over = set(stamp.outputs if stamp else ()) - set(built.documents)
    existing = {path: session.tree.read(folder / path) for path in (*built.documents, *left_over)}
    different = {path: File(content) for path, content in built.documents.items() if existing[path] != content}
    if not force:
        refuse_edits(session, key, folder, {path: existing[path] for path in (*different, *left_over)})
    changes = (*removals(session, folder, left_over), *file_changes(folder, different))
    action = (Action.UPDATED if stamp else Action.CREATED) if changes else Action.UNCHANGED
    shown = ", ".join(f"{path} {len(content):,} bytes" for path, content in built.documents.items())
    outputs = {path: digest(content) for path, content in built.documents.items()}
    made = Stamp(inputs, outputs, context=context, build_types=(name,))
    return PackagePlan(key, Step(STAGE, "", action, changes, shown), made, tuple(built.diagnostics))
