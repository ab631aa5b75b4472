# SPDX-License-Identifier: Apache-2.0
"""Violations of a schema are explained, with file, line and the nearest known name."""

from __future__ import annotations

from pathlib import Path

import pytest

from comarmor.errors import ComArmorError, Diagnostic
from comarmor.xml.reader import parse
from comarmor.xml.schema import validate

COMMON = """<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema">
  <xs:complexType name="Key">
    <xs:all><xs:element name="curve" type="xs:string"/><xs:element name="size" type="xs:int" minOccurs="0"/>
      <xs:element name="port" minOccurs="0"><xs:simpleType><xs:restriction base="xs:integer">
        <xs:minInclusive value="1"/><xs:maxInclusive value="65535"/></xs:restriction></xs:simpleType></xs:element>
      <xs:element name="name" minOccurs="0"><xs:simpleType><xs:restriction base="xs:token">
        <xs:maxLength value="3"/></xs:restriction></xs:simpleType></xs:element></xs:all>
  </xs:complexType>
</xs:schema>"""
MAIN = """<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema">
  <xs:include schemaLocation="common.xsd"/>
  <xs:element name="key" type="Key"/>
</xs:schema>"""


@pytest.fixture
def schema(tmp_path: Path) -> str:
    (tmp_path / "common.xsd").write_text(COMMON)
    (tmp_path / "main.xsd").write_text(MAIN)
    return str(tmp_path / "main")


def violations(content: str, schema: str) -> tuple[Diagnostic, ...]:
    with pytest.raises(ComArmorError) as caught:
        validate(parse(content.encode(), "k.xml"), "comarmor", schema, "k.xml")
    return caught.value.diagnostics


def test_a_valid_document(schema: str) -> None:
    validate(parse(b"<key><size>1</size><curve/></key>", "k.xml"), "comarmor", schema, "k.xml")


def test_a_misspelled_element_of_an_included_schema(schema: str) -> None:
    (diagnostic,) = violations("<key>\n<curv/></key>", schema)
    assert (diagnostic.code, str(diagnostic.where)) == ("schema", "k.xml:2")
    assert diagnostic.message.startswith("<curv> is not expected here")
    assert diagnostic.help == "did you mean 'curve'?"


def test_an_element_that_occurs_twice(schema: str) -> None:
    (diagnostic,) = violations("<key><curve/>\n<curve/></key>", schema)
    assert "move it, or remove it" in diagnostic.help


def test_a_value_of_the_wrong_type(schema: str) -> None:
    (diagnostic,) = violations("<key><curve/><size>big</size></key>", schema)
    assert diagnostic.message.startswith("<size> is 'big', which is not a valid value")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<port>0</port>", "<port> is '0', expected 1 or more"),
        ("<port>65536</port>", "<port> is '65536', expected 65535 or less"),
        ("<name>four</name>", "<name> has 4 characters, expected 3 or fewer"),
    ],
)
def test_a_value_beyond_its_limit(schema: str, content: str, message: str) -> None:
    (diagnostic,) = violations(f"<key><curve/>{content}</key>", schema)
    assert diagnostic.message == message
