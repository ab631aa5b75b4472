# SPDX-License-Identifier: Apache-2.0
"""The ``href`` of an include is the relative path of a file, or a file of a package: for every format with includes."""

from __future__ import annotations

import posixpath
from string import ascii_letters, digits

import pytest
from hypothesis import given
from hypothesis.strategies import text

from comarmor.errors import ComArmorError, Origin
from comarmor.xml.sandboxed_paths import package_path, path_of

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
        path_of(href, WHERE)
    (found,) = caught.value.diagnostics
    assert (found.code, found.where) == (code, WHERE)
    assert found.help == (
        "copy the file into the policy's folder, and include the copy" if code == "include-outside" else ""
    )


@pytest.mark.parametrize(
    ("href", "expected"),
    [
        ("package://nav2_bringup/controller.xml", ("nav2_bringup", "controller.xml")),
        ("package://a/b/./c/../d.xml", ("a", "b/d.xml")),
        ("package://A-b_2/a%2Db%5F1.xml", ("A-b_2", "a-b_1.xml")),
        ("package://2d_map/a.xml", ("2d_map", "a.xml")),
        ("common/node.xml", None),
        ("../package://a/b.xml", None),
    ],
)
def test_a_file_of_a_package(href: str, expected: tuple[str, str] | None) -> None:
    assert package_path(href, WHERE) == expected


@pytest.mark.parametrize(
    ("href", "code"),
    [
        ("package://", "include-href"),
        ("package:///a.xml", "include-href"),
        ("package://a", "include-href"),
        ("package://a/", "include-href"),
        ("package://../a.xml", "include-href"),
        ("package://./a.xml", "include-href"),
        ("package://%61/a.xml", "include-href"),
        ("package://a%2F..%2Fb/a.xml", "include-href"),
        ("package://user@a/a.xml", "include-href"),
        ("package://a:80/a.xml", "include-href"),
        ("package://-a/a.xml", "include-href"),
        ("package://_a/a.xml", "include-href"),
        ("package://a b/a.xml", "include-href"),
        ("package://ä/a.xml", "include-href"),
        ("package://a\nb/a.xml", "include-href"),
        (f"package://{'a' * 256}/a.xml", "include-href"),
        ("package://a/../b.xml", "include-outside"),
        ("package://a/%2e%2e/b.xml", "include-outside"),
        ("package://a/b/../../c.xml", "include-outside"),
        ("package://a//etc/x.xml", "include-outside"),
        ("package://a/%2Fetc/x.xml", "include-outside"),
        ("package://a/.", "include-href"),
        ("package://a/b/", "include-href"),
        ("package://a/.hidden.xml", "include-href"),
        ("package://a/b.txt", "include-href"),
        ("package://a/a%00.xml", "include-href"),
        ("package://a/a%0Ab.xml", "include-href"),
        ("package://a/a\\b.xml", "include-href"),
        ("package://a/b.xml?c", "include-href"),
        ("package://a/b.xml#c", "include-href"),
    ],
)
def test_what_is_no_file_of_a_package(href: str, code: str) -> None:
    with pytest.raises(ComArmorError) as caught:
        package_path(href, WHERE)
    (found,) = caught.value.diagnostics
    assert (found.code, found.where) == (code, WHERE)


@pytest.mark.parametrize("href", ["PACKAGE://a/b.xml", "package:a/b.xml", "package:/a/b.xml"])
def test_what_resembles_it_is_no_path_either(href: str) -> None:
    assert package_path(href, WHERE) is None
    with pytest.raises(ComArmorError, match="is not a relative path"):
        path_of(href, WHERE)


@given(text(max_size=40) | text("ab./%2eE-_:@\\", max_size=20))
def test_any_text_is_a_plain_path_below_a_package_or_an_error(rest: str) -> None:
    try:
        found = package_path(f"package://{rest}.xml", WHERE)
    except ComArmorError:
        return
    assert found is not None
    package, path = found
    assert posixpath.normpath(f"/{package}/{path}") == f"/{package}/{path}"
    assert set(f"{package}/{path}") <= set(f"{ascii_letters}{digits}-_.+/")
    assert not any(part.startswith(".") for part in (package, *path.split("/")))
