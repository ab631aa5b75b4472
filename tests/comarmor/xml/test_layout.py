# SPDX-License-Identifier: Apache-2.0
"""Lay out documents of any format; the laws are tested with the language that uses it."""

from __future__ import annotations

import pytest

from comarmor.xml.layout import DocumentLayout, laid_out, markup, nodes

LAYOUT = DocumentLayout(frozenset(("t",)), frozenset(("row",)), ("id", "b"), str.strip, width=40)


def laid(text: str) -> str:
    return laid_out(nodes(text.encode(), LAYOUT), LAYOUT)


def test_elements_in_a_row_stay_on_one_line_with_their_content() -> None:
    assert laid("<row> <t> 1 </t>\n<row><x/></row> </row>") == "<row><t>1</t><row><x/></row></row>\n"
    assert laid("<row><x/><?p?></row>") == "<row>\n  <x/> <?p?>\n</row>\n"


def test_attributes_follow_the_order_and_then_the_alphabet() -> None:
    assert laid("<a z='1' c='2' b='' id='' xmlns:n='u'/>") == '<a xmlns:n="u" id="" b="" c="2" z="1"/>\n'


@pytest.mark.parametrize(("length", "lines"), [(20, 1), (21, 2)])
def test_a_start_tag_of_the_full_width_is_one_line(length: int, lines: int) -> None:
    text = laid(f"<a><bcd id='1' b='{'x' * length}'/></a>")
    assert text.count("\n") == lines + 2
    assert max(map(len, text.splitlines())) <= 40


def test_an_instruction_is_never_changed() -> None:
    assert laid("<a>\n      <?p one\n  two ?></a>") == "<a>\n  <?p one\n  two ?>\n</a>\n"


def test_markup_is_listed_in_the_order_of_the_document() -> None:
    document = nodes(b"<!--1--><a><t>x<!--2--></t><?p 3?></a><!--4-->", LAYOUT)
    assert [each.source for each in markup(document)] == ["<!--1-->", "<!--2-->", "<?p 3?>", "<!--4-->"]
