# SPDX-License-Identifier: Apache-2.0
"""Unit tests of a policy, as files."""

from __future__ import annotations

from pathlib import Path

import pytest

import comarmor
from comarmor.errors import ComArmorError
from comarmor.language.loading import expectations

ONE = '<tests>\n<test name="t">\n<allow subject="/a" permission="publish" object="/x"/></test></tests>'
POLICY = '<profiles><profile name="a"><attachment>/a</attachment></profile></profiles>'


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    """A folder with a policy, its tests, and those of another one."""
    (tmp_path / "p.xml").write_text(POLICY)
    (tmp_path / "p.test.xml").write_text(ONE)
    (tmp_path / "q.test.xml").write_text(ONE.replace("allow", "deny"))
    return tmp_path


def test_what_is_read(policy: Path) -> None:
    (found,) = expectations(policy / "p.xml")[policy / "p.test.xml"]
    assert (found.test, found.allowed, found.subject, found.permission, found.object) == (
        "t",
        True,
        "/a",
        "publish",
        "/x",
    )
    assert found.where.line == 3
    assert list(expectations(policy)) == [policy / "p.test.xml", policy / "q.test.xml"]
    assert list(expectations(policy / "q.test.xml")) == [policy / "q.test.xml"]
    assert expectations(policy / "r.xml") == {}


def test_they_are_no_roots_of_the_policy(policy: Path) -> None:
    found = comarmor.load(policy)
    assert found.subjects() == ("/a",)
    assert [path.name for path in found.seen if path.is_file()] == ["p.xml"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ONE.replace("allow", "alow"), "did you mean"),
        (ONE.replace('object="/x"', ""), "lacks its attribute 'object'"),
        (ONE.replace("/x", "/[[:oops:]]"), "p.test.xml:3"),
        ("<tests>", "p.test.xml:1"),
        ("<tests/>", "expected <test>"),
    ],
)
def test_defects(policy: Path, text: str, said: str) -> None:
    (policy / "p.test.xml").write_text(text)
    with pytest.raises(ComArmorError) as caught:
        expectations(policy)
    assert said in str(caught.value)


def test_unused_tunables(tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(
        '<profiles><tunable name="A"><value>/a</value></tunable><tunable name="B"><value>/b</value></tunable>'
        '<profile name="p"><attachment>@{B}</attachment></profile></profiles>'
    )
    assert [tunable.name for tunable in comarmor.load(tmp_path / "p.xml").unused_tunables] == ["A"]


def test_every_defect_is_said(policy: Path) -> None:
    (policy / "p.test.xml").write_text(ONE.replace("/a", "/a\\").replace("/x", "/[[:oops:]]"))
    with pytest.raises(ComArmorError) as caught:
        expectations(policy)
    assert [str(each.where) for each in caught.value.diagnostics] == [f"{policy}/p.test.xml:3"] * 2
