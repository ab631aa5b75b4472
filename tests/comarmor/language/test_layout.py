# SPDX-License-Identifier: Apache-2.0
"""Lay out files of the language; the laws are tested with :mod:`comarmor.language.formatting`."""

from __future__ import annotations

import pytest

from comarmor.language.layout import laid_out, markup, nodes


def laid(text: str) -> str:
    return laid_out(nodes(text.encode()))


def test_elements_in_a_row_stay_on_one_line_with_their_content() -> None:
    row = "<permissions> <value> 1 </value>\n<permissions><x/></permissions> </permissions>"
    assert laid(row) == "<permissions><value>1</value><permissions><x/></permissions></permissions>\n"
    assert laid("<permissions><x/><?p?></permissions>") == "<permissions>\n  <x/> <?p?>\n</permissions>\n"


def test_attributes_follow_the_order_and_then_the_alphabet() -> None:
    text = "<a z='1' c='2' qualifier='' name='' xmlns:n='u'/>"
    assert laid(text) == '<a xmlns:n="u" name="" qualifier="" c="2" z="1"/>\n'


@pytest.mark.parametrize(("length", "lines"), [(95, 1), (96, 2)])
def test_a_start_tag_of_the_full_width_is_one_line(length: int, lines: int) -> None:
    text = laid(f"<a><bcd name='1' href='{'x' * length}'/></a>")
    assert text.count("\n") == lines + 2
    assert max(map(len, text.splitlines())) <= 120


def test_an_instruction_is_never_changed() -> None:
    assert laid("<a>\n      <?p one\n  two ?></a>") == "<a>\n  <?p one\n  two ?>\n</a>\n"


def test_markup_is_listed_in_the_order_of_the_document() -> None:
    document = nodes(b"<!--1--><a><value>x<!--2--></value><?p 3?></a><!--4-->")
    assert [each.source for each in markup(document)] == ["<!--1-->", "<!--2-->", "<?p 3?>", "<!--4-->"]
