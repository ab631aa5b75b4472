# SPDX-License-Identifier: Apache-2.0
"""The build types of a package, and what they say about its enclave."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, MutableMapping

from comarmor.errors import Diagnostic
from keymint.api import Artifact, AuthorityRole, BuildType, Package
from keymint.errors import KeymintError
from keymint.view.stamps import digest
from keymint.workspace.session import Session, once, once_of_sources

BUILD = "build"
"""Key of the record of built packages."""


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
            raise KeymintError(
                f"the build type {name} does not support the layout {layout!r} as this workspace has it",
                where=marker,
                help=f"it supports {', '.join(build_type.LAYOUTS)}",
                code="layout-unsupported",
            )
    return found


def recorded_build_types(session: Session, name: str) -> tuple[str, ...]:
    """Return the build types of an enclave; those of the profile if its sources are gone or have defects."""
    stamp = session.state.stamp(BUILD, name)
    if stamp is not None and stamp.build_types:
        return stamp.build_types
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


def suffixes_read(session: Session, package: Package) -> tuple[str, ...]:
    """Return the suffixes of the files that the transports read from the enclave of a package."""
    suffixes = (suffix for each in build_types_of(session, package).values() for suffix in each.READS)
    return tuple(dict.fromkeys(suffixes))


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


def inputs_digest(session: Session, name: str, build_types: Iterable[str] | None = None) -> str:
    """Return the digest of everything that a package's documents are built from, except the options.

    Args:
        session: the workspace and its profile.
        name: the package.
        build_types: its build types; by default those that it had when it was built.
    """
    if build_types is None:
        stamp = session.state.stamp(BUILD, name)
        build_types = stamp.build_types if stamp is not None else ()
    shared = any(shared_builder(session, each) for each in build_types)
    places = (str(session.workspace.install),) if shared else ()
    return _inputs_digest(session, session.sources_digest(name), *places)


@once_of_sources
def _inputs_digest(session: Session, sources: str, *places: str) -> str:
    return digest(session.profile_digest, sources, session.plugins.versions, *places)


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
    sharing = {name for name in session.plugins.names("keymint.build_types") if shared_builder(session, name)}
    if not sharing.isdisjoint(session.profile.build_types) or session.infrastructure():
        return True
    texts = [name.encode() for name in sharing]
    marker = session.package_type.MARKER
    manifests = {session.tree.try_read(session.workspace.src / name / marker) or b"" for name in names}
    return any(text in manifest for manifest in manifests for text in texts)
