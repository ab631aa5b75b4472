# SPDX-License-Identifier: Apache-2.0
"""Templates of new files."""

from __future__ import annotations

import pytest
from keymint_ros.bootstrap import filled_file
from lxml import etree


def test_a_text_is_escaped() -> None:
    document = etree.fromstring(filled_file("profile/policies.xml", name="a\"b'", path="<x> & $name.xml"))
    assert document.find("policies/policy").get("name") == "a\"b'"
    assert document.findtext(".//profile_path") == "<x> & $name.xml"


def test_lines_have_the_indentation_of_the_line_that_names_them() -> None:
    written = filled_file("package/keymint_package.subject.xml", build_types=("<a/>", "  <b/>"))
    assert b"  <export>\n    <a/>\n      <b/>\n  </export>\n" in written
    assert b"  <export>\n  </export>\n" in filled_file("package/keymint_package.subject.xml", build_types=())


def test_a_value_that_is_missing_is_no_empty_text() -> None:
    with pytest.raises(KeyError, match="path"):
        filled_file("profile/policies.xml", name="x")
