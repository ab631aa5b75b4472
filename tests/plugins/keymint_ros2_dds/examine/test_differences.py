# SPDX-License-Identifier: Apache-2.0
"""An enclave vouches for nothing: only what rests on the workspace's authorities is proven."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from itertools import chain, combinations

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.enclave_proof import prove

from keymint.api import EnclaveFiles, KeySpec, Proof, ProofTask
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from tests.plugins.keymint_ros2_dds.enclaves import NOW, anchors, authority, installed, revoking
from tests.plugins.keymint_ros2_dds.packages import package, rule

PLAIN = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
OURS = installed(PLAIN)
THEIRS = installed(PLAIN, identity="stranger", permissions="strangers_notary")
"""The same enclave, made by someone else: sound in itself."""
SIGNIFICANT = sorted(OURS.keys() - {"permissions.xml"})
SUBSETS = list(chain.from_iterable(combinations(SIGNIFICANT, size) for size in range(1, len(SIGNIFICANT) + 1)))


def claims(files, wanted=None):
    return prove(ProofTask(
        PLAIN, PLAIN.grant.rules, EnclaveFiles(files, "install/talker", wanted or anchors(PLAIN)), 10_000, lambda: True,
    ))  # fmt: skip


def refused(files, wanted=None) -> set[tuple[str, str]]:
    """Return the codes of the findings and the files that they are about."""
    with pytest.raises(KeymintError) as caught:
        claims(files, wanted)
    return {(each.code, each.where.file.rpartition("/")[2]) for each in caught.value.diagnostics if each.where}


def test_what_rests_on_the_workspace_is_proven():
    assert {claim.proof for claim in claims(OURS)} == {Proof.PROVEN}
    assert not build_type.prover.differences(EnclaveFiles(OURS, "install/talker", anchors(PLAIN)))


def test_an_enclave_that_is_wholly_someone_elses():
    assert refused(THEIRS) == {
        ("authority-differs", "identity_ca.cert.pem"),
        ("authority-differs", "permissions_ca.cert.pem"),
        ("chain-incomplete", "cert.pem"),
        ("smime-signer", "permissions.p7s"),
        ("smime-signer", "governance.p7s"),
    }


def test_every_mixture_with_someone_elses_enclave_is_refused():
    assert len(SUBSETS) == 2 ** len(SIGNIFICANT) - 1
    for names in SUBSETS:
        found = refused({**OURS, **{name: THEIRS[name] for name in names}})
        seen = {name for _, name in found}
        # A strange key is told apart by the certificate beside it, which is the finding then.
        assert seen - {"cert.pem", "key.pem"} == set(names) - {"cert.pem", "key.pem"}, names
        assert bool({"cert.pem", "key.pem"} & set(names)) == bool(seen & {"cert.pem", "key.pem"}), names


@pytest.mark.parametrize("role", ["identity_ca", "permissions_ca"])
def test_an_authority_of_the_same_name_with_another_key(role):
    namesake = authority.__wrapped__(role)
    found = refused(OURS, anchors(PLAIN, **{role: namesake.pem}))
    assert ("authority-differs", f"{role}.cert.pem") in found
    assert any(code in {"chain-signature", "smime-signer"} for code, _ in found)


@pytest.mark.parametrize("role", ["identity_ca", "permissions_ca"])
@pytest.mark.parametrize(("chain_", "code"), [(b"", "authority-missing"), (b"nonsense", "certificate-invalid")])
def test_a_workspace_without_its_authority_claims_nothing(role, chain_, code):
    wanted = anchors(PLAIN, **{role: chain_})
    assert refused(OURS, wanted) == {(code, f"{role}.cert.pem")}


@pytest.mark.parametrize("missing", [name for name in SIGNIFICANT if name != "key.pem"])
def test_a_file_that_is_missing(missing):
    files = {name: content for name, content in OURS.items() if name != missing}
    assert refused(files) == {("file-missing", missing)}


def test_a_key_that_is_kept_elsewhere_or_encrypted_is_no_part_of_the_claim():
    without = {name: content for name, content in OURS.items() if name != "key.pem"}
    assert refused(without) == {("file-missing", "key.pem")}
    public = keys.public_to_pem(keys.from_pem(OURS["key.pem"]).public_key())
    assert {claim.proof for claim in claims(without, replace(anchors(PLAIN), public_key=public))} == {Proof.PROVEN}
    encrypted = keys.to_pem(keys.from_pem(OURS["key.pem"]), b"secret")
    assert {claim.proof for claim in claims({**OURS, "key.pem": encrypted})} == {Proof.PROVEN}
    other = keys.to_pem(keys.generate(KeySpec("ec", "SECP256R1")))
    assert refused({**OURS, "key.pem": other}) == {("key-mismatch", "key.pem")}


def test_the_identity_of_another_subject():
    wanted = replace(anchors(PLAIN), subject_name="CN=/listener")
    assert refused(OURS, wanted) == {("certificate-subject", "cert.pem")}


def test_an_authority_that_the_layout_does_not_have_counts_as_well():
    strange = {**OURS, "ca.cert.pem": authority("stranger").pem}
    assert refused(strange) == {("authority-differs", "ca.cert.pem")}


def test_the_flat_layout_has_one_authority():
    files = installed(PLAIN, layout="flat", identity="one_ca", permissions="one_ca")
    one = authority("one_ca").pem
    wanted = anchors(PLAIN, layout="flat", identity_ca=one, permissions_ca=one)
    assert {claim.proof for claim in claims(files, wanted)} == {Proof.PROVEN}
    assert refused({**files, "ca.cert.pem": authority("stranger").pem}, wanted) == {
        ("authority-differs", "ca.cert.pem")
    }


@pytest.mark.parametrize("name", ["identity_ca.cert", "permissions_ca.cert", "cert", "key"])
def test_a_file_that_ros_2_reads_in_place_of_another_one(name):
    """rmw_dds_common from Jazzy on prefers ``*.p11`` to ``*.pem``; what is in the token is not known."""
    assert refused({**OURS, f"{name}.p11": b"pkcs11:object=other;type=cert"}) == {("file-replaced", f"{name}.p11")}


@pytest.mark.parametrize(
    "made",
    [
        lambda _own: b"garbage",
        lambda _own: authority("identity_ca").pem,
        lambda _own: revoking("stranger", 7),
        lambda own: revoking("identity_ca", own),
    ],
    ids=["garbage", "a certificate", "a stranger's", "revokes the identity"],
)
def test_a_revocation_list_for_which_vendors_refuse_the_participant(made):
    own = certificates.load(OURS["cert.pem"]).serial_number
    assert refused({**OURS, "crl.pem": made(own)}) == {("revocation-list", "crl.pem")}


def test_a_revocation_list_of_others_takes_nothing_from_the_enclave():
    assert {claim.proof for claim in claims({**OURS, "crl.pem": revoking("identity_ca", 7)})} == {Proof.PROVEN}


def test_a_revocation_list_is_in_force_for_a_time():
    """Cyclone DDS and Fast DDS refuse the participant when the list has expired."""
    files = {**OURS, "crl.pem": revoking("identity_ca", 7)}
    terms = build_type.prover.terms(EnclaveFiles(files, "install/talker", anchors(PLAIN)))
    found = [term for term in terms if term.where.file == "install/talker/crl.pem"]
    assert [(term.code, term.periods) for term in found] == [
        ("revocation-list", ((NOW - timedelta(days=1), NOW + timedelta(days=60)),)),
    ]
