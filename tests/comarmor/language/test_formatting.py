# SPDX-License-Identifier: Apache-2.0
"""The canonical form: one for each meaning and its comments, with nothing lost, and our own files have it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from random import Random
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given, settings, strategies as st
from lxml import etree

from comarmor import ComArmorError, data
from comarmor.language import formatting
from comarmor.language.formatting import canonical_form, render
from comarmor.language.parse import parse
from comarmor.language.source import read_document
from tests import generated
from tests.conftest import CHECKOUT
from tests.effort import tries

LIBRARY = data.locate("keymint_ros", "templates") / "comarmor.d/iron"
HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'


def fmt(text: str | bytes) -> str:
    result = canonical_form(text.encode() if isinstance(text, str) else text, "p.xml")
    assert result is not None
    return result.decode()


def body(text: str | bytes) -> str:
    return fmt(text).removeprefix(HEAD)


# -- laws, for random policies in random layouts -----------------------------------------------------------------------

COMMENTS = (
    "<!-- why -->",
    "<!--tight-->",
    "<!-- two\n     lines -->",
    "<!---->",
    "<?mark a  b?>",
    "<!-- <attachment> & -->",
)


def messy(tokens: list[str], rng: Random) -> str:
    """Return the tokens of a policy with random gaps, comments, quotes, references and CDATA sections."""
    out: list[str] = []
    for token in tokens:
        if (leaf := re.fullmatch(r"<(\w+)>([^<]+)</\1>", token)) and rng.random() < 0.5:
            text = leaf[2].replace("a", rng.choice(("a", "&#97;", "<![CDATA[a]]>", "a<!-- in text -->")))
            space = rng.choice(("", " ", "\n      ", "\t"))
            out.append(f"<{leaf[1]}>{space}{text}{space}</{leaf[1]}>")
        elif rng.random() < 0.3:
            swapped = re.sub(r'(\w+="[^"]*") (\w+="[^"]*")', r"\2   \1", token)
            out.append(swapped.replace('"', "'") if "'" not in swapped else swapped)
        else:
            out.append(token)
    for at in range(len(out), -1, -1):
        gap = rng.choice(("", " ", "\n", "\n\n", "\n\n\n\n  ", "\t\t", "\r\n", " \n\t "))
        note = rng.choice(COMMENTS) + rng.choice(("", " ", "\n\n\n")) if rng.random() < 0.25 else ""
        out.insert(at, gap + note)
    return "".join(out)


def comments(content: bytes) -> list[str]:
    """Return the comments and instructions of a document in order, apart from their indentation."""
    nodes = etree.fromstring(content).getroottree().xpath("//comment() | //processing-instruction()")
    return [re.sub(r"\n[ \t]*", "\n", etree.tostring(each, with_tail=False).decode()) for each in nodes]


def c14n(content: bytes) -> str:
    """Return Canonical XML 2.0 (W3C, 2013) without comments, and without white space around texts."""
    return ET.canonicalize(content.decode(), strip_text=True)


def indents(text: str) -> Iterator[tuple[str, int]]:
    """Yield each line that begins with a tag, and how many elements are open there."""
    depth = 0
    for line in re.sub(r"<!--.*?-->|<\?.*?\?>", "", text, flags=re.DOTALL).splitlines():
        tags = re.findall(r"<(/?)[^<>]*?(/?)>", line)
        if line.lstrip().startswith("<"):
            yield line, depth - line.lstrip().startswith("</")
        depth += sum(1 - bool(empty) - 2 * bool(end) for end, empty in tags)


@settings(max_examples=tries(60, 1000))
@given(st.integers(0, 10_000), st.integers(0, 10_000))
def test_laws_of_random_policies_in_random_layouts(seed: int, layout: int) -> None:
    tokens = generated.tokens(seed, include="common/node.xml")
    content = messy(tokens, Random(layout)).lstrip().encode()
    once = canonical_form(content, "p.xml")
    assert once is not None
    assert canonical_form(once, "p.xml") == once
    assert comments(once) == comments(content)
    assert c14n(once) == c14n(content)
    assert not re.search(rb"[ \t]\n|\n\n\n|^\n|\n\n$|\t", once.replace(b"\r", b""))
    assert all(len(line) - len(line.lstrip()) == 2 * depth for line, depth in indents(once.decode().replace("\r", "")))


def meaning(content: bytes) -> tuple[str, list[str]]:
    """Return a policy without places: rendered, with its unused tunables; or what is wrong with it."""
    try:
        policy = parse(read_document(content, "p.xml", LIBRARY))
    except ComArmorError as error:
        return "", [each.message for each in error.diagnostics]
    return render(policy), [tunable.name for tunable in policy.unused_tunables]


@settings(max_examples=tries(40, 1000))
@given(st.integers(0, 500), st.integers(0, 10_000))
def test_the_policy_stays_the_same(seed: int, layout: int) -> None:
    content = messy(generated.tokens(seed, include="common/node.xml"), Random(layout)).lstrip().encode()
    assert meaning(canonical_form(content, "p.xml") or b"") == meaning(content)


@settings(max_examples=tries(40, 1000))
@given(st.integers(0, 500), st.integers(0, 10_000), st.integers(0, 10_000))
def test_layouts_without_comments_or_blank_lines_have_one_form(seed: int, one: int, two: int) -> None:
    tokens = generated.tokens(seed)

    def plain(layout: int) -> str:
        text = re.sub(r"<!--.*?-->|<\?.*?\?>", "", messy(tokens, Random(layout)), flags=re.DOTALL)
        return re.sub(r"(\r?\n[ \t]*)+", "\n", text).lstrip()

    assert fmt(plain(one)) == fmt(plain(two))


# -- the rules of the form, one by one ---------------------------------------------------------------------------------

TOPIC = (
    "<ros_topic {attributes}><attachment>{name}</attachment>{more}<permissions><ros_publish/></permissions></ros_topic>"
)


def topic(attributes: str = 'qualifier="ALLOW"', name: str = "/a", more: str = "") -> str:
    return TOPIC.format(attributes=attributes, name=name, more=more)


def test_indentation_quotes_and_the_order_of_attributes() -> None:
    text = (
        "<profiles><profile modifier='AUDIT'\n  name='a'><attachment>/a</attachment>"
        + topic()
        + "</profile></profiles>"
    )
    assert fmt(text) == (
        HEAD + "<profiles>\n"
        '  <profile name="a" modifier="AUDIT">\n'
        "    <attachment>/a</attachment>\n"
        '    <ros_topic qualifier="ALLOW">\n'
        "      <attachment>/a</attachment>\n"
        "      <permissions><ros_publish/></permissions>\n"
        "    </ros_topic>\n"
        "  </profile>\n"
        "</profiles>\n"
    )


def test_blank_lines_are_kept_between_elements_and_at_the_ends_of_the_root() -> None:
    text = (
        '\n<profiles>\n\n\n<profile name="a">\n\n\n<attachment>/a</attachment>\n\n\n\n'
        "<attachment>/b</attachment>\n\n</profile>\n\n\n\n"
        '<profile name="b"><attachment>/b</attachment></profile>\n\n</profiles>'
    ).lstrip()
    assert body(text) == (
        '<profiles>\n\n  <profile name="a">\n    <attachment>/a</attachment>\n\n'
        "    <attachment>/b</attachment>\n  </profile>\n\n"
        '  <profile name="b">\n    <attachment>/b</attachment>\n  </profile>\n\n</profiles>\n'
    )


def test_a_comment_stays_on_its_line_or_beside_what_it_follows() -> None:
    text = (
        "<!-- top --><profiles><!-- open -->\n<!-- own --><tunable name='T'><value>a</value>   <!-- of a -->\n"
        "<value>b</value></tunable>\n\n<!-- last -->\n</profiles><!-- after -->\n<?end?>"
    )
    assert body(text) == (
        "<!-- top -->\n"
        "<profiles> <!-- open -->\n"
        "  <!-- own -->\n"
        '  <tunable name="T">\n'
        "    <value>a</value> <!-- of a -->\n"
        "    <value>b</value>\n"
        "  </tunable>\n\n"
        "  <!-- last -->\n"
        "</profiles> <!-- after -->\n"
        "<?end?>\n"
    )


def test_the_lines_of_a_comment_move_together() -> None:
    text = "<profiles>\n\t\t<!-- one\n\t\t     two\n\n\tthree -->\n</profiles>\n"
    assert body(text) == "<profiles>\n  <!-- one\n       two\n\n three -->\n</profiles>\n"


def test_permissions_with_a_comment_take_a_line_each() -> None:
    text = topic().replace("<ros_publish/>", "<ros_publish/><!-- for now --><ros_subscribe></ros_subscribe>")
    assert body(text).splitlines()[2:6] == [
        "  <permissions>", "    <ros_publish/> <!-- for now -->", "    <ros_subscribe/>", "  </permissions>",
    ]  # fmt: skip


def test_a_comment_inside_of_a_text_stays_there() -> None:
    text = topic(name=" /a<!-- not\n  b -->/c &amp; ")
    assert "  <attachment>/a<!-- not\n  b -->/c &amp;</attachment>\n" in body(text)
    around = body(topic(name=" <!-- 1 --> /a\\ <!-- 2 --> "))
    assert "  <attachment><!-- 1 -->/a\\ <!-- 2 --></attachment>\n" in around
    assert body(around) == around


@pytest.mark.parametrize(
    ("written", "form"),
    [
        ("  /a\n ", "/a"),
        ("<![CDATA[/a<b>&]]>", "/a&lt;b&gt;&amp;"),
        ("&#47;a", "/a"),
        ("/a\\ ", "/a\\ "),
        ("/a\\ \n  ", "/a\\ "),
        ("/a\\\\  ", "/a\\\\"),
        ("/ä\u00a0b\u202e", "/ä&#xA0;b&#x202E;"),
        ("/a\tb&#13;c\nd", "/a&#x9;b&#xD;c&#xA;d"),
        ("", ""),
        ("  ", ""),
    ],
)
def test_of_a_text(written: str, form: str) -> None:
    element = f"<attachment>{form}</attachment>" if form else "<attachment/>"
    once = fmt(topic(name=written))
    assert f"  {element}\n" in once
    assert fmt(once) == once


def test_of_the_value_of_an_attribute() -> None:
    text = "<profiles><profile name='\"a\"&#10;&lt;&amp;>\t\u200b'><attachment>/a</attachment></profile></profiles>"
    assert '<profile name="&quot;a&quot;&#xA;&lt;&amp;&gt; &#x200B;">' in body(text)
    assert fmt(fmt(text)) == fmt(text)


def test_namespaces_keep_their_prefixes_and_precede_other_attributes() -> None:
    text = (
        "<profiles xsi:noNamespaceSchemaLocation='a.xsd' xmlns:xsi='http://www.w3.org/2001/XMLSchema-instance'>"
        "<x:include parse='xml' href='a b.xml' xmlns:x='http://www.w3.org/2001/XInclude'></x:include></profiles>"
    )
    assert body(text) == (
        '<profiles xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="a.xsd">\n'
        '  <x:include xmlns:x="http://www.w3.org/2001/XInclude" href="a b.xml" parse="xml"/>\n'
        "</profiles>\n"
    )


def test_a_long_start_tag_has_an_attribute_on_each_line() -> None:
    name = "/long" * 20
    text = f"<tests><test name='t'><deny object='{name}' subject='{name}' permission='publish'/></test></tests>"
    assert body(text).splitlines()[2:5] == [
        f'    <deny subject="{name}"', '          permission="publish"', f'          object="{name}"/>',
    ]  # fmt: skip


def test_line_endings_are_those_of_the_first_line() -> None:
    text = topic(more="\r\n<!-- a\nb -->\r\n")
    assert "\r" not in fmt(text.replace("\r\n", "\n"))
    crlf = fmt(f"<?xml version='1.0'?>\r\n{text}")
    assert crlf.count("\n") == crlf.count("\r\n") > 5
    assert fmt(crlf) == crlf
    assert "\r" not in fmt(f"<!-- x -->\n{text}")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_any_encoding_becomes_utf_8(encoding: str) -> None:
    declared = {"latin-1": '<?xml version="1.0" encoding="ISO-8859-1" standalone="yes"?>'}.get(encoding, "")
    text = declared + "\n" * bool(declared) + "<!-- é\n     two -->\n" + topic(name="/é")
    assert body(text.encode(encoding)) == body("<!-- é\n     two -->\n" + topic(name="/é"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<profiles>", "p.xml:1: not well-formed XML"),
        ("<profiles>\n  <profle/></profiles>", "p.xml:2: <profle> is not expected here"),
        ("<profiles>\n  text</profiles>", "p.xml:1: <profiles> cannot contain text"),
        ("<!DOCTYPE profiles><profiles/>", "p.xml:1: a DOCTYPE is not allowed"),
        ("<tests/>", "p.xml:1: <tests> is not complete, expected <test>"),
        ("", "p.xml:1: the file is not XML: it is empty"),
    ],
)
def test_what_cannot_be_read_is_refused(text: str, message: str) -> None:
    with pytest.raises(ComArmorError) as raised:
        fmt(text)
    assert str(raised.value).startswith(message)


@pytest.mark.parametrize(
    "text",
    [
        "<policy version='0.2.0'/>",
        "<package/>",
        "<profiles xmlns='http://www.eprosima.com/XMLSchemas'/>",
        "<profile format='1'><name>ws</name></profile>",
    ],
)
def test_other_documents_are_no_files_of_this_language(text: str) -> None:
    assert canonical_form(text.encode(), "p.xml") is None


def test_a_form_that_would_mean_something_else_is_never_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    other = "<profiles><profile name='b'><attachment>/a</attachment></profile></profiles>\n"
    for broken in (other, "<profiles><!-- c --></profiles>\n"):
        with monkeypatch.context() as patch:
            patch.setattr(formatting, "laid_out", lambda *_: broken)  # noqa: B023 - called in this round
            with pytest.raises(ComArmorError) as raised:
                fmt(other.replace("<profile ", "<!-- c --><profile "))
            assert raised.value.diagnostics[0].code == "format-meaning"


# -- our own files -----------------------------------------------------------------------------------------------------


def own_files() -> list[Path]:
    """Return the policies that are part of the repository."""
    found = [path for folder in ("examples", "templates") for path in (CHECKOUT / folder).rglob("*.xml")]
    return sorted(path for path in found if canonical_form(path.read_bytes(), str(path)) is not None)


def test_our_own_files_have_the_form() -> None:
    files = own_files()
    assert len(files) > 40
    assert [str(path) for path in files if canonical_form(path.read_bytes(), "p.xml") != path.read_bytes()] == []


@pytest.mark.parametrize(
    ("codec", "name"), [("utf-8-sig", "UTF-8"), ("utf-16", "UTF-16"), ("utf-16-be", "UTF-16BE")], ids=str
)
@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["LF", "CRLF"])
def test_lines_end_as_the_first_one_does_in_every_encoding(codec: str, name: str, end: str) -> None:
    content = f'<?xml version="1.0" encoding="{name}"?>{end}<profiles>{end}</profiles>{end}'.encode(codec)
    assert canonical_form(content, "p.xml") == f'<?xml version="1.0" encoding="UTF-8"?>{end}<profiles/>{end}'.encode()
