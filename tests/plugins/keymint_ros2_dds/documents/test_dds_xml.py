# SPDX-License-Identifier: Apache-2.0
"""Large documents: no blanks that handshakes would carry, and still a line for each topic."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import pytest
import xmlschema
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.emit import kind_members
from lxml import etree

from comarmor.data import locate
from keymint.api import BuildOptions
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.builds import CHATTER, build
from tests.plugins.keymint_ros2_dds.packages import package, rule

NAMES = st.lists(st.from_regex(r"/[a-z][a-z0-9_]{0,30}(/[a-z][a-z0-9_]{0,30}){0,2}", fullmatch=True), max_size=30)


def built(*names: str, indented: int, **options: bool) -> bytes:
    """Return the permissions of who may publish and subscribe to these topics."""
    rules = [rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", name) for name in names]
    with mock.patch.object(dds_xml, "INDENTED", indented):
        done = build_type.build(package(*rules), replace(BuildOptions(), **options))
    (name,) = done.plain_sizes
    assert name == "permissions.xml"
    if options == {"optimise": False}:
        assert done.plain_sizes[name] == len(done.documents[name])
    return done.documents[name]


@settings(max_examples=tries(30, 60))
@given(NAMES, st.integers(500, 6_000))
def test_only_a_document_beyond_the_limit_loses_its_blanks_and_nothing_else(names: list[str], limit: int) -> None:
    usual, limited = built(*names, indented=10**9), built(*names, indented=limit)
    bare = b"".join(line.lstrip(b" ") for line in usual.splitlines(keepends=True))
    assert limited == (usual if len(usual) <= limit else bare)
    trees = [etree.fromstring(each, etree.XMLParser(remove_blank_text=True)) for each in (usual, limited)]
    assert etree.tostring(trees[0], method="c14n") == etree.tostring(trees[1], method="c14n")
    assert usual.count(b"\n") == limited.count(b"\n"), "the number of a line means the same"


@settings(max_examples=tries(30, 60))
@given(NAMES, st.integers(500, 12_000))
def test_the_size_of_the_plain_form_is_what_it_would_have(names: list[str], limit: int) -> None:
    rules = [rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", name) for name in names]
    with mock.patch.object(dds_xml, "INDENTED", limit), mock.patch.object(kind_members, "_known", {}):
        small = build_type.build(package(*rules), BuildOptions())
        plain = build_type.build(package(*rules), BuildOptions(optimise=False))
    assert small.plain_sizes == {"permissions.xml": len(plain.documents["permissions.xml"])}


def test_the_limit() -> None:
    """As many names as fit are indented; one more, and none is."""
    names = [f"/some/namespace/topic_{number:04}/of_words" for number in range(600)]
    sizes = [(count, built(*names[:count], indented=32_000, optimise=False)) for count in (30, 40, 600)]
    assert [any(line.startswith(b" ") for line in content.splitlines()) for _, content in sizes] == [True, True, False]


def test_the_documents_hold_nothing_that_a_vendor_refuses():
    built = build(CHATTER, rule("ALLOW", "topic", "publish", "x", partitions=["", "p"]))
    for content in built.documents.values():
        text = content.decode()
        assert "<!--" not in text
        assert "\r" not in text
        assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>\n<dds ')
        root = etree.fromstring(content)
        assert {name for item in root.iter() for name in item.attrib} <= {
            "name",
            "{http://www.w3.org/2001/XMLSchema-instance}noNamespaceSchemaLocation",
        }
        leaves = [item.text or "" for item in root.iter() if not len(item)]
        assert all(text == text.strip() for text in leaves)


@pytest.mark.parametrize("kind", ["permissions", "governance"])
def test_the_schemas_are_accepted_by_both_validators(kind):
    path = locate("keymint_ros2_dds", "schemas") / f"{kind}.xsd"
    independent = xmlschema.XMLSchema(str(path))
    content = build(CHATTER).documents[f"{kind}.xml"]
    root = etree.fromstring(content)
    assert etree.XMLSchema(file=str(path)).validate(root)
    independent.validate(content.decode())
    root[0].append(etree.Element("surprise"))
    assert not etree.XMLSchema(file=str(path)).validate(root)
    assert not independent.is_valid(etree.tostring(root).decode())
