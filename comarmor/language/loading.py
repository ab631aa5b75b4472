# SPDX-License-Identifier: Apache-2.0
"""Load policies from files and directories."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import MappingProxyType

from comarmor.errors import Defects
from comarmor.language.parse import parse
from comarmor.language.policy import Policy
from comarmor.language.source import load_tree, read_document
from comarmor.xml.package_folders import PackageFolders
from comarmor.xml.reader import XINCLUDE


def load(
    path: str | Path,
    *,
    library: str | Path | None = None,
    library_shown: Path | None = None,
    packages: PackageFolders | None = None,
) -> Policy:
    """Load a policy.

    Args:
        path: a file, or a directory whose ``*.xml`` files are the policy's roots. Includes are confined to that
            directory, or to the file's folder.
        library: a folder that is searched for included files which the policy does not have; its files can only
            include files of the library.
        library_shown: path of the library in origins, if it differs from where the library is read.
        packages: where packages are that ship files; without it the policy may include none of theirs.

    Raises:
        ComArmorError: the policy has defects; carries all of them, with ``file:line``.
    """
    return load_all([path], library=library, library_shown=library_shown, packages=packages)


def load_all(
    paths: Iterable[str | Path],
    *,
    library: str | Path | None = None,
    library_shown: Path | None = None,
    packages: PackageFolders | None = None,
) -> Policy:
    """Load several policies as one: the union of their profiles, each confined to its own folder.

    Args:
        paths: as for :func:`load`.
        library: as for :func:`load`.
        library_shown: as for :func:`load`.
        packages: as for :func:`load`.

    Raises:
        ComArmorError: a policy has defects; carries those of all policies.
    """
    folder = None if library is None else Path(library)
    defects = Defects()
    policies: list[Policy] = []
    for path in paths:
        with defects:
            policies.append(parse(load_tree(Path(path), folder, library_shown, packages=packages)))
    defects.require_none()
    if len(policies) == 1:
        return policies[0]  # indexing its profiles again takes time
    files = {file: digest for policy in policies for file, digest in policy.files.items()}
    seen = {path: fingerprint for policy in policies for path, fingerprint in policy.seen.items()}
    profiles = tuple(profile for policy in policies for profile in policy.profiles)
    unused = tuple(tunable for policy in policies for tunable in policy.unused_tunables)
    shipped = {(each.package, each.path): each for policy in reversed(policies) for each in reversed(policy.shipped)}
    return Policy(profiles, MappingProxyType(files), MappingProxyType(seen), unused, tuple(reversed(shipped.values())))


def load_included(href: str, name: str, library: Path, library_shown: Path | None = None) -> Policy:
    """Return the policy whose only profile is about every subject, and includes a file of the library.

    Args:
        href: the file, as an include names it.
        name: path of the document that includes it, for messages.
        library: as for :func:`load`.
        library_shown: as for :func:`load`.

    Raises:
        ComArmorError: the include or the file has defects.
    """
    from comarmor.xml.layout import attribute_value  # noqa: PLC0415 - few policies need it

    document = (
        f'<profiles xmlns:xi="{XINCLUDE}"><profile name="p"><attachment>*</attachment>'
        f'<xi:include href="{attribute_value(href)}" parse="xml"/></profile></profiles>'
    )
    return parse(read_document(document.encode(), name, library, library_shown))
