# SPDX-License-Identifier: Apache-2.0
"""Read policy tests: the requests that the author of a policy expects it to allow and to deny."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from comarmor.data import locate
from comarmor.errors import ComArmorError, Defects, Diagnostic, Origin
from comarmor.language.source import TESTS
from comarmor.patterns.expression import parse as parse_expression
from comarmor.rules import Expectation
from comarmor.xml import schema
from comarmor.xml.reader import LIMITS, line, parse
from comarmor.xml.sandboxed_paths import read_failure


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
    try:
        with file.open("rb") as stream:
            content = stream.read(LIMITS.file_bytes + 1)
    except OSError as error:
        raise ComArmorError(read_failure(error, "the file"), where=Origin(name), code="unreadable") from None
    root = parse(content, name)
    schema.validate(root, locate("comarmor", "schemas") / "tests.xsd", name)
    defects: list[Diagnostic] = []
    for test in root.iterchildren("test"):
        for element in test.iterchildren("allow", "deny"):
            where = Origin(name, line(element))
            subject, object_ = element.get("subject", ""), element.get("object", "")
            partition = element.get("partition", "")
            for expression in (subject, object_, partition):
                try:
                    parse_expression(expression)
                except ComArmorError as error:
                    defects += (replace(each, where=where) for each in error.diagnostics)
            yield Expectation(
                test=test.get("name", ""),
                allowed=element.tag == "allow",
                subject=subject,
                permission=element.get("permission", ""),
                object=object_,
                partition=partition,
                where=where,
                kind=element.get("kind", ""),
            )
    if defects:
        raise ComArmorError.of(defects)
