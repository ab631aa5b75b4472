# SPDX-License-Identifier: Apache-2.0
"""``keymint/`` and ``comarmor/`` know no transport: words of DDS and of Zenoh stand in the plugins only.

The scan covers what a reader or a user sees of the code: names, texts, docstrings and comments. Kinds, permissions and
partitions are words of the policy language, and so of every transport.
"""

from __future__ import annotations

import functools
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from lxml import etree

from tests.conftest import CHECKOUT

WORDS = {
    "dds": r"(?:fast|cyclone|open|micro|rti)?[ -]?dds",
    "cyclone": r"cyclone",
    "vendors' names": r"connext|rti|eprosima",
    "omg": r"omg",
    "rtps": r"rtps",
    "rmw": r"rmw",
    "sros2": r"sros2?",
    "governance": r"governance",
    "permissions document": r"permissions(?:[ _](?:documents?|authority|authorities|ca)|\.xml|\.p7s)",
    "s/mime file": r"p7s",
    "pkcs#11 file": r"p11",
    "participant": r"participants?",
    "guid": r"guids?",
    "wire prefix": r"r[tqrsa](?=/)",
    "zenoh": r"zenoh",
    "router": r"routers?",
    "json5": r"json5",
    "key expression": r"key[ _]?expr(?:ession)?s?",
    "liveliness": r"liveliness",
    "advanced publisher": r"@adv",
}
"""Words of transports: name, and the expression that finds them in lower case."""

_FOUND = {name: re.compile(rf"(?<![a-z0-9@])(?:{expression})(?![a-z0-9])") for name, expression in WORDS.items()}
_CAMEL_CASE = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_SEEN = frozenset({tokenize.NAME, tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", -1)})
FOLDERS = ("keymint", "comarmor")
SOURCES = sorted(path for folder in FOLDERS for path in (CHECKOUT / folder).rglob("*.py"))
OTHERS = sorted(
    path
    for folder in (*FOLDERS, "schemas/comarmor", "schemas/keymint")
    for path in (CHECKOUT / folder).rglob("*")
    if path.suffix in {".xsd", ".json", ".j2", ".css", ".js"}
)
"""Schemas of the language and of graphs, and the templates of pictures."""


class Allowed(NamedTuple):
    """A word of a transport that may stand in a file, and why."""

    file: str
    word: str
    reason: str


EXCEPTIONS = (
    Allowed("keymint/pki/tokens/token_sessions.py", "pkcs#11 file", "p11-kit, the system's list of modules for tokens"),
    Allowed("comarmor/rules.py", "dds", "the title of the ROS 2 design document"),
    Allowed("comarmor/rules.py", "wire prefix", "the names of raw topics in policies, for advice on mistaken ones"),
    Allowed("keymint/commands/assure/report.py", "s/mime file", "the same for the signature of a report"),
    Allowed("keymint/pki/smime.py", "s/mime file", "the file name that RFC 8551, 3.2.1, gives to a signature"),
)


def words(text: str) -> Iterator[tuple[str, int]]:
    """Yield the words of transports in a text, each with the offset of its line."""
    for offset, line in enumerate(text.split("\n")):
        plain = _CAMEL_CASE.sub("_", line).lower()
        yield from ((name, offset) for name, found in _FOUND.items() if found.search(plain))


@functools.cache
def words_of_name(text: str) -> tuple[tuple[str, int], ...]:
    """Return the words of transports in a token; most tokens stand in many places."""
    return tuple(words(text))


def words_of_source(path: Path) -> Iterator[tuple[str, int]]:
    """Yield the words of transports in a module, each with its line."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline):
        if token.type in _SEEN:
            yield from ((word, token.start[0] + offset) for word, offset in words_of_name(token.string))


def name_of(path: Path) -> str:
    return path.relative_to(CHECKOUT).as_posix()


def test_no_module_names_a_transport_without_an_exception_and_every_exception_is_needed() -> None:
    allowed = {(each.file, each.word) for each in EXCEPTIONS}
    found = [(name_of(path), word, line) for path in SOURCES for word, line in words_of_source(path)]
    assert [f"{file}:{line}: {word}" for file, word, line in found if (file, word) not in allowed] == []
    assert allowed == {(file, word) for file, word, _ in found}
    assert len(allowed) == len(EXCEPTIONS)


@pytest.mark.parametrize("path", OTHERS, ids=name_of)
def test_no_schema_or_template_names_a_transport(path: Path) -> None:
    assert [(word, line + 1) for word, line in words(path.read_text())] == []


def test_no_word_of_the_language_is_taken_for_one_of_a_transport() -> None:
    tree = etree.parse(CHECKOUT / "schemas/comarmor/comarmor.xsd")
    names = [str(name) for name in tree.xpath("//@name")]
    assert {"ros_topic", "topic", "publish", "ros_subscribe", "partitions"} <= set(names)
    assert [name for name in names if list(words(name))] == []


@pytest.mark.parametrize(
    ("source", "word"),
    [
        ("DdsDomain = 1", "dds"),
        ("dds_name = 1", "dds"),
        ("# as Cyclone DDS does", "cyclone"),
        ("x = f'{1} of Fast-DDS'", "dds"),
        ('"""The governance\n\nof a participant."""', "participant"),
        ("DEFAULT = 'keymint_ros2_zenoh'", "zenoh"),
        ("FILES = ('permissions.xml',)", "permissions document"),
        ("SUFFIXES = ('.p7s',)", "s/mime file"),
        ("x = 'rt/chatter'", "wire prefix"),
    ],
)
def test_the_scan_finds(source: str, word: str, tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(source + "\n")
    assert word in {found for found, _ in words_of_source(path)}


@pytest.mark.parametrize(
    "source", ["head, _, tail = text.partition('/')", "adds = 1", "# embeds, start/end", "artist = 1"]
)
def test_the_scan_ignores(source: str, tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(source + "\n")
    assert list(words_of_source(path)) == []
