# SPDX-License-Identifier: Apache-2.0
"""The subject name of a grant against that of an identity, as each implementation compares them."""

from __future__ import annotations

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from keymint_ros2_dds.decision.subject_names import parts_occur, same_attributes, same_name, same_text, tokens

RDNS = st.lists(
    st.builds(
        "{}={}".format, st.sampled_from(["CN", "OU", "O"]), st.from_regex(r"/?[a-z][a-z0-9_]{0,4}", fullmatch=True)
    ),
    min_size=1,
    max_size=4,
)


@pytest.mark.parametrize(
    ("grant", "standard", "cyclone", "fast"),
    [
        ("CN=/talker,OU=4f", True, True, True),
        (" CN=/talker,OU=4f\n", True, False, False),
        ("CN=/talker, OU=4f", True, False, True),
        ("OU=4f,CN=/talker", True, True, False),
        ("CN=/talker/below,OU=4f", False, True, False),
        ("CN=/talker,OU=4f,O=more", False, True, False),
        ("CN=/talker", False, False, False),
        ("cn=/talker,ou=4f", True, False, False),
        ("no name", False, False, False),
    ],
)
def test_who_takes_a_grant_for_that_of_an_identity(grant: str, standard: bool, cyclone: bool, fast: bool) -> None:
    identity = "CN=/talker,OU=4f"
    assert [each(grant, identity) for each in (same_name, parts_occur, same_text)] == [standard, cyclone, fast]


@given(RDNS)
def test_everyone_knows_the_very_name_and_the_standard_its_reverse(rdns: list[str]) -> None:
    name = ",".join(rdns)
    assert all(each(name, name) for each in (same_name, parts_occur, same_text))
    assert same_name(",".join(reversed(rdns)), name)
    assert parts_occur(",".join(reversed(rdns)), name)


@given(RDNS, RDNS)
def test_cyclone_dds_takes_a_longer_name_for_a_shorter_one(rdns: list[str], more: list[str]) -> None:
    assert parts_occur(",".join([*more, *rdns]), ",".join(rdns))


def test_cyclone_dds_has_room_for_twenty_parts() -> None:
    for count, fits in ((20, True), (21, False)):
        assert parts_occur(",".join(f"CN=p{number}" for number in range(count)), "CN=p0") is fits


@pytest.mark.parametrize(
    ("name", "known"),
    [("CN=/", True), ("OU=4f,CN=/", True), ("CN=/,OU=4f", False), ("CN=/a//b,OU=4f", False), ("CN=/a/,OU=4f", False)],
)
def test_cyclone_dds_finds_no_grant_for_a_name_with_an_empty_part(name: str, known: bool) -> None:
    """Measured with Cyclone DDS 0.10.2: "Subject name is invalid"."""
    assert parts_occur(name, name) is known
    assert same_text(name, name)


def test_on_cyclone_dds_the_root_enclave_may_take_any_grant_unless_it_has_a_name_of_its_own() -> None:
    assert parts_occur("CN=/robot/camera", "CN=/")
    assert not parts_occur("CN=/robot/camera,OU=4f", "OU=5a,CN=/")


@pytest.mark.parametrize(
    ("grant", "same"),
    [
        ("CN=/talker,OU=4f", True),
        ("OU=4f,CN=/talker", True),
        (" OU = 4f , CN = /talker ", True),
        ('OU="4f",CN=\\/talker', True),
        ("OU=4f+CN=/talker", True),
        ("CN=/talker", False),
        ("CN=/talker,OU=4f,O=more", False),
        ("CN=/talker/below,OU=4f", False),
        ("cn=/talker,ou=4f", False),
        ("CN=/talker,CN=/talker", True),
        ("no name", False),
    ],
)
def test_fast_dds_from_2_11_on_compares_attributes_in_any_order(grant: str, same: bool) -> None:
    """Equally many, and the identity has each of the grant's: a doubled one stands for one that is missing."""
    assert same_attributes(grant, "CN=/talker,OU=4f") is same


COMPARISONS = (same_name, parts_occur, same_text, same_attributes)
GRANTS = st.lists(st.sampled_from([*"abAB/ ,+=|\\\"'\t\n", "CN", "OU", "CN=", ",OU=", "/a", "é"]), max_size=12).map(
    "".join
)


@given(RDNS, st.one_of(GRANTS, st.permutations(["CN=/a", "OU=b", "O=a", "CN=/a/b"]).map(", ".join)), st.data())
@example(["CN=/talker", "OU=4f"], "OU=4f/more,CN=/talker", None)
def test_a_grant_without_all_words_of_an_identity_is_for_nobody_s(rdns: list[str], text: str, data) -> None:
    """The law by which the names of a fleet are indexed: no comparison selects a grant that lacks a word."""
    kinds = [rdn.partition("=")[0] for rdn in rdns]
    assume(len(set(kinds)) == len(kinds))
    identity = ",".join(rdns)
    grants = [text]
    if data is not None:
        separators = data.draw(st.lists(st.sampled_from([",", ", ", " ,", "+", "/", "|"]), min_size=4, max_size=4))
        parts = data.draw(st.permutations([*rdns, *data.draw(st.sampled_from([[], ["O=x"], ["CN=/z"]]))]))
        grants.append("".join(f"{part}{sep}" for part, sep in zip(parts, separators, strict=False)).rstrip(",+/| "))
    for grant in grants:
        for selects in COMPARISONS:
            if selects(grant, identity):
                assert tokens(identity) <= tokens(grant), (selects.__name__, grant, identity)
