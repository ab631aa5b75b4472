# SPDX-License-Identifier: Apache-2.0
"""Whatever is in a policy's files: it loads, or it is refused with a place; never anything else."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from lxml import etree

import comarmor

FILES = {
    "policy.xml": b"""<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <tunable name="ROBOT"><value>/r1</value><value>/r[2-9]</value></tunable>
  <profile name="talker" modifier="AUDIT">
    <attachments><attachment>@{ROBOT}/talker</attachment></attachments>
    <xi:include href="common/node.xml" parse="xml"/>
    <topic qualifier="DENY"><attachment>rt/*[!a]</attachment><permissions><publish/></permissions>
      <partitions><partition>p*</partition></partitions></topic>
    <ros_action qualifier="ALLOW"><attachment>{namespace}do</attachment>
      <permissions><ros_request/></permissions></ros_action>
  </profile>
</profiles>
""",
    "common/node.xml": b"""<profile name="node"><attachment>*</attachment>
  <ros_service qualifier="ALLOW"><attachment>{namespace}{name}/\\[x</attachment>
    <permissions><ros_call/></permissions></ros_service>
</profile>
""",
}
TEXTS = [
    "{",
    "}",
    "@{",
    "@{ROBOT}",
    "[",
    "]",
    "\\",
    "[[:",
    "[z-a]",
    "/a b",
    "..",
    "\u00e9",
    "x" * 5000,
    "",
    "common/node.xml",
]
BYTES = [
    b"<",
    b">",
    b"&",
    b"]]>",
    b"<!--",
    b"<!DOCTYPE x>",
    b"<![CDATA[",
    b"\x00",
    b"\xff",
    b"'",
    b'"',
    b"&#0;",
    b"xmlns=''",
]


def outcome(root: Path) -> str:
    """Load and use a policy; any exception but one fails the test."""
    try:
        policy = comarmor.load(root)
    except comarmor.ComArmorError as error:
        defects = error.diagnostics
    else:
        defects = ()
    if defects:
        assert all(found.where and found.message for found in defects)
        assert all("\n" not in str(found).encode().decode() for found in defects)
        return "refused"
    for subject in (*policy.subjects(), "/r1/talker"):
        for kind, permissions in comarmor.PERMISSIONS.items():
            policy.decide(subject, kind, permissions[0], "/x", ("p",))
    comarmor.render(policy)
    return "loaded"


def mutated_bytes(chance: random.Random, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(chance.randint(1, 2)):
        at = chance.randrange(len(changed) + 1)
        match chance.randrange(8):
            case 0:
                changed[at : at + chance.randint(1, 20)] = b""
            case 1:
                changed[at:at] = chance.choice(BYTES)
            case 2:
                changed[at : at + 1] = bytes([chance.randrange(256)])
            case 3 | 4 | 5 | 6:
                changed[at : at + 1] = bytes([chance.choice(b"abcdez/*?@! ")])
            case _:
                start = chance.randrange(len(changed) + 1)
                changed[at:at] = changed[start : start + chance.randint(1, 80)]
    return bytes(changed)


def mutated_tree(chance: random.Random, content: bytes) -> bytes:
    root = etree.fromstring(content)
    for _ in range(chance.randint(1, 3)):
        elements = list(root.iter(etree.Element))
        one, other = chance.choice(elements), chance.choice(elements)
        parent = one.getparent()
        match chance.randrange(6):
            case 0 if parent is not None:
                parent.remove(one)
            case 1:
                one.tag = other.tag
            case 2:
                one.text = chance.choice(TEXTS)
            case 3:
                one.set(chance.choice(["name", "href", "qualifier", "modifier", "parse", "x"]), chance.choice(TEXTS))
            case 4:
                one.append(etree.fromstring(etree.tostring(other, with_tail=False)))
            case _:
                one.attrib.clear()
    return etree.tostring(root)


@pytest.mark.parametrize("mutate", [mutated_bytes, mutated_tree])
def test_mutated_policies(tmp_path, mutate) -> None:
    chance = random.Random(1)
    (tmp_path / "common").mkdir()
    counts = {"loaded": 0, "refused": 0}
    for _ in range(600):
        broken = chance.choice(list(FILES))
        for name, content in FILES.items():
            (tmp_path / name).write_bytes(mutate(chance, content) if name == broken else content)
        counts[outcome(tmp_path)] += 1
    assert min(counts.values()) > 10  # both ways are really taken
