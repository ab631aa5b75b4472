# SPDX-License-Identifier: Apache-2.0
"""Claims about enclaves: what is installed is proven, and what is broken gets the right shortest counterexample."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds import build_type, enclave_proof
from keymint_ros2_dds.decision import semantics
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.proving.claims import prove_content, prove_document
from keymint_ros2_dds.proving.questions import ProofQuestion
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.transports.enclave_files import subject_name

from comarmor.errors import Origin
from keymint.api import BuildOptions, ComparisonTask, DomainRange, EnclaveFiles, Proof, ProofTask
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import DENIED, PARTITIONS, rules
from tests.plugins.keymint_ros2_dds.enclaves import anchors, authority, installed
from tests.plugins.keymint_ros2_dds.oracles import policy as oracle
from tests.plugins.keymint_ros2_dds.packages import DOMAIN, package, rule

MODELS = ("omg", "cyclonedds-0.10", "fastdds-2.11")
PLAIN = package(
    rule("ALLOW", "ros_topic", "ros_publish", "/chatter", "/camera/*", line=3),
    rule("DENY", "ros_topic", "ros_publish ros_subscribe", "/camera/private", line=4),
    rule("ALLOW", "ros_topic", "ros_subscribe", "/clock", line=5),
    rule("ALLOW", "ros_service", "ros_call", "/add", line=6),
)


def sign(content: bytes) -> bytes:
    ca = authority("permissions_ca")
    return smime.sign(content, ca.certificate, ca.key)


def obligation(loaded, files, **fields):
    given_ = {
        "package": loaded, "rules": loaded.grant.rules,
        "enclave": EnclaveFiles(files, "install/talker", anchors(loaded)),
        "states": 200_000, "go_on": lambda: True,
    }  # fmt: skip
    return ProofTask(**{**given_, **fields})


def claims(loaded, files, **fields):
    return build_type.prover.prove(obligation(loaded, files, **fields))


def after(loaded, old: str, new: str, count: int = -1, **fields):
    """Return the claims about an enclave whose document has a text replaced, signed again."""
    files = installed(loaded)
    content = files["permissions.xml"].decode()
    assert old in content, content
    files["permissions.p7s"] = sign(content.replace(old, new, count).encode())
    return claims(loaded, files, **fields)


def refuted(found):
    """Return the counterexamples by model and action, as (topic, partitions, policy, document)."""
    return {
        (claim.model, claim.action): (
            claim.counterexample.endpoint.name,
            claim.counterexample.endpoint.partitions,
            claim.counterexample.policy.allowed,
            claim.counterexample.document.allowed,
        )
        for claim in found
        if claim.proof is Proof.COUNTEREXAMPLE
    }


def test_what_is_installed_is_proven_for_every_model():
    found = claims(PLAIN, installed(PLAIN))
    assert {claim.proof for claim in found} == {Proof.PROVEN}
    assert [(claim.model, claim.action) for claim in found] == [
        (model, action) for model in MODELS for action in ("publish", "subscribe")
    ]
    assert all(claim.domains == DOMAIN for claim in found)
    assert set(build_type.prover.assumptions()) == set(semantics.VARIATIONS)
    assert list(build_type.models("jazzy")) == list(MODELS)


@settings(max_examples=tries(30, 60), deadline=None)
@given(
    st.lists(st.one_of(rules(), rules(), rules(PARTITIONS), rules(DENIED)), min_size=1, max_size=5),
    st.sampled_from(["humble", "jazzy", "kilted", "lyrical"]),
)
def test_what_the_compiler_does_not_refuse_is_proven_for_what_the_distribution_ships(drawn, distro):
    loaded = replace(package(*drawn), distro=distro)
    try:
        content = build_type.build(loaded, BuildOptions()).documents["permissions.xml"]
    except KeymintError:
        return
    files = {**ENCLAVE, "permissions.p7s": sign(content)}
    found = claims(loaded, files)
    assert {claim.proof for claim in found} == {Proof.PROVEN}
    assert {claim.model for claim in found} == set(semantics.shipped_models(distro))


@settings(max_examples=tries(30, 60), deadline=None)
@given(st.lists(rules(), min_size=1, max_size=4), st.lists(rules(), min_size=1, max_size=4))
def test_a_document_of_another_policy_is_refuted_where_a_name_tells_them_apart(drawn, other):
    loaded, wrong = package(*drawn), package(*other)
    try:
        content = build_type.build(wrong, BuildOptions()).documents["permissions.xml"]
    except KeymintError:
        return
    for claim in claims(loaded, {**ENCLAVE, "permissions.p7s": sign(content)}):
        names = ("rt/a", "rt/b", "rt/ab", "rt/", "x", "rt", "rq/aRequest", "rr/aReply")

        def differ(name: str, action: str = claim.action) -> bool:
            told, said = loaded.grant.rules, wrong.grant.rules
            return oracle(told, action, name, ()) != oracle(said, action, name, ())

        if claim.proof is Proof.PROVEN:
            assert not any(map(differ, names))
        else:
            assert claim.counterexample is not None
            found = claim.counterexample.endpoint.name
            assert differ(found)
            assert all(len(name) >= len(found) for name in names if differ(name))


ENCLAVE = installed(PLAIN)


def test_a_name_that_is_missing():
    found = after(PLAIN, "<topic>rt/chatter</topic>", "")
    assert refuted(found) == {(model, "publish"): ("rt/chatter", (), True, False) for model in MODELS}
    example = found[0].counterexample
    assert example is not None
    assert str(example.policy.where) == "policy.xml:3"
    assert example.meaning is not None
    assert (example.meaning.object.kind, example.meaning.object.name) == ("ros_topic", "/chatter")


def test_a_glob_that_is_too_wide_and_the_line_that_is():
    files = installed(PLAIN)
    content = files["permissions.xml"].decode().replace("rt/clock", "rt/cloc?")
    files["permissions.p7s"] = sign(content.encode())
    found = claims(PLAIN, files)
    assert refuted(found) == {(model, "subscribe"): ("rt/cloca", (), False, True) for model in MODELS}
    example = found[1].counterexample
    assert example is not None
    signed = files["permissions.p7s"].decode().splitlines()
    place = max(at for at, line in enumerate(signed[: _line(signed, "rt/cloc?")]) if "<subscribe>" in line) + 1
    assert str(example.document.where) == f"install/talker/permissions.p7s:{place}", (
        "the line of the file that is named"
    )


def _line(lines: list[str], text: str) -> int:
    return next(at for at, line in enumerate(lines) if text in line)


def test_a_denial_that_is_dropped():
    files = installed(PLAIN)
    before, _, rest = files["permissions.xml"].decode().partition("<deny_rule>")
    files["permissions.p7s"] = sign((before + rest.partition("</deny_rule>")[2]).encode())
    found = claims(PLAIN, files)
    assert refuted(found)["omg", "publish"] == ("rt/camera/private", (), False, True)
    example = found[0].counterexample
    assert example is not None
    assert str(example.policy.where) == "policy.xml:4"


@pytest.mark.parametrize(
    ("old", "new", "action", "name"),
    [
        ("rt/chatter", "rt/Chatter", "publish", {"rt/chatter", "rt/Chatter"}),
        ("rq/addRequest", "rq/addReques", "publish", {"rq/addReques"}),
        ("rr/addReply", "rt/addReply", "subscribe", {"rr/addReply", "rt/addReply"}),
        ("rt/camera/*", "rt*/camera/*", "publish", {"rtx/camera/", "rta/camera/", "rt//camera/", "rtb/camera/"}),
        ("rt/camera/*", "rt/camera/?*", "publish", {"rt/camera/"}),
    ],
)
def test_wrong_names_are_found_with_a_shortest_one(old, new, action, name):
    found = refuted(after(PLAIN, old, new))
    assert found
    for (_, asked), (topic, *_) in found.items():
        assert asked == action
        assert len(topic) == len(min(name, key=len))
        assert topic in name or old == "rt/camera/*"


def test_the_topic_check_of_cyclone_is_part_of_its_model():
    loaded = package(
        rule("DENY", "ros_topic", "ros_subscribe", "/x", line=3),
        rule("ALLOW", "ros_topic", "ros_subscribe", "/*", line=4),
        rule("ALLOW", "ros_topic", "ros_publish", "/x", line=5),
    )
    files = installed(loaded)
    content = files["permissions.xml"].decode()
    head, rest = content.split("<allow_rule>", 1)
    body, tail = rest.split("</grant>", 1)
    parts = ["<allow_rule>" + each for each in body.replace("<default>DENY</default>", "").split("<allow_rule>")]
    first, *later = parts
    # What Keymint says first, because of that check, is said last.
    moved = head + "".join(later) + first
    denial = moved.find("<deny_rule>")
    if denial < 0 or denial > moved.find("<allow_rule>"):
        start, end = moved.find("<deny_rule>"), moved.find("</deny_rule>") + len("</deny_rule>")
        moved = head + moved[start:end] + moved[len(head) : start] + moved[end:]
    files["permissions.p7s"] = sign((moved + "<default>DENY</default></grant>" + tail).encode())
    found = claims(loaded, files)
    assert refuted(found) == {("cyclonedds-0.10", "publish"): ("rt/x", (), True, False)}
    example = next(claim.counterexample for claim in found if claim.counterexample)
    assert "topic-check" in example.document.deviation


def test_partitions_and_topics_that_a_vendor_pools():
    loaded = package(
        rule("ALLOW", "topic", "publish", "bar", partitions=("foo",), line=3),
        rule("ALLOW", "topic", "publish", "spam", partitions=("baz",), line=4),
    )
    files = installed(loaded)
    assert {claim.proof for claim in claims(loaded, files)} == {Proof.PROVEN}
    content = files["permissions.xml"].decode()
    between = content[content.index("</publish>") + len("</publish>") :]
    between = between[: between.index("<publish>")]
    files["permissions.p7s"] = sign(content.replace(between, "", 1).encode())
    found = refuted(claims(loaded, files))
    assert set(found) == {("fastdds-2.11", "publish")}
    assert found["fastdds-2.11", "publish"][:2] in {("bar", ("baz",)), ("spam", ("foo",))}


def test_a_partition_that_is_missing():
    loaded = package(rule("ALLOW", "topic", "publish", "bar", partitions=("p", "q")))
    found = refuted(after(loaded, "<partition>q</partition>", ""))
    assert found == {(model, "publish"): ("bar", ("q",), True, False) for model in MODELS}


def test_domains_where_the_policy_does_not_hold():
    found = after(PLAIN, "<id>0</id>", "<id_range><min>0</min><max>3</max></id_range>")
    outside = [claim for claim in found if claim.proof is Proof.COUNTEREXAMPLE]
    assert {claim.model for claim in outside} == {"omg", "cyclonedds-0.10"}
    assert {claim.domains for claim in outside} == {(DomainRange(1, 3),)}
    assert all(claim.counterexample and claim.counterexample.endpoint.domain == 1 for claim in outside)
    inside = [claim for claim in found if claim.domains == DOMAIN]
    assert {claim.proof for claim in inside} == {Proof.PROVEN}


def test_a_document_that_a_vendor_refuses_permits_nothing():
    found = after(PLAIN, "<id>0</id>", "<id>0</id><id>231</id>")
    example = next(claim.counterexample for claim in found if claim.model == "cyclonedds-0.10")
    assert example is not None
    assert "refuses" in example.document.reason


def test_a_grant_of_another_subject_permits_nothing():
    found = after(PLAIN, "CN=/talker", "CN=/other")
    assert len(refuted(found)) == 2 * len(MODELS)
    example = found[0].counterexample
    assert example is not None
    assert "no grant applies to" in example.document.reason


def test_a_grant_that_is_never_valid_for_one_vendor():
    found = after(PLAIN, END, "2300-01-01T00:00:00")
    assert {claim.model for claim in found if claim.proof is not Proof.PROVEN} == {"cyclonedds-0.10"}
    example = next(claim.counterexample for claim in found if claim.counterexample)
    assert "is never valid" in example.document.reason
    assert example.document.where.line


def test_default_allow_permits_every_name_but_on_fast_dds():
    found = refuted(after(PLAIN, "<default>DENY", "<default>ALLOW"))
    assert found["omg", "publish"] == ("a", (), False, True), "no topic has an empty name"
    assert ("fastdds-2.11", "publish") not in found


def test_an_expression_that_means_nothing_is_unknown():
    found = after(PLAIN, "rt/chatter", "rt/[[:nothing:]]")
    assert {claim.model for claim in found if claim.proof is Proof.UNKNOWN} == {"omg", "fastdds-2.11"}
    assert all(claim.reason for claim in found if claim.proof is Proof.UNKNOWN)


def test_a_spent_budget_is_unknown():
    found = after(PLAIN, "rt/camera/*", "rt/camera/?*", states=1)
    assert {(claim.proof, claim.spent) for claim in found if claim.action == "publish"} == {(Proof.UNKNOWN, True)}


@pytest.mark.parametrize("models", [None, (), ("fastdds-2.11",), ("cyclonedds-0.10", "omg")])
def test_only_the_models_that_are_asked_for(models):
    task, governance, _ = enclave_proof.question(obligation(PLAIN, ENCLAVE))
    found = prove_content(task, models=models, governance=governance)
    assert list(dict.fromkeys(claim.model for claim in found)) == list(MODELS if models is None else models)


def test_only_the_standard_is_claimed_if_deviations_are_accepted():
    found = enclave_proof.prove(obligation(PLAIN, ENCLAVE, standard_only=True))
    assert {claim.model for claim in found} == {"omg"}


@pytest.mark.parametrize(("old", "new"), [("", ""), ("rt/camera/*", "rt/camera/?*")])
def test_a_document_that_is_not_signed_yet(old, new):
    content = ENCLAVE["permissions.xml"].decode().replace(old, new).encode()
    rules = PLAIN.grant.rules
    name = subject_name(ENCLAVE["cert.pem"], Origin("cert.pem"))
    held = ComparisonTask(
        content, "permissions.xml", 0, name, rules, PLAIN.distro, PLAIN.grant.domains, 200_000, lambda: True
    )
    question = ProofQuestion(signed_permissions.read(content), held, lower(rules, PLAIN.distro))
    found = prove_document(question)
    signed = enclave_proof.prove(
        obligation(PLAIN, {**ENCLAVE, "permissions.xml": content, "permissions.p7s": sign(content)})
    )
    assert [(claim.model, claim.action, claim.proof) for claim in found] == [
        (claim.model, claim.action, claim.proof) for claim in signed
    ]
    assert all(claim.proof is Proof.PROVEN for claim in found) == (not old)


@pytest.mark.parametrize("missing", ["permissions.p7s", "cert.pem", "permissions_ca.cert.pem"])
def test_a_file_that_is_missing(missing):
    files = {name: content for name, content in ENCLAVE.items() if name != missing}
    with pytest.raises(KeymintError, match="missing"):
        claims(PLAIN, files)


def test_a_signature_that_does_not_hold():
    signed = ENCLAVE["permissions.p7s"].replace(b"rt/chatter", b"rt/chattex")
    with pytest.raises(KeymintError):
        claims(PLAIN, {**ENCLAVE, "permissions.p7s": signed})


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
@pytest.mark.parametrize("altered", [False, True])
def test_a_document_that_openssl_signed_is_read_as_vendors_do(tmp_path, altered):
    ca = authority("permissions_ca")
    (tmp_path / "ca.pem").write_bytes(certificates.to_pem(ca.certificate))
    (tmp_path / "key.pem").write_bytes(keys.to_pem(ca.key))
    (tmp_path / "in.xml").write_bytes(ENCLAVE["permissions.xml"].replace(b"rt/chatter", b"rt/chatte"))
    arguments = ("-text", "-in", "in.xml", "-out", "out.p7s", "-signer", "ca.pem", "-inkey", "key.pem")
    subprocess.run(["openssl", "smime", "-sign", *arguments], cwd=tmp_path, check=True, capture_output=True)
    signed = (tmp_path / "out.p7s").read_bytes()
    lines = signed.decode().splitlines()
    if altered:
        with pytest.raises(KeymintError):
            claims(PLAIN, {**ENCLAVE, "permissions.p7s": signed.replace(b"rt/chatte<", b"rt/chattX<")})
    else:
        found = claims(PLAIN, {**ENCLAVE, "permissions.p7s": signed})
        assert refuted(found)["omg", "publish"] == ("rt/chatte", (), False, True)
        example = found[0].counterexample
        assert example is not None
        criteria = max(at for at in range(_line(lines, "rt/chatte")) if "<publish>" in lines[at]) + 1
        assert str(example.document.where).endswith(f"permissions.p7s:{criteria}")


@pytest.mark.parametrize(
    ("old", "new", "proofs"),
    [
        ("<publish>", "<publish><!-- c -->", (Proof.PROVEN, Proof.PROVEN, Proof.PROVEN)),
        ("rt/chatter", "rt/<!-- -->chatter", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("rt/chatter", "<!-- -->rt/chatter", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("rt/chatter", "rt/<![CDATA[chatter]]>", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("rt/chatter", "rt/&#99;hatter", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<publish>", "<?a b?><publish>", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("rt/chatter", "rt/<?a b?>chatter", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<?xml", "\ufeff<?xml", (Proof.PROVEN, Proof.COUNTEREXAMPLE, Proof.PROVEN)),
        ("</topic>", "</topic >", (Proof.PROVEN, Proof.COUNTEREXAMPLE, Proof.PROVEN)),
        ("<publish>", '<publish a="b">', (Proof.COUNTEREXAMPLE, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<publish>", "<foo/><publish>", (Proof.COUNTEREXAMPLE, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<permissions>", "<permissions/><permissions>", (Proof.COUNTEREXAMPLE, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<id>0</id>", "<id>00</id>", (Proof.PROVEN, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<id>0</id>", "<id>4294967296</id>", (Proof.COUNTEREXAMPLE, Proof.UNKNOWN, Proof.UNKNOWN)),
        ("<id>0</id>", "<id>08</id>", (Proof.COUNTEREXAMPLE, Proof.UNKNOWN, Proof.UNKNOWN)),
    ],
)
def test_documents_that_vendors_read_differently(old, new, proofs):
    found = {claim.model: claim for claim in after(PLAIN, old, new, 1) if claim.action == "publish"}
    assert tuple(found[model].proof for model in MODELS) == proofs
    assert all(claim.reason for claim in found.values() if claim.proof is Proof.UNKNOWN)


def test_a_domain_that_one_vendor_reads_as_octal():
    found = [claim for claim in after(PLAIN, "<id>0</id>", "<id>0</id><id>010</id>") if claim.action == "publish"]
    wrong = {claim.model: claim.domains for claim in found if claim.proof is Proof.COUNTEREXAMPLE}
    assert wrong == {"omg": (DomainRange(10, 10),)}
    assert {claim.proof for claim in found if claim.model == "cyclonedds-0.10"} == {Proof.UNKNOWN}


def test_rules_after_the_default_that_one_vendor_does_not_look_at():
    content = ENCLAVE["permissions.xml"].decode().replace("<default>DENY</default>", "")
    content = content.replace("</validity>", "</validity><default>DENY</default>")
    found = claims(PLAIN, {**ENCLAVE, "permissions.p7s": sign(content.encode())})
    assert {claim.model: claim.proof for claim in found} == dict(
        zip(MODELS, (Proof.COUNTEREXAMPLE, Proof.UNKNOWN, Proof.UNKNOWN), strict=True)
    )


def test_no_name_of_ros_is_told_where_there_is_none():
    found = after(PLAIN, "rt/camera/*", "rt/camera/?*")
    example = found[0].counterexample
    assert example is not None
    assert (example.endpoint.name, example.meaning) == ("rt/camera/", None)


def test_of_the_shortest_names_one_of_ros_is_preferred():
    example = after(PLAIN, "rt/clock", "rt/[!a-bd-z]lock")[1].counterexample
    assert example is not None
    assert example.meaning is not None
    assert example.meaning.object.name in {"/_lock", "/Alock"}


def several(*changes):
    """Return the claims about a document with a grant for each list of replacements, in this order."""
    content = ENCLAVE["permissions.xml"].decode()
    start, end = content.index("<grant"), content.index("</grant>") + len("</grant>")
    grants = []
    for replaced in changes:
        own = content[start:end]
        for old, new in replaced:
            assert old in own
            own = own.replace(old, new)
        grants.append(own)
    return claims(
        PLAIN, {**ENCLAVE, "permissions.p7s": sign((content[:start] + "".join(grants) + content[end:]).encode())}
    )


def validity():
    content = ENCLAVE["permissions.xml"].decode()
    return tuple(content.partition(f"<{name}>")[2].partition("</")[0] for name in ("not_before", "not_after"))


BEGIN, END = validity()
WIDER = ("rt/chatter", "rt/*")
PAST = ((BEGIN, "2001-01-01T00:00:00"), (END, "2002-01-01T00:00:00"))
FUTURE = ((BEGIN, "2101-01-01T00:00:00"), (END, "2102-01-01T00:00:00"))
OVERLAPPING = ((END, "2102-01-01T00:00:00"),)


@pytest.mark.parametrize(
    ("grants", "wrong", "when"),
    [
        (((), (WIDER, *FUTURE)), ("omg", "fastdds-2.11"), "from 2101-01-01T00:00:00 to 2102-01-01T00:00:00"),
        (((), (WIDER, *OVERLAPPING)), ("omg", "fastdds-2.11"), "to 2102-01-01T00:00:00"),
        (((WIDER, *PAST), ()), MODELS, "from 2001-01-01T00:00:00 to 2002-01-01T00:00:00"),
        (((), (WIDER,)), (), ""),
        (((), PAST), (), ""),
        ((PAST, ()), (), ""),
        (((WIDER, ("CN=/talker", "CN=/other")), ()), (), ""),
        (((WIDER, (BEGIN, "2002-01-01T00:00:00"), (END, "2001-01-01T00:00:00")), ()), ("cyclonedds-0.10",), ""),
    ],
    ids=["a wider one later", "a wider one that lasts longer", "a wider one before", "a second one that never counts",
         "an equal one before", "an equal one that comes first", "of another subject", "a first one that never holds"],
)  # fmt: skip
def test_several_grants_hold_whenever_one_is_in_force(grants, wrong, when):
    found = several(*grants)
    assert {claim.model for claim in found if claim.proof is not Proof.PROVEN} == set(wrong)
    for claim in found:
        if claim.counterexample and claim.model != "cyclonedds-0.10":
            assert when in claim.counterexample.document.reason


def test_the_time_is_told_only_where_it_matters():
    found = after(PLAIN, "rt/chatter", "rt/*")
    assert not any("in force" in claim.counterexample.document.reason for claim in found if claim.counterexample)


def test_a_default_that_allows_does_so_in_every_partition():
    """A policy allows the default partition, unless it names others."""
    everything = package(rule("ALLOW", "topic", "publish subscribe", "*"))
    found = refuted(
        claim
        for claim in after(everything, "<default>DENY</default>", "<default>ALLOW</default>")
        if claim.domains == DOMAIN
    )
    assert {key for key, (_, partitions, policy, document) in found.items() if partitions and document > policy} == {
        (model, action) for model in ("omg", "cyclonedds-0.10") for action in ("publish", "subscribe")
    }
