# SPDX-License-Identifier: Apache-2.0
"""Claims are about every name of bytes: what is beyond printable ASCII is not passed over."""

from __future__ import annotations

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.proving.claims import prove_content
from keymint_ros2_dds.reading import dialects

from comarmor.patterns import glob
from keymint.api import BuildOptions, ComparisonTask, Proof
from keymint.errors import KeymintError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.packages import package, rule
from tests.plugins.keymint_ros2_dds.proving.byte_names import Case, has_cyclone, run

VENDORS = ("cyclonedds-0.10", "fastdds-2.9")
SAMPLE = tries(60, 250)


def stands(case: Case) -> dict[str, tuple[Proof, str]]:
    """Return how each model's claim stands, with the name or the reason."""
    return {
        claim.model: (claim.proof, claim.counterexample.endpoint.name if claim.counterexample else claim.reason)
        for claim in case.claims()
    }


@pytest.mark.cyclonedds
def test_nothing_is_proven_that_a_name_of_bytes_refutes():
    found = run(SAMPLE, 1, cyclone=has_cyclone())
    assert found["cases"] == SAMPLE
    for model in ("omg", "fastdds-2.9"):
        assert found[f"{model} proven"] > SAMPLE / 10
        assert found[f"{model} counterexample"] > SAMPLE / 10
        assert found[f"{model} unknown"] < SAMPLE / 2


@pytest.mark.parametrize("strange", ["covért", "c\\x", "a\x7fb", "日本", "a b", "\U0001f600"])
def test_a_topic_that_the_policy_does_not_name(strange):
    found = stands(Case((), ("a",), ((True, ("a", strange)),)))
    for model in VENDORS:
        assert found[model] == (Proof.COUNTEREXAMPLE, strange)
    # For the standard a backslash escapes what follows it.
    assert found["omg"] == (Proof.COUNTEREXAMPLE, strange.replace("\\", ""))


@pytest.mark.parametrize("allowed", ["*", "a*", "?", "[!a]", "a?", "[!a]?*", "??"])
def test_a_wildcard_stands_for_the_same_bytes_on_both_sides(allowed):
    same = Case((), (allowed,), ((True, (allowed,)),))
    if "[" not in allowed:
        assert {proof for proof, _ in stands(same).values()} == {Proof.PROVEN}
    else:  # Cyclone DDS takes the bracket that ends a set to be a member of it
        assert stands(same)["fastdds-2.9"][0] is Proof.PROVEN
        spelled = Case((), (allowed,), ((True, (allowed, allowed.replace("[!a]", "]"))),))
        assert {proof for proof, _ in stands(spelled).values()} == {Proof.PROVEN}


def test_a_denial_of_a_name_beyond_ascii_counts():
    found = stands(Case((), ("*",), ((False, ("é",)), (True, ("*",)))))
    assert set(found.values()) == {(Proof.COUNTEREXAMPLE, "é")}


def test_names_beyond_ascii_are_bytes():
    # Two bytes that together are no character of UTF-8 are a name like any other.
    found = stands(Case((), ("a?",), ((True, ("a?", "a??")),)))
    assert all(proof is Proof.COUNTEREXAMPLE and len(name) == 3 for proof, name in found.values())
    covered = Case((), ("cov??rt",), ((True, ("cov??rt", "covért")),))
    for proof, reason in stands(covered).values():
        assert proof is Proof.UNKNOWN
        assert reason.startswith("permissions.xml:2: 'covért' has characters beyond ASCII")
    plain = Case((), ("covért", "c*"), ((True, ("c*",)),))
    assert {proof for proof, _ in stands(plain).values()} == {Proof.PROVEN}


@pytest.mark.parametrize("expression", ["[é]", "x[!é]", "[a-é]", "é[ab]"])
def test_a_set_beside_characters_beyond_ascii_is_unknown(expression):
    for case in (
        Case((), ("*",), ((True, ("*", expression)),)),
        Case((), ("*", expression), ((True, ("*",)),)),
    ):
        for proof, reason in stands(case).values():
            assert proof is Proof.UNKNOWN
            assert reason.startswith(("permissions.xml:2: ", "policy.xml:7: "))
            assert "depends on the locale" in reason


def test_a_class_of_characters_has_other_members_in_other_locales():
    case = Case((), ("[A-Za-z]",), ((True, ("[[:alpha:]]",)),))
    for model in ("omg", "fastdds-2.9"):
        proof, reason = stands(case)[model]
        assert proof is Proof.UNKNOWN
        assert "'[[:alpha:]]' has a class of characters" in reason
    digits = Case((), ("[0-9]",), ((True, ("[[:digit:]]",)),))
    assert stands(digits)["fastdds-2.9"] == (Proof.PROVEN, "")


def test_a_line_end_within_a_name_is_not_part_of_the_model_of_cyclone():
    found = stands(Case((), ("a\nb",), ((True, ("a\nb",)),)))
    assert found["cyclonedds-0.10"][0] is Proof.UNKNOWN
    assert "xml:2: how Cyclone DDS reads a line end within a name is not modelled" in found["cyclonedds-0.10"][1]
    assert found["fastdds-2.9"] == (Proof.PROVEN, "")


def test_partitions_are_names_as_well():
    loaded = package(rule("ALLOW", "topic", "publish", "a", partitions=("p",)))
    held = (0, "CN=/talker,OU=x1", loaded.grant.rules, "humble", loaded.grant.domains, 10_000, lambda: True)
    content = Case((), (), ((True, ("a",)),)).content().replace(b"CN=/t<", b"CN=/talker,OU=x1<")
    for extra in ("é", "p\\", "\x7f"):
        listed = f"</topics><partitions><partition>p</partition><partition>{extra}</partition></partitions>".encode()
        claims = prove_content(ComparisonTask(content.replace(b"</topics>", listed), "p.xml", *held))
        found = {claim.model: claim for claim in claims if claim.action == "publish"}
        for model in VENDORS:
            example = found[model].counterexample
            assert example is not None
            assert example.endpoint.partitions == (extra,)


@pytest.mark.parametrize("expression", ["a[!é]", "a[!\t]", "a[!\x7f]", "é", "a\\\\b", "[é]"])
def test_the_compiler_writes_no_name_beyond_printable_ascii(expression):
    with pytest.raises(KeymintError, match=r"printable ASCII|literal"):
        build_type.build(package(rule("ALLOW", "topic", "publish", expression)), BuildOptions())


def test_bytes_and_text_are_two_forms_of_one_name():
    for name in ("a", "é", "日本", "\U0001f600"):
        assert octets.in_text(dialects.in_bytes(name)) == name
    for code in range(1, 256):
        assert dialects.in_bytes(octets.in_text(chr(code))) == chr(code)
    assert octets.of_glob(glob.parse("é[!a]?")) == ("Ã©", *glob.parse("[!a]?"))
