# SPDX-License-Identifier: Apache-2.0
"""Load policies from files and directories, and policy tests: the requests that an author expects to be decided so."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from comarmor.errors import ComArmorError, Defects, Diagnostic, Origin, require_none
from comarmor.language.parse import parse
from comarmor.language.policy import Policy
from comarmor.language.policy_files import PolicyFiles, ShortDocument
from comarmor.language.source import TESTS, load_tree, read_document
from comarmor.patterns.expression import parse as parse_expression
from comarmor.rules import Expectation
from comarmor.xml import schema
from comarmor.xml.package_folders import PackageFolders
from comarmor.xml.reader import LIMITS, XINCLUDE, line, parse as parse_xml
from comarmor.xml.sandboxed_paths import file_errors

_MANY = 3
"""Profiles in a file, from which on it is shortened."""
_ATTRIBUTES = ("subject", "permission", "object", "partition", "kind")
"""Those of the elements in a policy test."""


def load(
    *paths: str | Path,
    library: str | Path | None = None,
    library_shown: Path | None = None,
    packages: PackageFolders | None = None,
) -> Policy:
    """Load a policy, or several as one: the union of their profiles, each confined to its own folder.

    Args:
        paths: files, and directories whose ``*.xml`` files are the policy's roots. Includes are confined to that
            directory, or to the file's folder.
        library: a folder that is searched for included files which the policy does not have; its files can only
            include files of the library.
        library_shown: path of the library in origins, if it differs from where the library is read.
        packages: where packages are that ship files; without it the policy may include none of theirs.

    Raises:
        ComArmorError: a policy has defects; carries those of all policies, with ``file:line``.
    """
    folder = None if library is None else Path(library)
    defects = Defects()
    policies: list[Policy] = []
    for path in paths:
        with defects:
            policies.append(_loaded(functools.partial(load_tree, Path(path), folder, library_shown, packages=packages)))
    defects.require_none()
    if len(policies) == 1:
        return policies[0]  # indexing its profiles again takes time
    seen = {path: fingerprint for policy in policies for path, fingerprint in policy.seen.items()}
    profiles = tuple(profile for policy in policies for profile in policy.profiles)
    unused = tuple(tunable for policy in policies for tunable in policy.unused_tunables)
    shipped = {(each.package, each.path): each for policy in reversed(policies) for each in reversed(policy.shipped)}
    return Policy(profiles, MappingProxyType(seen), unused, tuple(reversed(shipped.values())))


def _loaded(read: Callable[..., PolicyFiles]) -> Policy:
    """Load a policy; as a whole if its short form has defects, to find all of them."""
    short: list[ShortDocument] = []

    def shorten(content: bytes) -> ShortDocument:
        if content.count(b"</profile>") < _MANY:
            return ShortDocument(content)
        from comarmor.language.alike_profiles import short_form  # noqa: PLC0415 - small policies do without

        short.append(short_form(content))
        return short[-1]

    try:
        return parse(read(shorten=shorten))
    except ComArmorError:
        if not any(each.copies for each in short):
            raise
    return parse(read())


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
    from comarmor.language.layout import attribute_value  # noqa: PLC0415 - few policies need it

    document = (
        f'<profiles xmlns:xi="{XINCLUDE}"><profile name="p"><attachment>*</attachment>'
        f'<xi:include href="{attribute_value(href)}" parse="xml"/></profile></profiles>'
    )
    return parse(read_document(document.encode(), name, library, library_shown))


def expectations(path: Path) -> Mapping[Path, tuple[Expectation, ...]]:
    """Return the expectations in the test files of a policy, by file; empty if there are no test files.

    Args:
        path: a policy file, whose tests are in ``NAME.test.xml`` beside it; a folder with ``*.test.xml`` files; or a
            test file.

    Raises:
        ComArmorError: a file cannot be read or is not valid, with ``file:line`` of each defect.
    """
    by_file: dict[Path, tuple[Expectation, ...]] = {}
    defects = Defects()
    for file in _files(path):
        with defects:
            by_file[file] = tuple(_read(file))
    defects.require_none()
    return by_file


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(each for each in path.glob(f"*{TESTS}") if each.is_file() and not each.name.startswith("."))
    beside = path if path.name.endswith(TESTS) else path.with_name(path.name.removesuffix(".xml") + TESTS)
    return [beside] if beside.is_file() else []


def _read(file: Path) -> Iterator[Expectation]:
    name = str(file)
    with file_errors("the file", Origin(name)), file.open("rb") as stream:
        content = stream.read(LIMITS.file_bytes + 1)
    root = parse_xml(content, name)
    schema.validate(root, "comarmor", "tests", name)
    defects: list[Diagnostic] = []
    for test in root.iterchildren("test"):
        for element in test.iterchildren("allow", "deny"):
            where = Origin(name, line(element))
            subject, permission, object_, partition, kind = (element.get(attribute, "") for attribute in _ATTRIBUTES)
            for expression in (subject, object_, partition):
                try:
                    parse_expression(expression)
                except ComArmorError as error:
                    defects += error.at(where).diagnostics
            is_allowed = element.tag == "allow"
            yield Expectation(test.get("name", ""), is_allowed, subject, permission, object_, partition, where, kind)
    require_none(defects)
