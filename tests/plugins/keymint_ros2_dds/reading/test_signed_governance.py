# SPDX-License-Identifier: Apache-2.0
"""A governance document as data types that know their lines."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from keymint_ros2_dds.reading import dialects, signed_permissions
from keymint_ros2_dds.reading.signed_governance import GovernanceDocument, read

from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.decision.test_evaluator_governance import CLOSED, ruling, topic

USUAL = ruling(CLOSED)


def governance(*rules: str) -> GovernanceDocument:
    """Read a document with the domain rules of several documents."""
    head, tail = "<dds><domain_access_rules>", "</domain_access_rules></dds>"
    inner = "\n".join(each.removeprefix(head).removesuffix(tail) for each in rules)
    return read(f"{head}\n{inner}{tail}".encode())


def test_the_content() -> None:
    (only,) = governance(ruling(topic("rt/x", read=False), CLOSED)).domain_rules
    assert (only.join_controlled, only.unauthenticated) == (True, False)
    assert only.protections == ("ENCRYPT",) * 3
    first, last = only.topic_rules
    assert (first.expression, first.controls("publish"), first.controls("subscribe")) == ("rt/x", True, False)
    assert (last.expression, last.controls("publish"), last.controls("subscribe")) == ("*", True, True)
    assert last.protections == ("true", "true", "ENCRYPT", "ENCRYPT")


def test_the_first_rule_that_contains_a_domain_applies() -> None:
    found = governance(
        ruling(CLOSED, domains="<id>3</id><id_range><min>5</min><max>7</max></id_range>"),
        ruling(CLOSED, domains="<id_range><min>6</min></id_range>"),
    )
    first, second = found.domain_rules
    assert [found.rule(domain) for domain in (2, 3, 5, 7, 8)] == [None, first, first, first, second]
    assert [found.rule(domain, min_only_is_exact=True) for domain in (6, 8)] == [first, None]


@pytest.mark.parametrize(
    ("text", "joins"),
    [
        (USUAL, False),
        (ruling(CLOSED, join="false"), True),
        (ruling(topic("rt/x", read=False), CLOSED), True),
        (ruling(topic("rt/x", write=False), CLOSED), True),
    ],
)
def test_who_joins_without_a_rule(text: str, joins: bool) -> None:
    (only,) = governance(text).domain_rules
    assert only.joins_without_rule is joins


def test_lines_of_elements() -> None:
    text = USUAL.replace("<enable_join", "\n<enable_join").replace("<topic_rule>", "\n\n<topic_rule>")
    found = read(text.encode(), "g.p7s", 20)
    (only,) = found.domain_rules
    assert (only.line, only.line_of("enable_join_access_control"), only.line_of("no_such_element")) == (1, 2, 1)
    assert only.topic_rules[0].line == 4
    assert str(found.place(only.topic_rules[0].line)) == "g.p7s:24"


@pytest.mark.parametrize(
    ("content", "line", "message"),
    [
        (b"<dds>\n</other>", 22, "expected the end of <dds>"),
        (b"\n<dds/>", 22, "not a governance document"),
        (b"<x/>", 21, "not a governance"),
    ],
)
def test_other_documents_are_refused_with_their_line(content: bytes, line: int, message: str) -> None:
    with pytest.raises(KeymintError, match=message) as caught:
        read(content, "g.p7s", 20)
    assert str(caught.value.diagnostics[0].where) == f"g.p7s:{line}"


def test_the_same_content_in_another_file_has_its_own_places() -> None:
    one, other = read(USUAL.encode(), "a.p7s", 1), read(USUAL.encode(), "b.p7s", 2)
    assert [str(each.place(1)) for each in (one, other)] == ["a.p7s:2", "b.p7s:3"]


def test_what_the_schema_does_not_allow_is_a_defect_with_its_line() -> None:
    found = read(USUAL.replace("<topic_expression>", "\n<surprise/><topic_expression>").encode(), "g.p7s", 20)
    assert found.defect.startswith("g.p7s:22: the schema refuses it: ")
    assert read(USUAL.encode()).defect == ""


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("<id>0<", "<id>00<", "the domain id '00'"),
        ("<id>0<", "<id>231<", "a domain id above 230"),
        ("<id>0</id>", "<id_range><max>3</max></id_range>", "a range of domains without a minimum"),
        ("<id>0</id>", "<id_range><min>3</min><max>2</max></id_range>", "a range of domains without a minimum"),
        (">*<", "> *<", "white space around the text of <topic_expression>"),
        (">*<", ">a\n*<", "a line end within the text of <topic_expression>"),
        ("</domain_access_rules>", "</domain_access_rules><!-- c -->", "a comment"),
    ],
)
def test_quirks(old: str, new: str, text: str) -> None:
    found = read(("<!-- c -->\n" + USUAL.replace(old, new)).encode())
    assert [(quirk.line, quirk.text.startswith(text)) for quirk in found.quirks] == [(2, True)]
    assert read(("<!-- c -->\n" + USUAL).encode()).quirks == ()


@pytest.mark.parametrize("reader", [read, signed_permissions.read])
def test_a_document_has_fewer_elements_than_a_policy(reader: Callable[[bytes], object]) -> None:
    with pytest.raises(KeymintError) as refused:
        reader(b"<dds>" + b"<a/>" * dialects.DOCUMENT_LIMITS.nodes + b"</dds>")
    assert refused.value.diagnostics[0].code == "xml-limit"
