# SPDX-License-Identifier: Apache-2.0
"""The record of earlier runs: it survives being written, and being damaged."""

from __future__ import annotations

from hashlib import sha256

import pytest
from hypothesis import given, strategies as st

from keymint.view.stamps import VERSION, Stamp, State, digest, digest_files, load, sealed_document

WORDS = st.text(max_size=12)
SECRET = st.lists(WORDS, max_size=2, unique=True).map(lambda names: tuple(sorted(names)))
STAMPS = st.builds(Stamp, WORDS, st.dictionaries(WORDS, WORDS, max_size=4), SECRET)
STATES = st.builds(State, st.dictionaries(WORDS, st.dictionaries(WORDS, STAMPS, max_size=4), max_size=3))


@given(STATES)
def test_a_record_is_loaded_as_it_was_dumped(state: State) -> None:
    assert load(state.dump()) == state
    assert load(state.dump()).dump() == state.dump()


@given(st.dictionaries(WORDS, STAMPS, max_size=5))
def test_equal_records_are_equal_bytes_in_whatever_order_they_grew(stamps: dict[str, Stamp]) -> None:
    one = State().updated("build", stamps)
    other = State()
    for name, stamp in reversed(stamps.items()):
        other = other.updated(
            "build", {name: Stamp(stamp.inputs, dict(reversed(list(stamp.outputs.items()))), stamp.secret)}
        )
    assert one.dump() == other.dump() or not stamps


@given(st.binary(max_size=200))
def test_a_damaged_record_is_an_empty_one(content: bytes) -> None:
    assert load(content) == State()


@given(STATES, st.data())
def test_a_record_that_ends_early_is_an_empty_one(state: State, data: st.DataObject) -> None:
    content = state.dump()
    assert load(content[: data.draw(st.integers(0, len(content) - 2))]) == State()


@given(STATES.filter(lambda state: state.stamps), st.data())
def test_a_record_with_any_flipped_bit_is_an_empty_one(state: State, data: st.DataObject) -> None:
    content = bytearray(state.dump())
    content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert load(bytes(content)) == State()


def sealed(body: bytes) -> bytes:
    """Return a record whose digest is right, whatever it says."""
    return body + b',"sha256":"' + digest(body).encode() + b'"}\n'


NO_LINES = b',"lines":"' + sha256().hexdigest().encode() + b'"'


@pytest.mark.parametrize(
    "content",
    [
        b"null",
        b"[]",
        b'"stamps"',
        b"{}",
        b'{"version":1}',
        b'{"version":2,"stamps":{}}',
        b'{"version":1,"stamps":[]}',
        b'{"version":1,"stamps":{"build":[]}}',
        b'{"version":1,"stamps":{"build":{"a":7}}}',
        b'{"version":1,"stamps":{"build":{"a":["x"]}}}',
        b'{"version":1,"stamps":{"build":{"a":["x",[]]}}}',
        b"[" * 200_000,
        b"\xff\xfe",
        sealed(b'{"version":2,"stamps":{}'),
        sealed(b'{"version":3,"shapes":[],"texts":[],"stamps":{}'),
        sealed(b'{"version":4'),
        sealed(b'{"version":4,"stages":{}'),
        sealed(b'{"version":4,"stages":[]' + NO_LINES),
        sealed(b'{"version":4,"stages":{"build":7}' + NO_LINES),
        sealed(b'{"version":4,"stages":{"build":[7]}' + NO_LINES),
        sealed(b'{"version":4,"stages":{"build":[[]]}' + NO_LINES),
        sealed(b'{"version":4,"stages":{"build":[[[],[],[],[[],[],[]],7]]}' + NO_LINES),
        sealed(b'{"version":4,"stages":{"build":[[[],[],[],[[],[],[]],["a"]]]}' + NO_LINES),
        sealed(b'{"version":4,"stages":' + b"[" * 200_000),
        sealed(b"\xff\xfe"),
    ],
)
def test_a_record_of_another_shape_is_an_empty_one(content: bytes) -> None:
    assert load(content) == State()


def test_what_stamps_have_in_common_is_written_once() -> None:
    said, lasts = "what every stamp says " * 10, "the certificate of '{}' lasts " * 10
    stamps = {
        f"p{n}": Stamp("x", {"a.xml": f"{n}", "claims": said}, (), "c", lasts.format(*range(n, n + 10)), ("dds",))
        for n in range(50)
    }
    state = State().updated("prove", stamps)
    assert [state.dump().count(each) for each in (said.encode(), b"the certificate of", b"a.xml")] == [1, 10, 1]
    assert load(state.dump()).stamps["prove"] == stamps


@pytest.mark.parametrize("own", ["", "a'b", "a\tb", "a\nb", "2026-11-29T02:08:44+00:00", "\udcff", "漢字", "'", "''"])
@pytest.mark.parametrize(
    "text", ["{}", "'{}'", "a long text about '{}' and '{}' " * 5, "an apostrophe's " * 9 + "'{}'"]
)
def test_a_text_is_loaded_as_it_was_whatever_stands_between_quotes(own: str, text: str) -> None:
    stamp = Stamp(text, {own: text.format(*[own] * 20)}, (), own, text.format(*[own] * 20))
    content = State().updated("build", {own: stamp, "b": stamp}).dump()
    assert load(content).stamps["build"] == {own: stamp, "b": stamp}
    assert b"2026-11-29T" not in content.partition(b"\n")[2]  # dates are sought in the first line only


def test_a_record_that_another_program_made_is_read_without_an_error() -> None:
    def of(line: bytes, *form: object) -> bytes:
        stages = {"build": [[*form, ["a"]]]}
        return sealed_document({"version": VERSION, "lines": sha256(line).hexdigest(), "stages": stages}) + line

    forms: list[tuple[object, ...]] = [
        (["f"], [], [], [[], [], [], []]),
        (["f"], [], [], [[], [], []]),
        (["f"], [], [], [["x", "y", "z"], [], [], []]),
        ([7], 7, [7], [[7], [], [], [7]]),
        (["f"],),
    ]
    for line in (b"in\tcontext\tlifetimes\tvalue\n", b"in\n", b"\n", b"", b"\xff\n", b"a\nb\n"):
        for form in forms:
            for stamp in load(of(line, *form)).stamps.get("build", {}).values():
                assert isinstance(stamp.inputs, str)
    assert load(of(b"in\tc\tl\tv\n", *forms[0])).stamp("build", "a") == Stamp("in", {"f": "v"}, (), "c", "l")


def test_no_record_is_an_empty_one() -> None:
    assert load(None) == State()


def test_stamps_are_replaced_and_removed_by_stage() -> None:
    old, new = Stamp("old", {}), Stamp("new", {})
    state = State().updated("build", {"a": old, "b": old}).updated("install", {"a": old})
    state = state.updated("build", {"a": new}, removed=["b", "unknown"])
    assert state.stamp("build", "a") == new
    assert state.stamp("build", "b") is None
    assert state.stamp("install", "a") == old
    assert state.stamp("check", "a") is None


def test_a_file_has_been_written_when_its_own_stamp_says_so() -> None:
    state = State().updated("build", {"a": Stamp("", {"f": digest(b"content")})})
    assert state.wrote("build", "a", "f", b"content")
    assert not state.wrote("build", "a", "f", b"edited")
    assert not state.wrote("build", "a", "g", b"content")
    assert not state.wrote("build", "b", "f", b"content")


@given(st.lists(st.binary(max_size=5), max_size=4), st.lists(st.binary(max_size=5), max_size=4))
def test_digests_tell_parts_apart(one: list[bytes], other: list[bytes]) -> None:
    assert (digest(*one) == digest(*other)) == (one == other)


def test_the_digest_of_files_does_not_depend_on_their_order() -> None:
    assert digest_files({"a": b"1", "b": b"2"}) == digest_files({"b": b"2", "a": b"1"})
    assert digest_files({"a": b"1"}) != digest_files({"a": b"2"})
    assert digest_files({"a": b"1"}) != digest_files({"b": b"1"})
