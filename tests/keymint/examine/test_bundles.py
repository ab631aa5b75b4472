# SPDX-License-Identifier: Apache-2.0
"""What a robot takes, and the attacks of a carrier that it does not fall for."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

import pytest

from keymint.errors import KeymintError
from keymint.examine.bundles import RECORD, Acceptance, Owner, accept
from keymint.pki import certificates, keys
from keymint.robots.robot_keystore import Pending, Present
from tests.keymint.robots.conftest import AT, DAY, FILE, NONCE, Made, asked, authority, keystore, revocations, robot_key

GIVEN = Owner(frozenset({keys.fingerprint(authority().key)}))
NEW = Owner(GIVEN.authorities, new=True)


def taken(made: Made, present: Present, owner: Owner | None = None, now: datetime = AT) -> Acceptance:
    return accept(made.bundle, present, owner or Owner(), now, FILE)


def code(made: Made, present: Present, owner: Owner | None = None, now: datetime = AT) -> str:
    with pytest.raises(KeymintError) as refused:
        taken(made, present, owner, now)
    [diagnostic] = refused.value.diagnostics
    assert diagnostic.where is not None
    assert diagnostic.help
    return diagnostic.code


FIRST = Made(nonce=NONCE)
"""The answer to the first request of a robot."""
THERE = keystore(FIRST.installed())
"""A keystore that accepted it."""
NEXT = FIRST.but(nonce="", issue=6)
"""A later bundle for the same key."""


# -- what is taken ---------------------------------------------------------------------------------------------------


def test_the_answer_to_the_first_request() -> None:
    pending = asked(FIRST)
    found = taken(FIRST, keystore(pending=pending), GIVEN)
    assert found.files == {**FIRST.files, "key.pem": pending.key, RECORD: FIRST.bundle.encoded}
    assert list(found.files)[-1] == "cert.pem"
    assert (found.removed, found.answered, found.notes) == ((), True, ())


def test_a_bundle_with_its_key_for_a_new_robot() -> None:
    made = Made(with_key=True)
    found = taken(made, keystore(), NEW)
    assert found.files == {**made.files, RECORD: made.bundle.encoded}
    assert not found.answered


def test_a_second_enclave_needs_no_fingerprint() -> None:
    other = Made(name="other", key=robot_key("other"), with_key=True)
    assert taken(FIRST, keystore(pending=asked(FIRST), known=other)).answered
    assert taken(Made(with_key=True), keystore(known=other), Owner(new=True)).files


def test_a_later_bundle_needs_no_request() -> None:
    found = taken(NEXT, THERE)
    assert set(found.files) == {"bundle.json"}
    assert not found.answered
    narrowed = NEXT.but(generation=1)
    assert set(taken(narrowed, THERE).files) == {"bundle.json", "permissions.p7s"}


def test_the_same_bundle_again_changes_nothing() -> None:
    found = taken(FIRST, THERE)
    assert (found.files, found.removed) == ({}, ())
    again = taken(FIRST, keystore(FIRST.installed(), asked(FIRST)))
    assert (again.files, again.answered) == ({}, True)


def test_the_same_bundle_repairs_an_enclave() -> None:
    damaged = keystore(FIRST.installed(**{"permissions.p7s": b"", "cert.pem": FIRST.but().certificate[:-5]}))
    assert set(taken(FIRST, damaged).files) == {"permissions.p7s", "cert.pem"}


def test_a_new_key_replaces_the_old_one() -> None:
    new = FIRST.but(key=robot_key("new"), issue=7, nonce="cd" * 16)
    pending = asked(new, new.nonce)
    found = taken(new, keystore(FIRST.installed(), pending))
    assert found.files["key.pem"] == pending.key
    assert found.answered


def test_a_bundle_that_comes_between_leaves_the_request_waiting() -> None:
    pending = asked(FIRST.but(key=robot_key("new")), "cd" * 16)
    found = taken(NEXT, keystore(FIRST.installed(), pending))
    assert not found.answered
    assert "key.pem" not in found.files


def test_a_key_in_a_token_stays_there() -> None:
    pending = asked(FIRST, key=False)
    found = taken(FIRST, keystore(pending=pending), GIVEN)
    assert "key.pem" not in found.files
    files = {name: data for name, data in FIRST.installed().items() if name != "key.pem"}
    assert set(taken(NEXT, keystore(files)).files) == {"bundle.json"}


def test_a_key_that_moves_to_a_token_leaves_no_file() -> None:
    moved = FIRST.but(key=robot_key("token"), nonce="cd" * 16, issue=7)
    pending = Pending(asked(moved, moved.nonce).request)
    found = taken(moved, keystore(FIRST.installed(), pending))
    assert (found.removed, found.answered) == (("key.pem",), True)


def test_what_an_earlier_bundle_brought_is_removed() -> None:
    before = FIRST.but(more={"session.json5": b"{}"})
    files = before.installed(notes=b"mine")
    found = taken(NEXT, keystore(files))
    assert found.removed == ("session.json5",)
    [note] = found.notes
    assert (note.code, note.where and note.where.file) == ("bundle-left", "install/enclaves/robot/talker/notes")


def test_a_keystore_that_was_copied_there_first() -> None:
    files = {**FIRST.files, "key.pem": keys.to_pem(FIRST.key)}
    assert "bundle.json" in taken(NEXT, keystore(files)).files


def test_a_reissued_authority_with_the_same_key_is_the_same() -> None:
    ca = authority()
    from tests.keymint.robots.conftest import spec

    reissued = certificates.issue(spec("CN=ca", AT - 2 * DAY), ca.key.public_key(), ca.key, authority=True).certificate
    made = NEXT.but(identity=certificates.Issuer(reissued, ca.key))
    assert "identity_ca.cert.pem" in taken(made, THERE).files


# -- who it is by ----------------------------------------------------------------------------------------------------


def test_nobody_is_trusted_at_first() -> None:
    assert code(FIRST, keystore(pending=asked(FIRST))) == "bundle-authority"
    wrong = Owner(frozenset({keys.fingerprint(authority("ca2").key)}))
    assert code(FIRST, keystore(pending=asked(FIRST)), wrong) == "bundle-authority"


def test_a_bundle_of_another_authority() -> None:
    other = NEXT.but(identity=authority("ca2"))
    assert code(other, THERE) == "bundle-authority"
    assert code(other, THERE, GIVEN) == "bundle-authority"


def test_another_authority_for_rights_is_not_the_signers_to_give() -> None:
    other = NEXT.but(rights=authority("ca2"))
    assert code(other, THERE) == "bundle-authority"
    assert taken(other, THERE, Owner(frozenset({keys.fingerprint(authority("ca2").key)}))).files


def test_an_authority_in_another_form_is_not_compared_and_not_taken() -> None:
    """Some nodes prefer a reference to a token to the file beside it."""
    hidden = NEXT.but(more={"permissions_ca.cert.p11": b"pkcs11:object=foreign"})
    assert code(hidden, THERE) == "bundle-authority"
    assert code(NEXT.but(more={"other.cert.pem": b"no certificate"}), THERE) == "bundle-authority"


def test_the_authority_for_rights_signs_no_bundle() -> None:
    both = authority("rights")
    assert code(NEXT.but(identity=both), THERE) == "bundle-authority"
    beside = {"identity_ca.cert.pem": certificates.to_pem(authority().certificate)}
    assert code(NEXT.but(identity=both, more=beside), THERE) == "bundle-authority"


def test_an_authority_is_added_by_hand_only() -> None:
    added = certificates.to_pem(authority().certificate) + certificates.to_pem(authority("ca2").certificate)
    rollover = NEXT.but(more={"identity_ca.cert.pem": added})
    assert code(rollover, THERE) == "bundle-authority"
    both = Owner(frozenset({keys.fingerprint(authority("ca2").key)}))
    assert taken(rollover, THERE, both).files
    # Once it is known, it may sign.
    later = NEXT.but(identity=authority("ca2"), issue=7, more={"identity_ca.cert.pem": added}, number=1)
    assert taken(later, keystore(rollover.installed())).files
    assert taken(NEXT.but(identity=authority("ca2"), issue=8), keystore(later.installed())).files


# -- whom it is for --------------------------------------------------------------------------------------------------


def test_a_bundle_for_another_robot() -> None:
    other = FIRST.but(key=robot_key("other"))
    assert code(other, keystore(pending=asked(FIRST)), GIVEN) == "bundle-key"
    assert code(NEXT.but(key=robot_key("other")), THERE) == "bundle-key"


def test_an_enclave_that_nobody_expects() -> None:
    assert code(Made(with_key=True), keystore(), GIVEN) == "bundle-unexpected"
    assert code(Made(with_key=True), keystore(known=Made(name="other"))) == "bundle-unexpected"


def test_a_bundle_without_a_key_for_a_robot_that_has_none() -> None:
    assert code(Made(), keystore(), NEW) == "bundle-key"


def test_a_key_in_the_bundle_must_be_that_of_its_certificate() -> None:
    made = Made(more={"key.pem": keys.to_pem(robot_key("other"))})
    assert code(made, keystore(), NEW) == "bundle-key"
    # Also if the robot has the right one: nothing may stand beside a certificate that does not belong to it.
    assert code(NEXT.but(more={"key.pem": keys.to_pem(robot_key("other"))}), THERE) == "bundle-key"


# -- replay ----------------------------------------------------------------------------------------------------------


def test_the_answer_to_another_request() -> None:
    replayed = FIRST.but(nonce="ab" * 16)
    assert code(replayed, keystore(pending=asked(FIRST)), GIVEN) == "bundle-nonce"
    assert code(FIRST.but(nonce=""), keystore(pending=asked(FIRST)), GIVEN) == "bundle-nonce"
    assert code(replayed.but(issue=9), THERE) == "bundle-nonce"


def test_an_old_answer_after_the_keystore_was_wiped() -> None:
    """The key is in a token, so the old answer fits it; the nonce does not."""
    assert code(FIRST, keystore(pending=asked(FIRST, "ef" * 16, key=False)), GIVEN) == "bundle-nonce"
    assert code(FIRST, keystore(), NEW) == "bundle-nonce"


def test_an_answer_whose_request_nobody_knows_any_more() -> None:
    files = {**FIRST.files, "key.pem": keys.to_pem(FIRST.key)}
    assert code(FIRST, keystore(files)) == "bundle-nonce"


BACK: dict[str, Callable[[Made], Made]] = {
    "issue": lambda made: made.but(issue=4),
    "the same issue with other content": lambda made: made.but(generation=3),
    "generation": lambda made: made.but(issue=6, generation=1),
    "revocation list": lambda made: made.but(issue=6, number=2),
    "no revocation list": lambda made: made.but(issue=6, number=0),
}


@pytest.mark.parametrize("what", BACK)
def test_no_number_goes_back(what: str) -> None:
    there = FIRST.but(generation=2)
    later = there.but(nonce="")
    assert taken(later.but(issue=6), keystore(there.installed())).files
    assert code(BACK[what](later), keystore(there.installed())) == "bundle-outdated"


def test_the_number_of_the_list_is_that_of_the_manifest() -> None:
    made = NEXT.but(number=9, more={"crl.pem": revocations(authority(), 3)})
    assert code(made, THERE) == "bundle-outdated"


def test_an_old_bundle_for_a_keystore_that_was_copied_there() -> None:
    later = FIRST.but(begin=AT - DAY / 2)
    files = {**later.files, "key.pem": keys.to_pem(FIRST.key)}
    assert code(NEXT, keystore(files)) == "bundle-outdated"
    listed = {**FIRST.files, "crl.pem": revocations(authority(), 4), "key.pem": keys.to_pem(FIRST.key)}
    assert code(NEXT, keystore(listed)) == "bundle-outdated"


def test_a_damaged_record_is_an_error() -> None:
    with pytest.raises(KeymintError) as refused:
        taken(NEXT, keystore(FIRST.installed(**{RECORD: b"{}"})))
    where = refused.value.diagnostics[0].where
    assert refused.value.diagnostics[0].code == "bundle-record"
    assert where is not None
    assert where.file == "install/enclaves/robot/talker/bundle.json"
