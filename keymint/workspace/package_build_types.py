# SPDX-License-Identifier: Apache-2.0
"""The build types of a package, and what they say about its enclave; and the documents over all packages of one.

These documents are one more package, whose name is :func:`record_key`: its inputs are all packages of the build type.
They hold the rights of everybody, so each run brings them up to date, whichever packages it is about.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, MutableMapping, Sequence

from keymint.api import Artifact, AuthorityRole, BuildType, Package
from keymint.errors import Defects, Diagnostic, KeymintError
from keymint.names import subject_of
from keymint.view.stamps import digest, digest_of_texts
from keymint.workspace.session import Session, once

BUILD = "build"
"""Key of the record of built packages."""
SHARED = "shared.d"
"""Folder of the build space with the documents over all packages; a dot is illegal in names of packages."""


def build_types_of(session: Session, package: Package) -> Mapping[str, BuildType]:
    """Return the build types of a package by name, in the order of its manifest.

    Raises:
        KeymintError: one is not installed, fails to load, or does not support the layout of the workspace.
    """
    return session.made(("build types", package.build_types), lambda: _build_types(session, package))


def _build_types(session: Session, package: Package) -> Mapping[str, BuildType]:
    marker, layout = session.package_marker(package.name), session.profile.layout
    found = {name: session.plugins.build_type(name, marker) for name in package.build_types}
    for name, build_type in found.items():
        own = build_type.LAYOUTS.get(layout)
        if own is None or session.workspace.install / own.enclaves != session.enclaves:
            message = f"the build type {name} does not support the layout {layout!r} as this workspace has it"
            help_ = f"it supports {', '.join(build_type.LAYOUTS)}"
            raise KeymintError(message, where=marker, help=help_, code="layout-unsupported")
    return found


def recorded_build_types(session: Session, name: str) -> tuple[str, ...]:
    """Return the build types of an enclave; those of the profile if its sources are gone or have defects."""
    if recorded := session.state.build_types(BUILD, name):
        return recorded
    try:
        return session.package(name).build_types
    except KeymintError:
        return session.profile.build_types


def revocation_files(
    build_types: Iterable[BuildType], distro: str, layout: str, revocations: bytes
) -> Iterator[tuple[str, Artifact]]:
    """Yield the files with which an enclave has a revocation list, with their names.

    Args:
        build_types: the build types of the enclave.
        distro: the ROS 2 distribution.
        layout: name of the layout.
        revocations: the list, PEM.
    """
    for each in build_types:
        yield from (each.revocation_files(distro, layout, revocations) or {}).items()


def roles_of(session: Session, package: Package) -> Mapping[str, tuple[AuthorityRole, ...]]:
    """Return the authorities that the enclave of a package rests on, by build type.

    Raises:
        KeymintError: a build type is not installed, or refuses the package's authorities.
    """
    return {name: tuple(each.authorities(package)) for name, each in build_types_of(session, package).items()}


def issuers_of(session: Session, package: Package) -> tuple[str, ...]:
    """Return the names of the authorities that the enclave of a package rests on, each once; errors as above."""
    roles = (role for of_type in roles_of(session, package).values() for role in of_type)
    return tuple(dict.fromkeys((package.identity.issuer, *(role.name for role in roles))))


def two_writers(
    session: Session,
    package: Package,
    writers: MutableMapping[str, str],
    build_type: str,
    files: Iterable[str],
    different: Collection[str] | None = None,
) -> list[Diagnostic]:
    """Return an error for each file that another build type of a package writes as well.

    Args:
        session: the workspace and its profile.
        package: the package.
        writers: build type by file; the files are added.
        build_type: name of a build type.
        files: names of its files.
        different: those that may not be written twice, because their content differs; by default all.
    """
    errors: list[Diagnostic] = []
    for file in files:
        other = writers.setdefault(file, build_type)
        if other != build_type and (different is None or file in different):
            message = f"the build types {other} and {build_type} both write {file}, each its own"
            where, help_ = session.package_marker(package.name), "keep one of them"
            errors.append(Diagnostic.error("file-conflict", message, where, help_, package.subject))
    return errors


def inputs_digest(
    session: Session, name: str, build_types: Iterable[str] | None = None, files: Mapping[str, str] | None = None
) -> str:
    """Return the digest of everything that a package's documents are built from, except the options.

    Args:
        session: the workspace and its profile.
        name: the package, or the key of the record of the documents over all packages of a build type.
        build_types: its build types; by default those that it had when it was built.
        files: the digests of its files, if it is not there yet.
    """
    if shared := shared_type(name):
        members = users(session)[shared]
        parts = (part for each in members for part in (each, inputs_digest(session, each)))
        return digest(session.profile.layout, *parts)
    if build_types is None:
        build_types = session.state.build_types(BUILD, name)
    shares = any(shared_builder(session, each) for each in build_types)
    places = (str(session.workspace.install),) if shares else ()
    return digest_of_texts(session.profile_digest, session.sources_digest(name, files), *places)


@once
def is_build_current(session: Session, name: str) -> bool:
    """Tell whether the documents of a package were built from its present sources, with any options."""
    stamp = session.state.stamp(BUILD, name)
    return stamp is not None and stamp.inputs == inputs_digest(session, name)


@once
def shared_builder(session: Session, name: str) -> BuildType | None:
    """Return a build type that has shared documents; None if it has none, or is not installed.

    The documents of such a build type name each other by absolute paths, so they depend on the install space.
    """
    if name not in session.plugins.names("keymint.build_types"):
        return None
    build_type = session.plugins.build_type(name)
    return build_type if build_type.SHARES else None


def may_share(session: Session, names: Iterable[str]) -> bool:
    """Tell whether packages may have documents that depend on other packages: cautious, and reads manifests only."""
    if session.infrastructure():
        return True
    marker = session.package_type.MARKER
    there = frozenset(session.packages()).intersection(names)
    manifests = {session.tree.try_read(session.workspace.src / name / marker) or b"" for name in there}
    named = {*session.profile.build_types}
    for each in session.plugins.names("keymint.build_types"):
        named |= {each} if any(each.encode() in manifest for manifest in manifests) else set()
    return any(shared_builder(session, each) for each in named)


# -- documents over all packages of a build type ---------------------------------------------------------------------


def record_key(build_type: str) -> str:
    """Return the key of the record of a build type's shared documents; it is no name of a package."""
    return f"{SHARED}/{build_type}"


def shared_type(name: str) -> str:
    """Return the build type whose shared documents have a key of the record; empty for the name of a package."""
    return name.removeprefix(f"{SHARED}/") if name.startswith(f"{SHARED}/") else ""


@once
def users(session: Session) -> Mapping[str, tuple[str, ...]]:
    """Return the packages of each build type that has shared documents, sorted; only build types that have packages.

    Packages that did not change since they were built are not loaded.

    Raises:
        KeymintError: which build types a package has is unknown, because its sources have defects.
    """
    names, before = session.packages(), session.state
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        if recorded := before.build_types(BUILD, name):
            found[name] = recorded
            continue
        with contextlib.suppress(KeymintError):  # raised below, if there are shared documents
            found[name] = tuple(build_types_of(session, session.package(name)))
    if not (shared := _sharing(session, found)):
        return {}
    defects = Defects()
    for name in names:
        if name not in found or (before.stamp(BUILD, name) and not is_build_current(session, name)):
            with defects, _blocking(session, shared, name):
                found[name] = tuple(build_types_of(session, session.package(name)))
    defects.require_none()
    return {
        build_type: tuple(name for name in names if build_type in found[name])
        for build_type in _sharing(session, found)
    }


def _sharing(session: Session, build_types: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the build types of some packages that have shared documents, sorted."""
    known = {build_type for of_package in build_types.values() for build_type in of_package}
    return sorted(build_type for build_type in known if shared_builder(session, build_type))


def load_packages(session: Session, build_type: str) -> tuple[Package, ...]:
    """Return the packages of a build type that has shared documents.

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
