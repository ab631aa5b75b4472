# SPDX-License-Identifier: Apache-2.0
"""An ``xi:include`` element includes an XML file as a whole, or is an error."""

from __future__ import annotations

import pytest
from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.language.policy_files import href_of

WHERE = Origin("policy.xml", 3)
XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


def test_the_attribute() -> None:
    assert href_of(etree.fromstring(f'<xi:include {XI} href="a.xml" parse="xml"/>'), WHERE) == "a.xml"
    assert href_of(etree.fromstring(f"<xi:include {XI}/>"), WHERE) == ""


@pytest.mark.parametrize(
    ("attributes", "inner", "code"),
    [
        ('href="a" xpointer="x"', "", "schema"),
        ('href="a" parse="text"', "", "include-parse"),
        ('href="a"', "<xi:fallback/>", "include-fallback"),
    ],
)
def test_what_is_refused(attributes: str, inner: str, code: str) -> None:
    with pytest.raises(ComArmorError) as caught:
        href_of(etree.fromstring(f"<xi:include {XI} {attributes}>{inner}</xi:include>"), WHERE)
    assert [each.code for each in caught.value.diagnostics] == [code]


def test_a_format_may_have_more_attributes() -> None:
    known = ("href", "parse", "xpointer")
    assert href_of(etree.fromstring(f'<xi:include {XI} href="a.xml" xpointer="x"/>'), WHERE, known) == "a.xml"
    with pytest.raises(ComArmorError, match="expected only href, parse and xpointer") as caught:
        href_of(etree.fromstring(f'<xi:include {XI} href="a.xml" xponter="x"/>'), WHERE, known)
    assert caught.value.diagnostics[0].help == "did you mean 'xpointer'?"
