# SPDX-License-Identifier: Apache-2.0
"""The subject name of a grant against that of an identity, as each implementation compares them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from keymint_ros2_dds.decision.subject_names import parts_occur, same_name, same_text

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
