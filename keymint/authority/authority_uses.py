# SPDX-License-Identifier: Apache-2.0
"""Whom an authority serves, and what the implementations of the transports accept while it changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from comarmor.text import did_you_mean
from comarmor.values import dataclass
from keymint.api import Implementation
from keymint.authority.authority_files import with_issuers
from keymint.errors import ExitCode, KeymintError
from keymint.workspace.package_build_types import build_types_of, is_build_current
from keymint.workspace.session import Session, once_of_sources


@dataclass(frozen=True, slots=True, order=True)
class Use:
    """What an authority does for some packages.

    Attributes:
        build_type: the build type whose enclaves rest on it.
        role: what it does, as the build type calls it.
        signs: its private key signs documents of these packages.
        packages: number of these packages.
    """

    build_type: str
    role: str
    signs: bool
    packages: int


@once_of_sources
def uses(session: Session) -> dict[str, tuple[Use, ...]]:
    """Return what each authority does; an authority above others is used as they are.

    Raises:
        KeymintError: a package has defects.
    """
    issuers = {each.name: each.certificate.issuer for each in session.profile.authorities}
    counts: Counter[tuple[str, str, str, bool]] = Counter()
    for package in (session.package(name, built=is_build_current(session, name)) for name in session.packages()):
        for build_type, plugin in build_types_of(session, package).items():
            found: set[tuple[str, str, str, bool]] = set()
            for role in plugin.authorities(package):
                for name in with_issuers(role.name, issuers):
                    found.add((name, build_type, role.role, role.signs and name == role.name))
            counts.update(found)
    every = [(name, Use(build_type, role, signs, number)) for (name, build_type, role, signs), number in counts.items()]
    return {authority: tuple(sorted(use for name, use in every if name == authority)) for authority in issuers}


def implementations(session: Session, chosen: Collection[str] = ()) -> dict[str, Sequence[Implementation]]:
    """Return the implementations that a fleet may have, by build type; none for a transport that was not measured.

    Args:
        session: the workspace and its profile.
        chosen: names of the implementations that the fleet has; of a transport without a chosen one, all.

    Raises:
        KeymintError: no transport has an implementation of this name; exit code 2.
    """
    build_types = sorted({use.build_type for of_authority in uses(session).values() for use in of_authority})
    build_types = build_types or sorted(session.profile.build_types)
    known: dict[str, Sequence[Implementation]] = {}
    for name in build_types:
        known[name] = session.plugins.build_type(name, session.profile_marker()).implementations()
    names = {each.name for of_type in known.values() for each in of_type}
    for name in chosen:
        if name not in names:
            raise KeymintError(
                f"no transport of this workspace has an implementation {name!r}",
                help=did_you_mean(name, names, f"known are {', '.join(sorted(names)) or 'none'}"),
                code="implementation-unknown",
                exit_code=ExitCode.USAGE,
            )
    return {name: tuple(each for each in of_type if each.name in chosen) or of_type for name, of_type in known.items()}


def refusing_implementations(session: Session, name: str, chosen: Collection[str], what: str) -> tuple[str, ...]:
    """Return the implementations that do not accept a change of an authority in a role that it has.

    Args:
        session: the workspace and its profile.
        name: the authority.
        chosen: names of the implementations that the fleet has; see :func:`implementations`.
        what: ``bundles`` or ``reissues``; see :class:`keymint.api.Implementation`.

    Returns:
        Their titles, or the name of a build type that was not measured; empty if all accept it.
    """
    known = implementations(session, chosen)
    titles: dict[str, None] = {}
    for use in uses(session)[name]:
        for each in known[use.build_type]:
            if use.role not in (each.bundles if what == "bundles" else each.reissues):
                titles[each.title] = None
        if not known[use.build_type]:
            titles[use.build_type] = None
    return tuple(titles)
