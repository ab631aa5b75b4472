# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress

import pytest
from cryptography import x509
from hypothesis import example, given, strategies as st

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki import distinguished_names

HERE = Origin("identities.xml", 3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("CN=/robot,OU=x1", "CN=/robot,OU=x1"),
        ("CN = /robot ,  OU = x1 ", "CN=/robot,OU=x1"),
        ("/C=US/O=x/CN=y", "C=US,O=x,CN=y"),
        (
            "C=US, ST=CA, O=Acme, CN=ca/emailAddress=acme@acme.acme",
            "C=US,ST=CA,O=Acme,CN=ca,emailAddress=acme@acme.acme",
        ),
        ("CN=/robot/arm", "CN=/robot/arm"),
        ("commonName=/robot,organizationalUnitName=a b", "CN=/robot,OU=a b"),
        ("cn=x,Email=a@b.c", "CN=x,emailAddress=a@b.c"),
        (r"CN=a,O=Acme\, Inc", r"CN=a,O=Acme\, Inc"),
        (r"CN=a\2Cb", r"CN=a\,b"),
        (r"CN=\C3\A9", "CN=é"),
        (r"CN=a\/OU=b", r"CN=a\/OU=b"),
        (r"CN=\ x\ ", r"CN=\ x\ "),
        ("2.5.4.3=dotted", "CN=dotted"),
        ("1.2.3.4=dotted,CN=a", "1.2.3.4=dotted,CN=a"),
        ("CN=a=b", "CN=a=b"),
    ],
)
def test_the_forms_found_in_the_field_are_read(text: str, expected: str) -> None:
    assert distinguished_names.to_text(distinguished_names.parse(text)) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("   ", "empty"),
        ("robot", "no attribute type"),
        ("/robot", "no attribute type"),
        ("CN=a,", "ends with a separator"),
        ("CN=a,,OU=b", "no attribute type"),
        ("O=Acme, Inc,CN=a", "a comma inside a value"),
        ("CN=", "CN is empty"),
        ("CN=" + "x" * 65, "the maximum is 64"),
        ("CNN=a", "did you mean 'CN'?"),
        ("emailAdress=a@b.c", "did you mean 'emailAddress'?"),
        ("C=USA", "the maximum is 2"),
        ("C=U", "two letters"),
        ("CN=a\nb", "control character"),
        (r"CN=a\00b", "control character"),
        (r"CN=\FF", "not UTF-8"),
        (r"CN=a\x", "two hexadecimal digits"),
        ('CN="a"', "not quoted"),
        ("CN=a+OU=b", "several attributes"),
        ("emailAddress=é@b.c", "ASCII"),
        ("9.9.9=a", "not an attribute type"),
    ],
)
def test_what_is_no_name_is_an_error_with_its_place(text: str, message: str) -> None:
    with pytest.raises(KeymintError) as caught:
        distinguished_names.parse(text, HERE)
    assert message in str(caught.value)
    assert str(caught.value).startswith("identities.xml:3: ")
    assert "\n" not in str(caught.value)


VALUES = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Zl", "Zp", "Zs")) | st.just(" "), min_size=1)
PAIRS = st.lists(
    st.tuples(st.sampled_from(["CN", "O", "OU", "L", "ST", "1.2.3.4"]), VALUES.map(lambda v: v[:16])), min_size=1
)


@given(PAIRS)
def test_text_is_read_back_as_the_name_it_was_made_of(pairs: list[tuple[str, str]]) -> None:
    escaped = ",".join(f"{kind}=" + "".join(f"\\{byte:02X}" for byte in value.encode()) for kind, value in pairs)
    name = distinguished_names.parse(escaped)
    assert [part.value for part in name] == [value for _, value in pairs]
    assert distinguished_names.parse(distinguished_names.to_text(name)) == name


@given(st.text(max_size=60) | st.text('CN=,/\\+ ao0"', max_size=30))
def test_any_text_is_a_name_or_an_error_of_ours(text: str) -> None:
    try:
        name = distinguished_names.parse(text)
    except KeymintError:
        return
    assert distinguished_names.parse(distinguished_names.to_text(name)) == name


SUBJECTS = st.lists(st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,79}", fullmatch=True), min_size=1, max_size=30).map(
    lambda segments: "/" + "/".join(segments)
)


@given(SUBJECTS)
def test_every_subject_has_a_common_name_that_fits(subject: str) -> None:
    common = distinguished_names.common_name(subject)
    assert (common == subject) == (len(subject) <= 64 and subject.count("/") <= 16)
    assert subject.endswith(common) or f"/{subject.rpartition('/')[2]}".startswith(common)


def test_unique_suffixes_are_deterministic_and_differ() -> None:
    assert distinguished_names.unique_suffix("/robot") == distinguished_names.unique_suffix("/robot")
    assert distinguished_names.unique_suffix("/robot") != distinguished_names.unique_suffix("/robot/camera")
    assert len(distinguished_names.unique_suffix("/robot")) == 32


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("OU=x,CN=/", "CN=/,OU=x"),
        (r"O=Acme\, Inc,OU=x,CN=/,C=US", r"CN=/,O=Acme\, Inc,OU=x,C=US"),
        ("CN=/,OU=x", "CN=/,OU=x"),
        ("O=x,OU=y", "O=x,OU=y"),
    ],
)
def test_the_common_name_first(name: str, expected: str) -> None:
    assert distinguished_names.common_name_first(name) == expected


def general(function: Callable[[], object]) -> object:
    """Return what a function returns without the short ways for simple names, or the text of its error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(distinguished_names, "_PLAIN", frozenset[str]())
        return outcome(function)


def outcome(function: Callable[[], object]) -> object:
    distinguished_names._parsed.cache_clear()
    try:
        return function()
    except KeymintError as error:
        return str(error)


TEXTS = st.lists(
    st.sampled_from(["CN", "OU=", "=", "/", ",", "a", "-", ".", "_", "7", " ", "\\", "+", "\n", "é", "CN=/a", ",OU=b"])
).map("".join)


@given(TEXTS)
@example("CN=/robot/arm,OU=x1")
@example("/CN=a,OU=b")
@example("CN=a\n")
def test_simple_names_are_read_as_all_are(text: str) -> None:
    assert outcome(lambda: distinguished_names.parse(text)) == general(lambda: distinguished_names.parse(text))


@given(st.lists(st.tuples(st.sampled_from(["CN", "OU", "1.2.3.4"]), TEXTS), min_size=1))
def test_simple_names_are_shown_as_all_are(pairs: list[tuple[str, str]]) -> None:
    with suppress(KeymintError):
        attributes = [distinguished_names._attribute(kind, value, "") for kind, value in pairs]
        name = x509.Name(attributes)
        assert distinguished_names.to_text(name) == general(lambda: distinguished_names.to_text(name))


@pytest.mark.parametrize(
    "text",
    [
        "CN=/robot/arm",
        f"OU={'f' * 32},CN=/robot/arm",
        f"CN={'x' * 64},CN=/a,OU=b.c-d_e",
        f"OU={'x' * 65},CN=/a",
        "cn=/a",
        "CN=/a/CN=b",
        "/CN=/a",
        "CN=/a, OU=b",
        "C=DE,O=Acme\\, Inc,CN=ä b",
    ],
)
def test_a_name_is_written_as_the_library_writes_it(text: str) -> None:
    try:
        name = distinguished_names.parse(text)
    except KeymintError:
        with pytest.raises(KeymintError):
            distinguished_names.written_name(text)
    else:
        values = [value for _, value in distinguished_names.attributes(name) if re.fullmatch("[A-Za-z0-9/_.-]+", value)]
        expected = name.public_bytes(), distinguished_names.to_text(name), tuple(values)
        assert distinguished_names.written_name(text) == distinguished_names.WrittenName(*expected)
