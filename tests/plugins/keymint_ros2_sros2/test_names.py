# SPDX-License-Identifier: Apache-2.0
"""Names as SROS2's stylesheet resolves them (measured on sros2 0.13), and as they read."""

from __future__ import annotations

import pytest
from keymint_ros2_sros2.syntax import Entry, RosNode, as_read, enforced_name, expression

from comarmor.errors import ComArmorError, Origin
from comarmor.patterns.expression import matches

HERE = Origin("policy.xml", 3)


def node(ns: str = "/ns", name: str = "n") -> RosNode:
    return RosNode(ns, name, (), HERE)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("/abs", "/abs"),
        ("rel", "/ns/rel"),
        ("foo/bar", "/ns/foo/bar"),
        ("~/p", "/ns/n/p"),
        ("~", "/ns/n"),
        ("*/x", "/ns/*/x"),
        ("/t/", "/t/"),
    ],
)
def test_both_readings_agree(text: str, name: str) -> None:
    assert enforced_name(node(), text) == as_read(node(), text) == name


@pytest.mark.parametrize(
    ("text", "done", "read"), [("~p", "/ns/np", "/ns/n/p"), (" padded ", "/ns/ padded ", "/ns/padded")]
)
def test_the_readings_differ(text: str, done: str, read: str) -> None:
    assert (enforced_name(node(), text), as_read(node(), text)) == (done, read)


@pytest.mark.parametrize(("ns", "name"), [("/", "/x"), ("", "/x"), ("/t/", "/t/x"), ("/t", "/t/x"), ("/*", "/*/x")])
def test_namespaces(ns: str, name: str) -> None:
    assert enforced_name(node(ns), "x") == as_read(node(ns), "x") == name


def test_a_namespace_without_slash() -> None:
    assert (enforced_name(node("ns"), "x"), as_read(node("ns"), "x")) == ("ns/x", "/ns/x")


@pytest.mark.parametrize("name", ["/plain", "/a b", "/{x}", "/@{x}", "/a[b", "/tab\there"])
def test_an_expression_matches_the_name(name: str) -> None:
    written = expression(name, Entry(name, HERE))
    assert matches(written, name)
    assert not matches(written, name + "x")


def test_wildcards_stay() -> None:
    assert expression("/a*/[b-d]?", Entry("", HERE)) == "/a*/[b-d]?"


@pytest.mark.parametrize("name", ["/" + "a" * 5000, "/a\\", "/[z-a]", "/[[:nope:]]", "/[[.x.]]"])
def test_undefined_notation_is_refused_with_its_line(name: str) -> None:
    with pytest.raises(ComArmorError) as caught:
        expression(name, Entry(name, HERE))
    (found,) = caught.value.diagnostics
    assert (found.code, found.where) == ("expression", HERE)
