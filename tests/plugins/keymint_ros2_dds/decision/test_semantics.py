# SPDX-License-Identifier: Apache-2.0
"""What each vendor does with documents that are not plain; measured, and measured again by ``tests/real``."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, OMG
from keymint_ros2_dds.reading.signed_permissions import PermissionsDocument, read
from lxml import etree

from keymint.errors import KeymintError

from .documents import PLAIN

READS, REFUSES, UNKNOWN = "reads", "refuses", "unknown"
NAMESPACE = b' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'


def does(found: PermissionsDocument, variation) -> str:
    semantics = variation.semantics
    if semantics.refusal(found):
        return REFUSES
    return UNKNOWN if semantics.unmodelled(found) else READS


@pytest.mark.parametrize(
    ("old", "new", "cyclone", "fast"),
    [
        (b"", b"", READS, READS),
        (b"<dds>", b"\xef\xbb\xbf<dds>", REFUSES, READS),
        (b"<dds>", b"<?xml version='1.0' encoding='utf-8'?><dds" + NAMESPACE + b">", READS, READS),
        (b"<dds>", b'<?xml version="1.0" encoding="ISO-8859-1" standalone="yes"?>\n<dds>', READS, READS),
        (b"<dds>", b"<dds" + NAMESPACE + b' xsi:noNamespaceSchemaLocation="x">', READS, READS),
        (b"<dds>", b"<dds xsi:noNamespaceSchemaLocation='x'" + NAMESPACE + b">", READS, READS),
        (b"<dds>", b"<dds" + NAMESPACE + b' xsi:schemaLocation="a b">', UNKNOWN, READS),
        (b"<dds>", b'<dds xmlns:a="b">', UNKNOWN, READS),
        (b"<publish>", b'<publish xmlns:a="b"><!-- c -->', UNKNOWN, READS),
        (b"<dds>", b'<dds xml:lang="en">', UNKNOWN, UNKNOWN),
        (b"<publish>", b'<publish foo="1">', UNKNOWN, UNKNOWN),
        (b"<publish>", b"<publish><foo/>", UNKNOWN, UNKNOWN),
        (b"</permissions>", b"</permissions><foo/>", UNKNOWN, UNKNOWN),
        (b"</topic>", b"</topic >", REFUSES, READS),
        (b"</topic>", b"</topic ><!-- c -->", REFUSES, READS),
        (b"</topics>", b"</topics ><?a b?>", UNKNOWN, UNKNOWN),
        (b"<topic>", b"<topic >", READS, READS),
        (b"<publish>", b"\n\t <publish>\n", READS, READS),
        (b"<publish>", b"<publish><!-- c -->", READS, READS),
        (b"<publish>", b"<publish> <!-- <b> > --><!--</x >-->\n", READS, READS),
        (b"<dds>", b"<!-- c --><dds>", READS, READS),
        (b"</dds>", b"</dds><!-- c -->\n", READS, READS),
        (b"rt/x<", b"rt/<!-- c -->x<", UNKNOWN, UNKNOWN),
        (b"rt/x<", b"<!-- c -->rt/x<", UNKNOWN, UNKNOWN),
        (b"rt/x<", b"rt/x> <!-- c --> <", UNKNOWN, UNKNOWN),
        (b"<id>0", b"<id>0<!-- c --><!-- d -->", UNKNOWN, UNKNOWN),
        (b"<id>0", b"<id><!-- c -->0", UNKNOWN, UNKNOWN),
        (b"rt/x<", b"<![CDATA[rt/x]]><", UNKNOWN, UNKNOWN),
        (b"DENY", b"DE<!-- c -->NY", UNKNOWN, UNKNOWN),
        (b"<publish>", b"<?a b?><publish>", UNKNOWN, UNKNOWN),
        (b"<dds>", b"<?a b?><dds>", UNKNOWN, UNKNOWN),
        (b"rt/x<", b"rt/&amp;&lt;<", READS, READS),
        (b"rt/x<", b"rt/&#120;<", UNKNOWN, UNKNOWN),
        (b"<publish>", b"x<publish>", UNKNOWN, UNKNOWN),
        (b"<topic>rt/x</topic>", b"<TOPIC>rt/x</TOPIC>", UNKNOWN, UNKNOWN),
        (b"<topic>rt/x</topic>", b"<topic/>", UNKNOWN, UNKNOWN),
        (b"<topic>rt/x</topic>", b"<topic> </topic>", REFUSES, REFUSES),
        (b"rt/x<", b"rt/\nx<", UNKNOWN, READS),
        (b"<id>0</id>", b"", UNKNOWN, UNKNOWN),
        (b"<id>0</id>", b"<id> 0 </id>", READS, READS),
        (b"<id>0</id>", b"<id>231</id>", REFUSES, READS),
        (b"<id>0</id>", b"<id>010</id>", UNKNOWN, UNKNOWN),
        (b"<id>0</id>", b"<id>2147483648</id>", UNKNOWN, UNKNOWN),
        (b"<id>0</id>", b"<id>-1</id>", UNKNOWN, UNKNOWN),
        (b"<id>0</id>", b"<id_range><max>3</max></id_range>", REFUSES, READS),
        (b"<domains><id>0</id></domains>", b"", UNKNOWN, UNKNOWN),
        (b"<default>DENY</default>", b"", UNKNOWN, UNKNOWN),
        (b"<default>DENY</default>", b"<default> DENY</default>", UNKNOWN, UNKNOWN),
        (b"<default>DENY</default>", b"<default>DENY</default><allow_rule/>", UNKNOWN, UNKNOWN),
        (b' name="g"', b"", UNKNOWN, UNKNOWN),
        (b"CN=/talker,OU=4f", b" ", REFUSES, REFUSES),
        (b"</topics>", b"</topics><topics><topic>z</topic></topics>", UNKNOWN, UNKNOWN),
        (b"<permissions>", b"<permissions/><permissions>", UNKNOWN, UNKNOWN),
        (b"2026-01-01T00:00:00", b"2026-01-01T00:00:00+02:00", READS, READS),
        (b"2026-01-01T00:00:00", b"2026-01-01T24:00:00", READS, UNKNOWN),
        (b"2026-01-01T00:00:00", b"garbage", UNKNOWN, UNKNOWN),
    ],
)
def test_what_is_not_plain(old: bytes, new: bytes, cyclone: str, fast: str) -> None:
    assert old in PLAIN
    found = read(PLAIN.replace(old, new, 1))
    assert (does(found, CYCLONEDDS_0_10), does(found, FASTDDS_2_9)) == (cyclone, fast)
    assert does(found, OMG) == (REFUSES if found.defects else READS)


def test_what_is_written_in_another_encoding() -> None:
    text = '<?xml version="1.0" encoding="UTF-16"?>' + PLAIN.decode()
    latin = '<?xml version="1.0" encoding="ISO-8859-1"?>' + PLAIN.decode().replace("rt/x", "rt/\u00e9")
    for content in (text.encode("utf-16"), latin.encode("latin-1")):
        assert {does(read(content), each) for each in (CYCLONEDDS_0_10, FASTDDS_2_9)} == {UNKNOWN}


def altered() -> list[bytes]:
    """Return the plain document with each element left out, doubled, emptied, renamed, or put after the next one."""
    found = []
    count = len(list(etree.fromstring(PLAIN).iter()))
    for number in range(1, count):
        for change in ("drop", "double", "empty", "rename", "swap", "text", "inner"):
            root = etree.fromstring(PLAIN)
            element = list(root.iter())[number]
            parent = element.getparent()
            if change == "drop":
                parent.remove(element)
            elif change == "double":
                parent.insert(parent.index(element), etree.fromstring(etree.tostring(element, with_tail=False)))
            elif change == "empty":
                element.text = None
                for child in list(element):
                    element.remove(child)
            elif change == "rename":
                element.tag = "foo"
            elif change == "swap":
                parent.append(element)
            elif change == "text":
                element.tail = "x"
            else:
                element.append(etree.Element("topic"))
            found.append(etree.tostring(root))
    return found


def test_of_what_the_schema_refuses_nothing_is_claimed_of_vendors() -> None:
    wrong = 0
    for content in altered():
        try:
            found = read(content)
        except KeymintError:
            continue  # it is not read at all
        if found.defects:
            wrong += 1
            assert {does(found, each) for each in (CYCLONEDDS_0_10, FASTDDS_2_9)} == {UNKNOWN}, content
    assert wrong > 100


def test_a_reason_names_the_line_of_the_file() -> None:
    content = b"<!-- a\ncomment -->" + PLAIN.replace(b"</publish>", b"</publish ><!-- c -->", 1)
    line = content[: content.index(b"</publish >")].count(b"\n") + 1
    reason = CYCLONEDDS_0_10.semantics.refusal(read(content, "p.p7s", 10))
    assert reason == f"p.p7s:{line + 10}: Cyclone DDS refuses white space in an end tag"
