# SPDX-License-Identifier: Apache-2.0
"""What SROS2 refuses is refused: it resolves the includes with libxml2, and validates what comes out of it.

The grammar here says what a policy may be after that, in the words of RELAX NG; SROS2 has it as an XSD of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

import pytest
from keymint_ros2_sros2.parse import parse
from lxml import etree

from comarmor.errors import ComArmorError
from tests.effort import tries

from .sros2_policies import COMMON, LOGGING, XI, enclave, policy

_RULES = "".join(
    f"""<define name="{tag}s"><element name="{tag}s"><ref name="base"/>
      <optional><attribute name="{one}"><ref name="effect"/></attribute></optional>
      <optional><attribute name="{two}"><ref name="effect"/></attribute></optional>
      <oneOrMore><element name="{tag}"><text/></element></oneOrMore></element></define>"""
    for tag, one, two in (
        ("topic", "publish", "subscribe"), ("service", "request", "reply"), ("action", "call", "execute"),
    )
)  # fmt: skip
GRAMMAR = f"""
<grammar xmlns="http://relaxng.org/ns/structure/1.0" datatypeLibrary="http://www.w3.org/2001/XMLSchema-datatypes">
  <start><element name="policy"><attribute name="version"><value>VERSION</value></attribute>INNER</element></start>
  <define name="enclaves"><element name="enclaves"><oneOrMore><element name="enclave">
    <attribute name="path"><text/></attribute><oneOrMore><ref name="profiles"/></oneOrMore>
  </element></oneOrMore></element></define>
  <define name="profiles"><element name="profiles">MORE<oneOrMore><ref name="profile"/></oneOrMore></element></define>
  <define name="profile"><element name="profile"><attribute name="ns"><text/></attribute>
    <attribute name="node"><text/></attribute><ref name="base"/>
    <zeroOrMore><choice><ref name="topics"/><ref name="services"/><ref name="actions"/></choice></zeroOrMore>
  </element></define>
  {_RULES}
  <define name="effect"><choice><value>ALLOW</value><value>DENY</value></choice></define>
  <define name="base"><optional><attribute name="xml:base"><data type="anyURI"/></attribute></optional></define>
  <define name="any"><zeroOrMore><choice><text/><attribute><anyName/></attribute><element><anyName/><ref name="any"/>
    </element></choice></zeroOrMore></define>
</grammar>"""
"""A policy with its includes resolved, for each version."""
GROUP = '<ref name="profile"/></oneOrMore>'
FOXY = (
    GRAMMAR.replace("VERSION", "0.2.0").replace("INNER", '<ref name="enclaves"/>')
    .replace("MORE", '<optional><attribute name="type"><text/></attribute></optional>')
    .replace(GROUP, f'{GROUP}<optional><element name="metadata"><ref name="any"/></element></optional>')
)  # fmt: skip
CRYSTAL = GRAMMAR.replace("VERSION", "0.1.0").replace("INNER", '<ref name="profiles"/>').replace("MORE", "")
SCHEMAS = [etree.RelaxNG(etree.fromstring(each)) for each in (FOXY, CRYSTAL)]


def is_refused_by_sros2(path: Path) -> bool:
    """Tell what SROS2's ``load_policy`` does."""
    try:
        tree = etree.parse(path)
        tree.xinclude()
    except (etree.XIncludeError, etree.XMLSyntaxError):
        return True
    for hint in ("schemaLocation", "noNamespaceSchemaLocation"):  # an XSD allows both anywhere
        tree.getroot().attrib.pop(f"{{http://www.w3.org/2001/XMLSchema-instance}}{hint}", None)
    return not any(each.validate(tree) for each in SCHEMAS)


def refusal(path: Path) -> str:
    """Return what Keymint says about a policy; empty if it takes it."""
    try:
        parse(path)
    except ComArmorError as error:
        found = error.diagnostics[0]
        assert found.where is not None
        assert found.where.line > 0
        return f"{found.code}: {found.message}"
    return ""


def include(href: str, xpointer: str = "xpointer(/profile/*)") -> str:
    return f'<xi:include href="{href}"' + (f' xpointer="{xpointer}"' if xpointer else "") + "/>"


LISTED = '<topics publish="ALLOW"><topic>/x</topic></topics>'
PLAIN = policy(enclave("/a", LISTED))
OTHER = policy(enclave("/b", LISTED, node="m"))
OLD = f'<policy version="0.1.0"><profiles><profile ns="/" node="n">{LISTED}</profile></profiles></policy>'
ENDED = '<profiles><profile ns="/" node="x"/><metadata/></profiles>'
FILES = {
    "logging.xml": LOGGING, "sub/logging.xml": LOGGING, "o.xml": OTHER, "sub/o.xml": OTHER, "ended.xml": ENDED,
    "empty.xml": "<profile/>", **COMMON,
    "sub/up.xml": f"<enclaves {XI}>{include('../o.xml', 'xpointer(/policy/enclaves/*)')}</enclaves>",
    "sub/mixed.xml": f"<profile {XI}><topics>{include('logging.xml', 'xpointer(/*/topics/*)')}</topics></profile>",
}  # fmt: skip


def with_lists(text: str) -> str:
    return policy(enclave("/a", text))


def with_group(text: str) -> str:
    return policy(f'<enclave path="/a">{text}</enclave>')


REFUSED: Mapping[str, tuple[str, str]] = {
    **{
        f"xml:base of {tag}": (PLAIN.replace(f"<{tag}{end}", f'<{tag} xml:base="x"{end}', 1), "attribute 'xml:base'")
        for tag, end in (("policy", ""), ("enclaves", ""), ("enclave", " "), ("profiles", ""), ("topic", ">"))
    },
    "xml:base that is no address": (PLAIN.replace("<topics", '<topics xml:base="::%zz"'), "not a valid value"),
    "xml:lang": (PLAIN.replace("<profile ", '<profile xml:lang="en" '), "unknown attribute 'xml:lang'"),
    "xml:space": (PLAIN.replace("<topics", '<topics xml:space="preserve"'), "unknown attribute 'xml:space'"),
    "metadata first": (PLAIN.replace("<profiles>", "<profiles><metadata/>"), "<profile> is not expected after"),
    "metadata between": (
        PLAIN.replace("</profiles>", '<metadata/><profile ns="/" node="k"/></profiles>'),
        "<profile> is not expected after <metadata>",
    ),
    "metadata twice": (
        PLAIN.replace("</profiles>", "<metadata/><metadata/></profiles>"), "<metadata> is not expected after",
    ),
    "metadata alone": (with_group("<profiles><metadata/></profiles>"), "<profiles> has no <profile>"),
    "metadata in a profile": (with_lists(f"{LISTED}<metadata/>"), "<metadata> is not expected here"),
    "metadata that an include puts in between": (
        with_group(f'<profiles>{include("ended.xml", "xpointer(/profiles/*)")}<profile ns="/" node="x"/></profiles>'),
        "<profile> is not expected after <metadata>",
    ),
    "metadata in version 0.1.0": (OLD.replace("</profiles>", "<metadata/></profiles>"), "version 0.1.0"),
    "a type in version 0.1.0": (OLD.replace("<profiles>", '<profiles type="x">'), "version 0.1.0"),
    "an xpointer without its function": (with_lists(include("logging.xml", "/profile/*")), "is not supported"),
    "an xpointer that does not end": (with_lists(include("logging.xml", "xpointer(/profile/*")), "is not supported"),
    "an xpointer that does not begin": (with_lists(include("logging.xml", "/profile/*)")), "is not supported"),
    "an enclave of another folder": (policy(include("sub/o.xml", "xpointer(/policy/enclaves/*)")), "xml:base"),
    "profiles of another folder": (
        with_group(include("sub/o.xml", "xpointer(/policy/enclaves/enclave/*)")), "xml:base",
    ),
    "a topic of another folder": (
        with_lists(f'<topics publish="ALLOW">{include("sub/logging.xml", "xpointer(/profile/topics/*)")}</topics>'),
        "xml:base",
    ),
    "the enclaves of another folder": (
        f'<policy version="0.2.0" {XI}>{include("sub/up.xml", "")}</policy>', "xml:base",
    ),
    "an empty list": (with_lists('<topics publish="ALLOW"/>'), "<topics> has no <topic>"),
    "a list that an include leaves empty": (
        with_lists(f'<topics publish="ALLOW">{include("empty.xml")}</topics>'), "<topics> has no <topic>",
    ),
    "no profile": (with_group("<profiles/>"), "<profiles> has no <profile>"),
    "no profiles": (with_group(""), "<enclave> has no <profiles>"),
    "enclaves twice": (
        PLAIN.replace("</enclaves>", f"</enclaves><enclaves>{enclave('/c', '')}</enclaves>"),
        "<enclaves> is not expected after <enclaves>",
    ),
    "profiles twice in version 0.1.0": (
        OLD.replace("</profiles>", '</profiles><profiles><profile ns="/" node="k"/></profiles>'),
        "<profiles> is not expected after <profiles>",
    ),
    "an include in metadata that is missing": (
        PLAIN.replace("</profiles>", f"<metadata>{include('missing.xml', '')}</metadata></profiles>"), "does not exist",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_sros2_refuses_is_refused_with_the_reason(write: Callable[..., Path], name: str) -> None:
    text, reason = REFUSED[name]
    path = write(text, FILES)
    assert is_refused_by_sros2(path)
    assert reason in refusal(path)


TAKEN = {
    "plain": PLAIN,
    "version 0.1.0": OLD,
    "xml:base of a profile": PLAIN.replace("<profile ", '<profile xml:base="x/" '),
    "xml:base of a list": PLAIN.replace("<topics", '<topics xml:base="x/"'),
    "metadata last": PLAIN.replace("</profiles>", "<metadata><any/></metadata></profiles>"),
    "a type": PLAIN.replace("<profiles>", '<profiles type="x">'),
    "an empty profile": with_lists(""),
    "includes": with_lists(include("common/node.xml")),
    "blanks in an xpointer": with_lists(include("logging.xml", " xpointer( /profile/* ) ")),
    "the lists of another folder": with_lists(include("sub/logging.xml")),
    "topics of one other folder": with_lists(include("sub/mixed.xml")),
    "a profile of another folder": with_group(
        f"<profiles>{include('sub/o.xml', 'xpointer(/policy/enclaves/enclave/profiles/*)')}</profiles>"
    ),
    "an enclave of this folder": policy(include("o.xml", "xpointer(/policy/enclaves/*)")),
    "an enclave of this folder in another way": policy(include("sub/../o.xml", "xpointer(/policy/enclaves/*)")),
    "an enclave of this folder by another folder": policy(include("sub/up.xml", "xpointer(/enclaves/*)")),
    "metadata that an include brings": with_group(
        f"<profiles>{include('ended.xml', 'xpointer(/profiles/*)')}</profiles>"
    ),
}


@pytest.mark.parametrize("name", TAKEN)
def test_what_sros2_takes_is_taken(write: Callable[..., Path], name: str) -> None:
    path = write(TAKEN[name], FILES)
    assert not is_refused_by_sros2(path)
    assert refusal(path) == ""


PARTS = (
    LISTED, '<services reply="DENY"><service>s</service></services>', "<topics/>", "<metadata/>", "<topic>/x</topic>",
    '<profile ns="/" node="n"/>', "<profiles/>", enclave("/z", LISTED), "<enclaves/>", include("logging.xml"), "text",
    include("sub/logging.xml"), include("o.xml", "xpointer(/policy/enclaves/*)"), include("common/node.xml", ""),
    include("sub/o.xml", "xpointer(/policy/enclaves/enclave/*)"), include("logging.xml", "xpointer(/profile/topics/*)"),
    include("sub/logging.xml", "xpointer(/profile/topics/*)"), include("ended.xml", "xpointer(/profiles/*)"),
    include("empty.xml"), include("logging.xml", "/profile/*"), include("sub/mixed.xml"), "<!-- c -->",
)  # fmt: skip
ATTRIBUTES = (' xml:base="b/"', ' xml:lang="en"', ' type="t"', ' publish="ALLOW"', ' version="0.2.0"', ' path="/p"')
PLACES = ("policy", "enclaves", "enclave", "profiles", "profile", "topics", "topic")


def changed(text: str, chance: Random) -> str:
    """Return a policy with another part or attribute somewhere."""
    tag = chance.choice(PLACES)
    if chance.random() < 0.3:
        return text.replace(f"<{tag}", f"<{tag}{chance.choice(ATTRIBUTES)}", 1)
    part = chance.choice(PARTS)
    before = chance.random() < 0.5
    mark = f"</{tag}>" if before else f"<{tag}"
    at = text.find(mark) if before else text.find(">", text.find(mark)) + 1
    return text[:at] + part + text[at:] if at > 0 else text


@pytest.mark.parametrize("first", [PLAIN, OLD.replace("<policy ", f"<policy {XI} "), OTHER])
def test_nothing_is_taken_that_sros2_refuses(write: Callable[..., Path], first: str) -> None:
    chance, both = Random(first), [0, 0]
    for number in itertools.count():
        if number == tries(300, 3_000):
            break
        text = first
        for _ in range(chance.choice((1, 1, 2, 3))):
            text = changed(text, chance)
        path = write(text, FILES if not number else None)
        refused = is_refused_by_sros2(path)
        both[refused] += 1
        assert not refused or refusal(path), text
    assert min(both) > number // 20
