# SPDX-License-Identifier: Apache-2.0
"""JSON5 is read with the line of each value, within limits, and only if all readers read the same."""

from __future__ import annotations

import json
import math
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_zenoh.documents import json5

from keymint.errors import KeymintError
from tests.effort import tries

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


def plain(text: str) -> Any:
    return json5.parse(text.encode(), "f.json5")[0]


def refused(text: str | bytes) -> tuple[str, str]:
    """Return code and place of the error."""
    with pytest.raises(KeymintError) as caught:
        json5.parse(text if isinstance(text, bytes) else text.encode(), "f.json5")
    [diagnostic] = caught.value.diagnostics
    return diagnostic.code, str(diagnostic.where)


@given(VALUES)
def test_json_is_read_as_the_standard_library_reads_it(value: Any) -> None:
    for indent in (None, 1):
        text = json.dumps(value, indent=indent)
        try:
            text.encode()
        except UnicodeEncodeError:
            continue
        read = _or_refusal(text)
        assert read is REFUSED or json.dumps(read) == json.dumps(json.loads(text))


REFUSED = object()


def _or_refusal(text: str) -> Any:
    """Refusals that are right: a lone surrogate, and a number beyond the range of floats or of digits."""
    try:
        return plain(text)
    except KeymintError:
        assert "\\ud" in text or "e+" in text, text
        return REFUSED


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{a: 1, b: [2, 3,],}", {"a": 1, "b": [2, 3]}),
        ("// c\n{'a': /* d\n */ 'x' // }\n}", {"a": "x"}),
        ("{a: 0x1F, b: .5, c: +2, d: -0x1, e: 1e2}", {"a": 31, "b": 0.5, "c": 2, "d": -1, "e": 100.0}),
        ('{a: "\\x41\\u0042\\\n\\n"}', {"a": "AB\n"}),
        ("\ufeff{a: null, b: true, c: false}", {"a": None, "b": True, "c": False}),
        ("{'}': ']', '[': '//', \"/*\": ','}", {"}": "]", "[": "//", "/*": ","}),
        ("{$a: 1, _b: 2}", {"$a": 1, "_b": 2}),
    ],
)
def test_json5(text: str, value: Any) -> None:
    assert plain(text) == value


def test_lines() -> None:
    _, lines = json5.parse(b'{ // one\n  a: "x\\\ny",\n  b: [1,\n      {c: /*\n*/ 2}],\n}', "f.json5")
    assert lines == {(): 1, ("a",): 2, ("b",): 4, ("b", 0): 4, ("b", 1): 5, ("b", 1, "c"): 5}


@pytest.mark.parametrize("text", ["{a: 1,\n a: 2}", '{"a": 1,\n "\\u0061": 2}', "{b: {a: 1,\n 'a': 1}}"])
def test_a_doubled_key(text: str) -> None:
    assert refused(text) == ("json5-doubled", "f.json5:2")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "// nothing",
        "{",
        "[1,,2]",
        "{a 1}",
        "{a: 1} b",
        "{a: 'x\ny'}",
        "{a: 01}",
        "{a: NaN}",
        "{a: -Infinity}",
        "{a: 18446744073709551616}",
        "{a: undefined}",
        "{\\u0061: 1}",
        "{a: '\\ud800'}",
        "{a: 1} /*",
        "{a: 1 // \u2028 , b: 2\n}",
        "{a: '\u2029'}",
        "{a:\u00a01}",
        "{a: '\x01'}",
        "{a: 1}\0",
    ],
)
def test_what_readers_may_understand_differently_is_refused(text: str) -> None:
    assert refused(text)[0] == "json5-syntax"


def test_the_line_of_a_syntax_error() -> None:
    assert refused("{\n  a: 1,\n  b: }\n}") == ("json5-syntax", "f.json5:3")
    assert refused("{\n  a: 1,\n  b: NaN\n}") == ("json5-syntax", "f.json5:3")
    assert refused(b"{\n  a: '\xff'}") == ("json5-syntax", "f.json5:2")


def test_limits() -> None:
    assert plain("[" * json5.DEPTH + "]" * json5.DEPTH)
    assert refused("[" * (json5.DEPTH + 1) + "]" * (json5.DEPTH + 1)) == ("json5-limit", "f.json5")
    assert refused(b" " * (json5.FILE_BYTES + 1)) == ("json5-limit", "f.json5")


HOSTILE = [
    "{metadata: {a: 1,}}",
    "{metadata: {a: 1}} // mode: 'peer'",
    "/* } */ {metadata: /* , */ {a: 1}}",
    "{'metadata': {\"a\": 0x10}}",
    "{metadata: {a: '\\x41\\u0042\\\n'}}",
    "{metadata: {a: '\\'', b: \"\\\"\"}}",
    "{metadata: {a: '\\0', b: '\\v\\q'}}",
    "{metadata: {a: '\\ud83d\\ude00'}}",
    "{metadata: {a: '\\ud800'}}",
    "{metadata: {a: '\u2028'}}",
    "{metadata: {a: 1}} // \u2028 x",
    "{metadata: {a: 1}} // \u2028 // x",
    "{metadata: {a: 1 // \u2028 , b: 2\n}}",
    "{metadata: {a: 1, a: 2}}",
    "{metadata: {a: .5, b: 5., c: +1, d: -0, e: 1e2}}",
    "{metadata: {a: NaN}}",
    "{metadata: {a: Infinity}}",
    "{metadata: {a: 1e999}}",
    "{metadata: {a: 010}}",
    "{metadata: {\\u0061: 1}}",
    "{metadata: {ä: 1, $: 2, _: 3}}",
    "{metadata: {a: [1, 2,]}}",
    "{metadata: {a: [1,, 2]}}",
    "{metadata: {a:\u00a01}}",
    "{metadata: {a: 1}} {}",
    "\ufeff{metadata: {a: 1}}",
    "{metadata: {a: 'x\n'}}",
    "{metadata: {a: '\t'}}",
    "{metadata: {a: '\\\r\nb'}}",
    "{metadata: {true: false}}",
    "{metadata: {a: 18446744073709551616}}",
    "{metadata: {a: -9223372036854775808}}",
    "#!x\n{metadata: {a: 1}}",
    "{metadata: {'': 1, 'a b': 2}}",
    "{metadata: {a: '/*', b: '*/', c: '//'}}",
    "{metadata: {a: '<!--'}} <!-- x",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_what_is_read_is_what_zenoh_reads(zenoh: ModuleType, text: str) -> None:
    try:
        ours = plain(text)["metadata"]
    except KeymintError:
        return  # a refusal is safe
    theirs = json.loads(zenoh.Config.from_json5(text).get_json("metadata"))
    assert _same(ours, theirs), (ours, theirs)


def test_most_hostile_texts_are_read() -> None:
    """Otherwise the comparison with Zenoh compares nothing."""
    assert sum(_reads(text) for text in HOSTILE) >= 15


def _reads(text: str) -> bool:
    try:
        plain(text)
    except KeymintError:
        return False
    return True


def _same(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, dict):
        return ours.keys() == theirs.keys() and all(_same(ours[key], theirs[key]) for key in ours)
    if isinstance(ours, list):
        return len(ours) == len(theirs) and all(map(_same, ours, theirs))
    if isinstance(ours, int | float) and not isinstance(ours, bool):
        return not isinstance(theirs, bool) and math.isclose(ours, theirs)
    return type(ours) is type(theirs) and bool(ours == theirs)


PIECES = st.sampled_from(
    [
        *("{", "}", "[", "]", ":", ",", '"', "'", "\\", "//", "/*", "*/"),
        *("\n", "\r", " ", "\t", "\x0b", "\u2028", "\ufeff", "\u00a0", "ä", "#"),
        *("a", "b", "0", "-", "+", ".", "e", "0x", "NaN", "null", "true"),
        *("\\u0061", "\\x61", "\\\n", "\\0"),
    ]
)
BASE = ["{", "metadata", ":", "{", "a", ":", "[", "1", ",", '"b"', "]", ",", "b", ":", "'c'", "}", "}"]


@given(st.lists(st.tuples(st.integers(0, len(BASE)), PIECES, st.booleans()), min_size=1, max_size=3))
@settings(max_examples=tries(80, 400), deadline=None)
def test_mutations_are_read_as_zenoh_reads_them_or_refused(
    zenoh: ModuleType, edits: list[tuple[int, str, bool]]
) -> None:
    parts = list(BASE)
    for at, piece, replaces in edits:
        parts[at : at + replaces] = [piece]
    text = "".join(parts)
    try:
        ours = plain(text)
    except KeymintError:
        return
    try:
        theirs = json.loads(zenoh.Config.from_json5(text).get_json("metadata"))
    except zenoh.ZError:
        return  # no router starts with it
    assert isinstance(ours, dict)
    assert _same(ours.get("metadata"), theirs), (text, ours, theirs)
