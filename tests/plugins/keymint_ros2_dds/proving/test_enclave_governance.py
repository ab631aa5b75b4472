# SPDX-License-Identifier: Apache-2.0
"""The signed governance is part of every claim: what it opens, refuses, or protects less, is found."""

from __future__ import annotations

import random
import re

import pytest
from keymint_ros2_dds import build_type

from keymint.api import BuildOptions, DomainRange, Proof
from tests.plugins.keymint_ros2_dds.enclaves import installed
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed as with_governance, package, protection, rule
from tests.plugins.keymint_ros2_dds.test_enclave_proof import MODELS, PLAIN, claims, refuted, sign

READ, WRITE = "enable_read_access_control", "enable_write_access_control"
JOIN, UNAUTHENTICATED = "enable_join_access_control", "allow_unauthenticated_participants"


def governed(loaded, *rules, accepts: bool = False):
    return with_governance(loaded, domain_rules=rules, accepts_open=accepts)


def found(loaded, content: bytes | None = None, **fields):
    """Return the claims about an enclave with this governance, or with that of its sources."""
    files = installed(loaded)
    if content is not None:
        files["governance.p7s"] = sign(content)
    return claims(loaded, files, **fields)


def built(loaded) -> str:
    return build_type.build(loaded, BuildOptions()).documents["governance.xml"].decode()


def proofs(all_claims) -> set[Proof]:
    return {claim.proof for claim in all_claims}


def test_a_governance_that_controls_everything_changes_nothing() -> None:
    assert proofs(found(PLAIN)) == {Proof.PROVEN}
    assert found(PLAIN) == claims(PLAIN, installed(PLAIN))


@pytest.mark.parametrize(("tag", "action"), [(WRITE, "publish"), (READ, "subscribe")])
def test_an_open_topic_is_a_counterexample_with_its_line(tag: str, action: str) -> None:
    content = built(PLAIN).replace(f"<{tag}>true", f"<{tag}>false")
    seen = found(PLAIN, content.encode())
    assert set(refuted(seen)) == {(model, action) for model in MODELS}
    line = next(n for n, text in enumerate(sign(content.encode()).split(b"\n"), 1) if b"<topic_rule>" in text)
    for claim in seen:
        if claim.counterexample:
            example = claim.counterexample
            assert (example.policy.allowed, example.document.allowed) == (False, True)
            assert str(example.document.where) == f"install/talker/governance.p7s:{line}"
            assert f"{tag} is false for '*'" in example.document.reason
            assert "open_governance" in example.help


def test_a_shortest_name_that_the_first_matching_rule_opens() -> None:
    loaded = governed(
        PLAIN,
        domain_rule(
            protection("topic", "rt/a*"),
            protection("topic", "rt/??", enable_write_access_control=False),
            protection("topic", "rt/*"),
            protection("topic", "*"),
        ),
    )
    names = {name for name, *_ in refuted(found(loaded)).values()}
    assert len(names) == 1
    (name,) = names
    assert re.fullmatch(r"rt/[^a].", name)


def test_a_topic_without_a_rule_is_refused() -> None:
    content = built(PLAIN).replace("<topic_expression>*<", "<topic_expression>rt/camera/*<")
    wrong = refuted(found(PLAIN, content.encode()))
    assert {key: value[2:] for key, value in wrong.items()} == {
        (model, action): (True, False) for model in MODELS for action in ("publish", "subscribe")
    }


def test_an_expression_that_means_nothing_is_unknown() -> None:
    rule_ = re.search(r" *<topic_rule>.*?</topic_rule>\n", built(PLAIN), re.DOTALL)
    assert rule_ is not None
    odd = rule_[0].replace(">*<", ">[[.a.]]<")
    seen = found(PLAIN, built(PLAIN).replace(rule_[0], odd + rule_[0]).encode())
    by_model = {model: {claim.proof for claim in seen if claim.model == model} for model in MODELS}
    assert by_model == {
        "omg": {Proof.UNKNOWN},
        "cyclonedds-0.10": {Proof.PROVEN},  # whose expressions have no such notation
        "fastdds-2.11": {Proof.UNKNOWN},
    }
    assert all("governance.p7s:" in claim.reason for claim in seen if claim.proof is Proof.UNKNOWN)


def test_a_domain_without_a_rule_is_refused() -> None:
    wrong = refuted(found(PLAIN, built(PLAIN).replace("<id>0</id>", "<id>1</id>").encode()))
    assert {key: value[2:] for key, value in wrong.items()} == {
        (model, action): (True, False) for model in MODELS for action in ("publish", "subscribe")
    }


def test_the_first_rule_of_a_domain_counts() -> None:
    open_ = domain_rule(protection(enable_write_access_control=False))
    assert proofs(found(governed(PLAIN, domain_rule(), open_))) == {Proof.PROVEN}
    assert Proof.COUNTEREXAMPLE in proofs(found(governed(PLAIN, open_, domain_rule())))


def test_another_domain_that_is_open_is_found() -> None:
    open_ = domain_rule(protection(enable_read_access_control=False), domains=(DomainRange(3, 5),))
    seen = [claim for claim in found(governed(PLAIN, domain_rule(), open_)) if claim.proof is Proof.COUNTEREXAMPLE]
    # A participant of Fast DDS may join any domain; by the standard and Cyclone DDS it may since a topic is open.
    assert {(claim.model, claim.action, claim.domains) for claim in seen} == {
        (model, "subscribe", (DomainRange(3, 5),)) for model in MODELS
    }


def test_without_any_rule_fast_dds_lets_nobody_in_and_the_others_do() -> None:
    nothing = package(rule("DENY", "topic", "publish", "x"))
    wrong = refuted(found(governed(nothing, domain_rule(protection(enable_write_access_control=False)))))
    assert set(wrong) == {("omg", "publish"), ("cyclonedds-0.10", "publish")}


@pytest.mark.parametrize(("tag", "value"), [(JOIN, "false"), (UNAUTHENTICATED, "true")])
def test_who_may_join(tag: str, value: str) -> None:
    content = re.sub(f"<{tag}>[a-z]+", f"<{tag}>{value}", built(PLAIN))
    seen = [claim for claim in found(PLAIN, content.encode()) if claim.proof is Proof.COUNTEREXAMPLE]
    assert [(claim.model, claim.action) for claim in seen] == [(model, "join") for model in MODELS]
    assert all(claim.counterexample and tag in claim.counterexample.document.reason for claim in seen)


@pytest.mark.parametrize(
    ("tag", "text"),
    [
        ("discovery_protection_kind", "SIGN"), ("liveliness_protection_kind", "NONE"), ("rtps_protection_kind", "NONE"),
        ("metadata_protection_kind", "SIGN_WITH_ORIGIN_AUTHENTICATION"), ("data_protection_kind", "SIGN"),
        ("enable_discovery_protection", "false"), ("enable_liveliness_protection", "0"),
    ],
)  # fmt: skip
def test_less_protection_than_the_sources_say(tag: str, text: str) -> None:
    content = re.sub(f"<{tag}>[A-Za-z]+", f"<{tag}>{text}", built(PLAIN))
    seen = [claim for claim in found(PLAIN, content.encode()) if claim.proof is Proof.COUNTEREXAMPLE]
    assert [(claim.model, claim.action) for claim in seen] == [(model, "protect") for model in MODELS]
    assert all(f"{tag} is {text}" in claim.counterexample.document.reason for claim in seen if claim.counterexample)


def test_more_protection_than_the_sources_say_is_none_of_its() -> None:
    content = built(PLAIN).replace("<rtps_protection_kind>SIGN", "<rtps_protection_kind>ENCRYPT")
    assert proofs(found(PLAIN, content.encode())) == {Proof.PROVEN}


def test_authentication_alone_is_the_choice_of_the_owner() -> None:
    kinds = dict.fromkeys(("discovery_protection_kind", "liveliness_protection_kind", "rtps_protection_kind"), "NONE")
    topic = protection(metadata_protection_kind="NONE", data_protection_kind="NONE")
    assert proofs(found(governed(PLAIN, domain_rule(topic, **kinds)))) == {Proof.PROVEN}


OPEN = domain_rule(
    protection("ros_topic", "/diagnostics", enable_read_access_control=False),
    protection(),
    enable_join_access_control=False,
)


def test_what_the_profile_accepts_is_excepted_and_said() -> None:
    assert proofs(found(governed(PLAIN, OPEN))) == {Proof.PROVEN, Proof.COUNTEREXAMPLE}
    seen = found(governed(PLAIN, OPEN, accepts=True))
    assert proofs(seen) == {Proof.PROVEN}
    for claim in seen:
        texts = "; ".join(claim.excepted)
        assert ("subscribe 'rt/diagnostics' (install/talker/governance.p7s:" in texts) is (claim.action == "subscribe")
        assert "joining domain 0" in texts
        if claim.model == "fastdds-2.11":
            assert "without * ? [" in claim.universe


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<topic_expression>rt/diagnostics<", "<topic_expression>rt/diagnostic*<"),
        ("<enable_write_access_control>true", "<enable_write_access_control>false"),
        ("<allow_unauthenticated_participants>false", "<allow_unauthenticated_participants>true"),
        ("<id>0</id>", "<id>0</id><id>7</id>"),
    ],
)
def test_what_is_signed_beyond_what_the_sources_open_is_refuted(old: str, new: str) -> None:
    loaded = governed(PLAIN, OPEN, accepts=True)
    content = built(loaded)
    assert old in content
    assert Proof.COUNTEREXAMPLE in proofs(found(loaded, content.replace(old, new, 1).encode()))


PECULIAR = [
    ("<topic_rule>", "<topic_rule>\n<!-- a comment -->", Proof.PROVEN, Proof.PROVEN),
    ("</domain_access_rules>", "</domain_access_rules><!-- c -->", Proof.PROVEN, Proof.UNKNOWN),
    ("<topic_expression>*", "<topic_expression> *", Proof.COUNTEREXAMPLE, Proof.UNKNOWN),
    ("<topic_expression>*", "<topic_expression><![CDATA[*]]>", Proof.PROVEN, Proof.UNKNOWN),
    (f"<{READ}>true</{READ}>", "", Proof.COUNTEREXAMPLE, Proof.UNKNOWN),
    (f"<{READ}>true</{READ}>", f"<{READ}>TRUE</{READ}>", Proof.COUNTEREXAMPLE, Proof.UNKNOWN),
    (f"<{READ}>true</{READ}>", f"<{READ}> true </{READ}>", Proof.PROVEN, Proof.UNKNOWN),
    ("</domain_rule>", "<foo/></domain_rule>", Proof.COUNTEREXAMPLE, Proof.UNKNOWN),
    ("<id>0</id>", "<id>00</id>", Proof.PROVEN, Proof.UNKNOWN),
    ("<topic_expression>*", "<topic_expression>caf\u00e9</topic_expression><topic_expression>*", Proof.COUNTEREXAMPLE,
     Proof.UNKNOWN),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "standard", "vendors"), PECULIAR, ids=[str(n) for n in range(len(PECULIAR))])
def test_documents_that_are_not_plain(old: str, new: str, standard: Proof, vendors: Proof) -> None:
    content = re.sub(r">\s+<", "><", built(PLAIN))
    assert old in content
    seen = found(PLAIN, content.replace(old, new, 1).encode())
    assert {claim.proof for claim in seen if claim.model == "omg"} == {standard}
    assert {claim.proof for claim in seen if claim.model != "omg"} == {vendors}


def test_names_outside_of_the_universe_are_not_proven() -> None:
    rules = built(PLAIN).partition("<topic_access_rules>")
    odd = rules[2][: rules[2].index("</topic_rule>") + len("</topic_rule>")].replace(">*<", ">rt/caf\u00e9<")
    content = "".join((rules[0], rules[1], odd.replace(f"<{WRITE}>true", f"<{WRITE}>false"), rules[2]))
    assert Proof.PROVEN not in proofs(found(PLAIN, content.encode()))


CHANGES = {
    READ: "false", WRITE: "false", JOIN: "false", UNAUTHENTICATED: "true",
}  # fmt: skip


def faults(seed: int, count: int):
    """Yield packages, with a signed governance in which one element of one rule is opened."""
    some = random.Random(seed)
    expressions = ("*", "rt/*", "rt/chatter", "rt/c*", "rq/*", "*Request", "rt/camera/??")
    for _ in range(count):
        topics = [protection("topic", each) for each in some.sample(expressions, 3) if each != "*"]
        wide = domain_rule(*topics, protection(), domains=(DomainRange(0, some.choice([0, 2])),))
        other = domain_rule(protection("topic", "rt/*"), protection(), domains=(DomainRange(9, 9),))
        loaded = governed(PLAIN, wide, other)
        content = built(loaded)
        tag = some.choice(list(CHANGES))
        places = [match.span() for match in re.finditer(f"<{tag}>(true|false)", content)]
        begin, end = some.choice(places)
        yield loaded, content[:begin] + f"<{tag}>{CHANGES[tag]}" + content[end:], tag


def test_no_fault_of_a_governance_is_missed() -> None:
    missed = []
    tags = set()
    for loaded, content, tag in faults(20, 60):
        tags.add(tag)
        if {claim.proof for claim in found(loaded, content.encode()) if claim.proof is not Proof.PROVEN} != {
            Proof.COUNTEREXAMPLE
        }:
            missed.append(content)
    assert missed == []
    assert tags == set(CHANGES)
