# SPDX-License-Identifier: Apache-2.0
"""The ``href`` of an include is the relative path of a file: for every format that has includes."""

from __future__ import annotations

import pytest

from comarmor.errors import ComArmorError, Origin
from comarmor.xml.includes import path_of

WHERE = Origin("policy.xml", 3)


@pytest.mark.parametrize(
    ("href", "path"),
    [("common/node.xml", "common/node.xml"), ("a%20b.xml", "a b.xml"), ("../a.xml", "../a.xml"), ("é.xml", "é.xml")],
)
def test_a_path(href: str, path: str) -> None:
    assert path_of(href, WHERE) == path


@pytest.mark.parametrize(
    ("href", "code"),
    [
        ("", "include-href"),
        ("http://example.org/a.xml", "include-href"),
        ("//example.org/a.xml", "include-href"),
        ("file:a.xml", "include-href"),
        ("a.xml?b", "include-href"),
        ("a.xml#b", "include-href"),
        ("a%00.xml", "include-href"),
        ("http://[a.xml", "include-href"),
        ("/etc/passwd", "include-outside"),
        ("%2Fetc/passwd", "include-outside"),
    ],
)
def test_what_is_no_relative_path(href: str, code: str) -> None:
    with pytest.raises(ComArmorError) as caught:
        path_of(href, WHERE, help_="copy it")
    (found,) = caught.value.diagnostics
    assert (found.code, found.where) == (code, WHERE)
    assert found.help == ("copy it" if code == "include-outside" else "")
