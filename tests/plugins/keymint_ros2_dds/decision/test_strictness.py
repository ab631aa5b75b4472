"""What each vendor does with documents that are not plain; measured, and measured again by ``tests/real``."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.decision import CYCLONEDDS_0_10, FASTDDS_2_9, OMG, PermissionsDocument, read, strictness
from keymint_ros2_dds.reading import dates, domain_ids
from lxml import etree

from keymint.errors import KeymintError

from .documents import criteria, document, grant, rule

READS, REFUSES, UNKNOWN = "reads", "refuses", "unknown"
PLAIN = document(
    grant(
        rule("allow", criteria("publish", "rt/x", "rt/y"), criteria("subscribe", "rt/s", partitions=("a",))),
        rule("deny", criteria("publish", "rt/*", tags="t")),
        rule("allow", domains="<id_range><min>0</min><max>7</max></id_range>"),
    )
)
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
        (b"<dds>", b"<dds" + NAMESPACE + b' xsi:noNamespaceSchemaLocation="x">', READS, READS),
        (b"<dds>", b"<dds" + NAMESPACE + b' xsi:schemaLocation="a b">', REFUSES, READS),
        (b"<dds>", b'<dds xmlns:a="b">', REFUSES, READS),
        (b"<dds>", b'<dds xml:lang="en">', REFUSES, READS),
        (b"<publish>", b'<publish foo="1">', REFUSES, READS),
        (b"<publish>", b"<publish><foo/>", REFUSES, REFUSES),
        (b"<grant", b"<foo/><grant", REFUSES, REFUSES),
        (b"</permissions>", b"</permissions><foo/>", REFUSES, UNKNOWN),
        (b"</topic>", b"</topic >", REFUSES, READS),
        (b"<topic>", b"<topic >", READS, READS),
        (b"<publish>", b"<publish><!-- c -->", READS, READS),
        (b"rt/x<", b"rt/<!-- c -->x<", READS, READS),
        (b"rt/x<", b"<![CDATA[rt/x]]><", READS, READS),
        (b"rt/x<", b"<![CDATA[rt]]><![CDATA[/x]]><", UNKNOWN, UNKNOWN),
        (b"<id>0", b"<id><!-- c -->0", READS, UNKNOWN),
        (b"DENY", b"DE<!-- c -->NY", READS, UNKNOWN),
        (b"<publish>", b"<?a b?><publish>", READS, REFUSES),
        (b"<dds>", b"<?a b?><dds>", READS, READS),
        (b"<dds>", b"<!-- c --><?a b?><dds>", READS, REFUSES),
        (b"</dds>", b"</dds><?a b?>", READS, REFUSES),
        (b"rt/x<", b"rt/<?a b?>x<", UNKNOWN, REFUSES),
        (b"rt/x<", b"rt/&#120;<", READS, READS),
        (b"rt/x<", b"rt/&#x78;&amp;<", READS, READS),
        (b"rt/x<", b"rt/x&#32;<", READS, UNKNOWN),
        (b"rt/x<", b"rt/&#00000000000120;<", UNKNOWN, READS),
        (b"<publish>", b"x<publish>", REFUSES, READS),
        (b"<topic>rt/x</topic>", b"<TOPIC>rt/x</TOPIC>", UNKNOWN, REFUSES),
        (b"<topic>rt/x</topic>", b"<topic/>", REFUSES, REFUSES),
        (b"<topic>rt/x</topic>", b"<topic> </topic>", REFUSES, REFUSES),
        (b"<id>0</id>", b"", READS, REFUSES),
        (b"<id>0</id>", b"<id>08</id>", REFUSES, READS),
        (b"<id>0</id>", b"<id>+0</id>", READS, READS),
        (b"<id>0</id>", b"<id> 010 </id>", READS, READS),
        (b"<id>0</id>", b"<id>2147483648</id>", REFUSES, READS),
        (b"<id>0</id>", b"<id>-1</id>", REFUSES, READS),
        (b"<id>0</id>", b"<id_range/>", REFUSES, REFUSES),
        (b"<domains><id>0</id></domains>", b"", REFUSES, REFUSES),
        (b"<domains><id>0</id></domains>", b"<domains><id>0</id></domains><domains/>", UNKNOWN, REFUSES),
        (b"<default>DENY</default>", b"<default/>", REFUSES, REFUSES),
        (b"<default>DENY</default>", b"<default>deny</default>", READS, REFUSES),
        (b"<default>DENY</default>", b"<default> DENY</default>", READS, REFUSES),
        (b"<default>DENY</default>", b"<default>DENY</default><default>ALLOW</default>", UNKNOWN, READS),
        (b"<default>DENY</default>", b"<default>DENY</default><allow_rule/>", REFUSES, READS),
        (b"<subject_name>", b"<subject_name>CN=/a</subject_name><subject_name>", UNKNOWN, REFUSES),
        (b"CN=/talker,OU=4f", b"", REFUSES, REFUSES),
        (b"</subscribe>", b"</subscribe><relay/>", READS, READS),
        (b"</subscribe>", b"</subscribe><relay><topics><topic/></topics></relay>", READS, REFUSES),
        (b"</topics>", b"</topics><topics><topic>z</topic></topics>", UNKNOWN, UNKNOWN),
        (b"<permissions>", b"<permissions/><permissions>", UNKNOWN, UNKNOWN),
        (b"2026-01-01T00:00:00", b"2026-01-01T24:00:00", READS, REFUSES),
        (b"2026-01-01T00:00:00", b"garbage", READS, REFUSES),
        (b"2026-01-01T00:00:00", b"2026-1-1T0:0:0", READS, UNKNOWN),
        (b"2026-01-01T00:00:00", b"", REFUSES, REFUSES),
    ],
)
def test_what_is_not_plain(old: bytes, new: bytes, cyclone: str, fast: str) -> None:
    assert old in PLAIN
    found = read(PLAIN.replace(old, new, 1))
    assert (does(found, CYCLONEDDS_0_10), does(found, FASTDDS_2_9)) == (cyclone, fast)
    assert does(found, OMG) == (REFUSES if found.defects else READS)


def test_what_is_written_in_two_bytes_a_character() -> None:
    text = '<?xml version="1.0" encoding="UTF-16"?>' + PLAIN.decode()
    assert {does(read(text.encode("utf-16")), each) for each in (CYCLONEDDS_0_10, FASTDDS_2_9)} == {UNKNOWN}


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


def test_nothing_that_the_schema_refuses_is_taken_for_plain() -> None:
    """Whatever is wrong is named by its kind, with what each vendor makes of it, and not by chance."""
    wrong = 0
    for content in altered():
        try:
            found = read(content)
        except KeymintError:
            continue  # it is not read at all
        if found.defects:
            wrong += 1
            kinds = [each for each in strictness.peculiarities(found) if each.invalid]
            assert kinds, content
            assert not any("the schema does not allow" in each.text for each in kinds), (content, found.defects)
    assert wrong > 100


def test_a_reason_names_the_line_of_the_file() -> None:
    content = PLAIN.replace(b"<publish>", b"<publish a='1'>", 1)
    line = content[: content.index(b"<publish a")].count(b"\n") + 1
    reason = CYCLONEDDS_0_10.semantics.refusal(read(content, "p.p7s", 10))
    assert reason == f"p.p7s:{line + 10}: Cyclone DDS refuses the attribute 'a' of <publish>"


@pytest.mark.parametrize(
    ("text", "found"),
    [("0", 0), ("230", 230), ("010", 8), ("-0", 0), ("+7", 7), ("08", None), ("4294967297", 1), ("2147483648", None),
     ("99999999999999999999", None), ("-4294967295", 1)],
)  # fmt: skip
def test_numbers_as_in_c(text: str, found: int | None) -> None:
    assert domain_ids.in_c(text) == (domain_ids.REFUSED if found is None else found)


@pytest.mark.parametrize(
    ("text", "standard", "cyclone", "fast"),
    [
        ("2030-01-01T00:00:00", "2030-01-01T00", "2030-01-01T00", "2030-01-01T00"),
        ("2030-01-01T00:00:00+02:00", "2029-12-31T22", "2029-12-31T22", "2030-01-01T00"),
        ("2030-01-01T00:00:00+13:00", "2029-12-31T11", None, "2030-01-01T00"),
        ("2030-01-01T24:00:00", "2030-01-02T00", None, None),
        ("2030-02-30T00:00:00", None, None, "2030-03-02T00"),
        ("2262-04-11T23:47:17", "2262-04-11T23", None, "2262-04-11T23"),
        ("2262-04-11T23:47:16.9", "2262-04-11T23", "2262-04-11T23", "2262-04-11T23"),
        ("12030-01-01T00:00:00", "9999-12-31T23", None, None),
        ("2030-01-01T00:00:00 and so on", None, None, "2030-01-01T00"),
        ("2030-01-01", None, None, None),
    ],
)
def test_dates(text: str, standard: str | None, cyclone: str | None, fast: str | None) -> None:
    found = [each(text) for each in (dates.standard, dates.cyclone, dates.fast)]
    assert [each and f"{each:%Y-%m-%dT%H}" for each in found] == [standard, cyclone, fast]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"<topic>rt/x</topic>", b"<topic/>", "<topic> is empty"),
        (b"<default>DENY</default>", b"",
         "<grant> is not complete, expected <default>"),
    ],
)  # fmt: skip
def test_what_the_schema_says_is_said_in_words(old: bytes, new: bytes, message: str) -> None:
    assert [each.message for each in read(PLAIN.replace(old, new, 1)).defects] == [message]
