# SPDX-License-Identifier: Apache-2.0
"""Comments belong to the element that follows them, or to the end of their parent."""

from __future__ import annotations

from keymint_ros2_sros2.parse import comments_of

from comarmor.xml.reader import parse

DOCUMENT = b"""<!--head--><a><!--1--><!--2--><b/>
  <c><d/><!--end of c--></c><!--end of a--></a><!--after-->"""


def test_each_comment_has_its_element() -> None:
    root = parse(DOCUMENT, "a.xml")
    comments = comments_of(DOCUMENT, root)
    before = {element.tag: comments.before.get(element, ()) for element in root.iter()}
    assert before == {"a": ("head",), "b": ("1", "2"), "c": (), "d": ()}
    closing = {element.tag: comments.closing.get(element, ()) for element in root.iter()}
    assert closing == {"a": ("end of a", "after"), "b": (), "c": ("end of c",), "d": ()}
