# SPDX-License-Identifier: Apache-2.0
"""A carrier who has every bundle that was ever made, and delivers what he likes, altered as he likes, in any order."""

from __future__ import annotations

from collections.abc import Mapping

import hypothesis
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from keymint.errors import KeymintError
from keymint.examine.bundles import RECORD, Owner, accept
from keymint.pki import keys
from keymint.robots import bundle
from keymint.robots.bundle import load
from tests.effort import FULL

from .conftest import AT, FILE, NONCE, Made, asked, authority, keystore, robot_key

FIRST = Made(nonce=NONCE, issue=1, number=1)
OWN = [
    FIRST,
    FIRST.but(nonce="", issue=2, generation=1, number=1),
    FIRST.but(nonce="", issue=3, generation=1, number=2),
    FIRST.but(nonce="", issue=4, generation=2, number=3),
    FIRST.but(nonce="", issue=5, generation=2, number=3, more={"permissions.p7s": b"narrow"}),
]
"""What the authority made for the robot, in this order."""
OTHERS = [
    FIRST.but(key=robot_key("other"), nonce="ab" * 16, issue=9),
    FIRST.but(name="robot/other", key=robot_key("other"), with_key=True, nonce=""),
    FIRST.but(identity=authority("foreign"), nonce="", issue=9),
    FIRST.but(rights=authority("foreign"), nonce="", issue=9, number=9),
    FIRST.but(nonce="cd" * 16, issue=9),
]
"""What the robot must not take: for other robots, by other authorities or with one, for another request."""
PACKED = [made.packed for made in (*OWN, *OTHERS)]
MEMBERS = [dict(bundle.unpack(packed, FILE)) for packed in PACKED]
NAMES = sorted({name for members in MEMBERS for name in members})
NUMBERS = st.integers(0, len(PACKED) - 1)


class Carrier(RuleBasedStateMachine):
    """Delivers bundles to one robot, whose owner gave the fingerprint of the authority at first."""

    def __init__(self) -> None:
        super().__init__()
        self.files: Mapping[str, bytes] = {}
        self.waits = True
        self.accepted: list[int] = []

    def _deliver(self, packed: bytes) -> bool:
        present = keystore(self.files, asked(FIRST) if self.waits else None)
        owner = Owner(frozenset() if self.accepted else frozenset({keys.fingerprint(authority().key)}))
        try:
            read = bundle.read(packed, FILE)
            if read.manifest.name != FIRST.name:  # there is nothing of another enclave
                present = keystore(known=FIRST if self.accepted else None)
            found = accept(read, present, owner, AT, FILE)
        except KeymintError:
            return False
        kept = {name: data for name, data in self.files.items() if name not in found.removed}
        self.files = {**kept, **found.files}
        self.waits = self.waits and not found.answered
        self.accepted.append(load(self.files[RECORD], FILE).issue)
        return True

    @rule(number=NUMBERS)
    def deliver(self, number: int) -> None:
        """Deliver a bundle as it was made."""
        took = self._deliver(PACKED[number])
        assert not took or number < len(OWN)

    @rule(number=NUMBERS, other=NUMBERS, names=st.sets(st.sampled_from(NAMES), min_size=1, max_size=4))
    def mix(self, number: int, other: int, names: set[str]) -> None:
        """Deliver a bundle with files of another one."""
        taken = {name: data for name, data in MEMBERS[other].items() if name in names}
        mixed = {name: data for name, data in MEMBERS[number].items() if name not in names} | taken
        took = self._deliver(bundle.pack(mixed))
        assert not took or mixed in MEMBERS[: len(OWN)]

    @rule(number=NUMBERS, at=st.integers(0, 10_000), bit=st.integers(0, 7))
    def flip(self, number: int, at: int, bit: int) -> None:
        """Deliver a bundle with one altered bit."""
        altered = bytearray(PACKED[number])
        altered[at % len(altered)] ^= 1 << bit
        assert not self._deliver(bytes(altered))

    @rule(number=NUMBERS, end=st.integers(0, 20_000))
    def cut(self, number: int, end: int) -> None:
        """Deliver the beginning of a bundle."""
        packed = PACKED[number]
        assert not self._deliver(packed[: end % len(packed)])

    @invariant()
    def the_enclave_is_what_the_authority_made(self) -> None:
        """Check the files, the key and the numbers."""
        assert self.accepted == sorted(self.accepted)
        if self.accepted:
            made = OWN[self.accepted[-1] - 1]
            assert dict(self.files) == made.installed()


def test_whatever_a_carrier_does_the_enclave_is_whole_and_never_goes_back() -> None:
    examples, steps = (400, 60) if FULL else (20, 25)
    settings = hypothesis.settings(max_examples=examples, stateful_step_count=steps, deadline=None)
    run_state_machine_as_test(Carrier, settings=settings)


def test_in_order_all_of_them_are_taken() -> None:
    carrier = Carrier()
    for number in range(len(OWN)):
        carrier.deliver(number)
        carrier.the_enclave_is_what_the_authority_made()
    assert carrier.accepted == [1, 2, 3, 4, 5]
