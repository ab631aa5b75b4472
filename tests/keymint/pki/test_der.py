# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from keymint.pki import der


@given(st.lists(st.tuples(st.sampled_from([der.SEQUENCE, der.SET, der.OCTET_STRING]), st.binary(max_size=300))))
def test_what_is_written_is_read_back(parts: list[tuple[int, bytes]]) -> None:
    written = [der.tlv(*part) for part in parts]
    assert der.elements(b"".join(written)) == written
    assert [(each[0], der.single(each, each[0])) for each in written] == parts


@given(st.binary(max_size=40))
def test_whatever_is_read_has_no_second_encoding(data: bytes) -> None:
    try:
        parts = der.elements(data)
    except ValueError:
        return
    assert b"".join(der.tlv(each[0], der.single(each, each[0])) for each in parts) == data


@pytest.mark.parametrize(
    "data",
    ["30", "3001", "308001ff", "308100", "30817f", "30820001", "30850000000001", "1f0100", "3081", "30ff" + "00" * 127],
)
def test_what_is_not_der_is_refused(data: str) -> None:
    with pytest.raises(ValueError, match=r"length|element|tag"):
        der.elements(bytes.fromhex(data))


@pytest.mark.parametrize(
    ("dotted", "encoded"), [("1.2.840.113549.1.7.2", "06092a864886f70d010702"), ("2.5.4.3", "0603550403")]
)
def test_object_identifiers(dotted: str, encoded: str) -> None:
    assert der.oid(dotted).hex() == encoded


def test_a_single_element_is_the_only_one() -> None:
    assert der.single(der.tlv(der.SET, b"x"), der.SET) == b"x"
    for data in (b"", der.tlv(der.SEQUENCE, b"x"), der.tlv(der.SET) * 2):
        with pytest.raises(ValueError, match="expected tag"):
            der.single(data, der.SET)
