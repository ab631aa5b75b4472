# SPDX-License-Identifier: Apache-2.0
"""The elements that an XSD allows inside an element."""

from __future__ import annotations

import pytest
from lxml import etree

from comarmor.xml.schema_violations import SchemaVocabulary

MAIN = b"""<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema">
  <xs:element name="top" type="Root"/>
  <xs:element name="shared"><xs:complexType><xs:all><xs:element name="leaf"/></xs:all></xs:complexType></xs:element>
  <xs:complexType name="Root">
    <xs:sequence>
      <xs:element name="inner" type="Extended"/>
      <xs:choice><xs:group ref="Both"/><xs:element ref="shared"/></xs:choice>
      <xs:element name="tree" type="Root"/>
    </xs:sequence>
    <xs:attribute name="size"/>
  </xs:complexType>
</xs:schema>"""
INCLUDED = b"""<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema">
  <xs:group name="Both"><xs:sequence><xs:element name="one"/><xs:element name="two"/></xs:sequence></xs:group>
  <xs:complexType name="Base"><xs:sequence><xs:element name="first"/></xs:sequence></xs:complexType>
  <xs:complexType name="Extended">
    <xs:complexContent><xs:extension base="Base">
      <xs:sequence><xs:element name="second"/></xs:sequence><xs:attribute name="name"/>
    </xs:extension></xs:complexContent>
  </xs:complexType>
</xs:schema>"""


@pytest.fixture
def vocabulary() -> SchemaVocabulary:
    return SchemaVocabulary(map(etree.fromstring, (MAIN, INCLUDED)))


@pytest.mark.parametrize(
    ("document", "path", "allowed"),
    [
        ("<top/>", ".", ("inner", "one", "two", "shared", "tree")),
        ("<top><inner/></top>", "inner", ("first", "second")),
        ("<top><shared/></top>", "shared", ("leaf",)),
        ("<top><tree><tree/></tree></top>", "tree/tree", ("inner", "one", "two", "shared", "tree")),
        ("<top><one/></top>", "one", ()),
        ("<top><other><inner/></other></top>", "other/inner", ()),
        ("<other/>", ".", ()),
    ],
)
def test_allowed_elements(vocabulary: SchemaVocabulary, document: str, path: str, allowed: tuple[str, ...]) -> None:
    (element,) = etree.fromstring(document).iterfind(path)
    assert vocabulary.allowed_in(element) == allowed


def test_names_of_all_documents(vocabulary: SchemaVocabulary) -> None:
    assert vocabulary.names == ("first", "inner", "leaf", "one", "second", "shared", "top", "tree", "two")
    assert vocabulary.attributes == ("name", "size")
