# SPDX-License-Identifier: Apache-2.0
"""Mutates files: their bytes, or their trees. Deterministic for a seed."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Sequence

from lxml import etree

TOKENS = (
    b"<", b">", b"/>", b"&", b"&amp;", b"&#0;", b"&#x9b;", b"&#xFFFF;", b"&x;", b"]]>", b"<!--", b"-->", b"<?xml?>",
    b"<!DOCTYPE a [<!ENTITY x 'y'>]>", b"<![CDATA[", b"\x00", b"\xff", b"\xfe\xff", b"\r", b"\x1b[31m", b"'",
    b'"', b"=",
    b"xmlns=''", b"xmlns:xi='x'", b" ", b"\n" * 3000, b"{", b"}", b"@{", b"*", b"[", b"\\",
)  # fmt: skip
TEXTS = (
    "", " ", "0", "-1", "00", "1e999", "NaN", "9" * 40, "9" * 5000, "4294967296", "65536", "231", "0x10",
    "true", "TRUE",
    "\u202e", "\u009b31m", "\u2028", "\u00e9", "\U0001f916", "a" * 300, "a" * 70000, "/" * 300, "/a" * 600,
    "..", "../../../../etc/passwd", "/etc/passwd", "C:\\x", "a/../b", "file:///etc/passwd", "%2e%2e/x", "~", ".",
    "{name}", "{namespace}", "{subject}", "{0}", "{__class__}", "{", "}", "{{", "${x}", "@{ROBOT}", "@{",
    "@{@{A}}", "%s",
    "*", "/*", "?" * 100, "[", "[]", "[!", "[[:alpha:]]", "[z-a]", "\\", "\\*", "*" * 200,
    "P1Y", "P0D", "-P1D", "P", "PT", "P" + "9" * 30 + "Y", "P1.5D", "P1Y1M1W1DT1H1M1.1S",
    "2018-02-30T00:00:00", "9999-12-31T23:59:59", "0000-00-00", "0001-01-01T00:00:00", "2018-06-01T00:00:00+99:00",
    "2018-06-01T00:00:00Z", "24:00:00", "MD5", "SHA1", "sha256", "SHA512", "EC", "rsa", "DSA", "1024", "512", "1",
    "SECP256R1", "SECP521R1", "secp192r1", "CN=", "CN", "CN=a,CN=b", "CN=" + "x" * 65, "CN=" + "x" * 70000,
    "/CN=a/O=b", "CN=a\\,b+OU=#0000",
    "CA:TRUE", "CA:FALSE,pathlen:-1", "critical,CA:TRUE", "keyCertSign", "DNS:..,IP:999.1.1.1", "DER:00",
    "sros2", "flat", "jazzy", "ardent", "keymint_ros", "keymint_ros2_dds", "ENCRYPT", "NONE", "ALLOW", "DENY", "AUDIT",
)  # fmt: skip

Random = random.Random


def in_bytes(content: bytes, chance: Random) -> bytes:
    """Return a file with one to three changes to its bytes."""
    for _ in range(chance.randint(1, 3)):
        content = chance.choice(_BYTES)(content, chance)
    return content


def _cut(content: bytes, chance: Random) -> bytes:
    return content[: chance.randint(0, len(content))]


def _flip(content: bytes, chance: Random) -> bytes:
    if not content:
        return content
    at = chance.randrange(len(content))
    return content[:at] + bytes([content[at] ^ 1 << chance.randrange(8)]) + content[at + 1 :]


def _delete(content: bytes, chance: Random) -> bytes:
    start = chance.randint(0, len(content))
    return content[:start] + content[start + chance.randint(1, 40) :]


def _repeat(content: bytes, chance: Random) -> bytes:
    start = chance.randint(0, len(content))
    end = start + chance.randint(1, 400)
    return content[:end] + content[start:end] * chance.choice([1, 2, 50]) + content[end:]


def _insert(content: bytes, chance: Random) -> bytes:
    at = chance.randint(0, len(content))
    return content[:at] + chance.choice(TOKENS) + content[at:]


_BYTES: Sequence[Callable[[bytes, Random], bytes]] = (_cut, _flip, _flip, _delete, _repeat, _insert)


def in_tree(content: bytes, chance: Random, others: Sequence[bytes]) -> bytes:
    """Return a document with one to three changes to its tree.

    Args:
        content: a well-formed document.
        chance: source of random choices.
        others: well-formed documents to take elements and texts from.
    """
    root = etree.fromstring(content)
    donors = [element for other in (content, *others) for element in etree.fromstring(other).iter(etree.Element)]
    for _ in range(chance.randint(1, 3)):
        elements = list(root.iter(etree.Element))
        chance.choice(_TREES)(chance.choice(elements), donors, chance)
    return etree.tostring(root, xml_declaration=chance.random() < 0.5, encoding="UTF-8")


Donors = Sequence[etree._Element]


def _double(element: etree._Element, _donors: Donors, chance: Random) -> None:
    for _ in range(chance.choice([1, 1, 2, 200])):
        element.addnext(copy.deepcopy(element)) if element.getparent() is not None else None


def _remove(element: etree._Element, _donors: Donors, _chance: Random) -> None:
    parent = element.getparent()
    if parent is not None:
        parent.remove(element)


def _move(element: etree._Element, _donors: Donors, chance: Random) -> None:
    targets = [other for other in element.getroottree().iter(etree.Element) if other not in list(element.iter())]
    if targets:
        chance.choice(targets).insert(0, element)


def _rename(element: etree._Element, donors: Donors, chance: Random) -> None:
    odd = (
        "x",
        "{urn:x}profile",
        "{http://www.w3.org/2001/XInclude}include",
        "{http://www.w3.org/2001/XInclude}fallback",
    )
    element.tag = chance.choice([*odd, *(donor.tag for donor in donors)])


def _transplant(element: etree._Element, donors: Donors, chance: Random) -> None:
    element.insert(chance.randint(0, len(element)), copy.deepcopy(chance.choice(donors)))


def _attribute(element: etree._Element, donors: Donors, chance: Random) -> None:
    names = [name for donor in donors for name in donor.attrib]
    odd = ["x", "href", "parse", "{http://www.w3.org/2001/XMLSchema-instance}type", "{urn:x}y"]
    element.set(chance.choice([*names, *odd]), _text(donors, chance))


def _no_attribute(element: etree._Element, _donors: Donors, chance: Random) -> None:
    if element.attrib:
        del element.attrib[chance.choice(list(element.attrib))]


def _change_text(element: etree._Element, donors: Donors, chance: Random) -> None:
    leaves = [leaf for leaf in element.iter(etree.Element) if not len(leaf)]
    chance.choice(leaves or [element]).text = _text(donors, chance)


def _comment(element: etree._Element, _donors: Donors, chance: Random) -> None:
    node = chance.choice([etree.Comment("x"), etree.ProcessingInstruction("x", "y")])
    node.tail = chance.choice([None, "text"])
    element.insert(chance.randint(0, len(element)), node)


def _nest(element: etree._Element, _donors: Donors, chance: Random) -> None:
    inner = element
    for _ in range(chance.choice([3, 20, 300])):
        inner = etree.SubElement(inner, element.tag)


def _text(donors: Donors, chance: Random) -> str:
    if chance.random() < 0.3:
        return chance.choice([donor.text or "" for donor in donors])
    return chance.choice(TEXTS)


_TREES: Sequence[Callable[[etree._Element, Donors, Random], None]] = (
    _double, _remove, _move, _rename, _transplant, _attribute, _attribute, _no_attribute,
    _change_text, _change_text, _change_text, _comment, _nest,
)  # fmt: skip
