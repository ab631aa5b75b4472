# SPDX-License-Identifier: Apache-2.0
"""Translations are proven: SROS2's documents and those that are compiled from the new policy permit the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from keymint_ros2_dds import build_type
from keymint_ros2_sros2 import policy_type
from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Origin, Severity
from keymint.api import ImportedPolicy, ImportedSubject, ImportRequest, PolicySource, Proof, standard_claims
from tests.effort import tries

from .sros2_policies import COMMON, INCLUDE, enclave, policy

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d" / "foxy"


def imported(path: Path, **options: bool) -> ImportedPolicy:
    return policy_type.translated(ImportRequest(path, "comarmor.d/new.xml", LIBRARY, **options))


def is_same(subject: ImportedSubject) -> bool:
    compared = build_type.keystores.compare(subject, "foxy", 100_000, lambda: True)
    claims = (*standard_claims(compared.theirs), *compared.ours)
    assert len(claims) == 4
    return all(claim.proof is Proof.PROVEN for claim in claims)


def test_a_policy_with_common_files(robot: Path) -> None:
    found = imported(robot)
    assert [each.rules.subject for each in found.subjects] == ["/robot/talker", "/robot/listener"]
    assert all(is_same(each) for each in found.subjects)
    assert all(is_same(each) for each in imported(robot, implicit=False).subjects)
    assert [each.code for each in found.diagnostics] == ["sros2-rosout"]
    assert {rule.origin.file for rule in found.subjects[1].rules.rules} >= {"comarmor.d/new.xml"}


def test_the_proof_sees_a_changed_document(robot: Path) -> None:
    talker, listener = imported(robot).subjects
    assert not is_same(ImportedSubject(talker.rules, listener.document, listener.subject_name))
    for old, new in ((b"rt/robot/chatter<", b"rt/robot/chatter2<"), (b"rt/clock", b"rt/c*lock")):
        assert old in talker.document
        changed = talker.document.replace(old, new)
        assert not is_same(ImportedSubject(talker.rules, changed, talker.subject_name))


def topics(*names: str) -> str:
    return f'<topics publish="ALLOW">{"".join(f"<topic>{name}</topic>" for name in names)}</topics>'


PROFILES = [f'<profiles><profile ns="/" node="n">{topics(name)}</profile></profiles>' for name in ("one", "two")]
ODD = {
    "sros2-two-profiles": [f'<enclave path="/e">{"".join(PROFILES)}</enclave>'],
    "sros2-path-twice": [f'<enclave path="/e">{each}</enclave>' for each in PROFILES],
    "sros2-tilde": [enclave("/e", topics("~x"), "/ns")],
    "sros2-padded": [enclave("/e", topics(" x "))],
    "sros2-namespace": [enclave("/e", topics("x"), "ns")],
}


@pytest.mark.parametrize("code", ODD)
def test_what_sros2_enforces_otherwise(write, code: str) -> None:
    path = write(policy(*ODD[code]))
    with pytest.raises(ComArmorError) as caught:
        imported(path)
    assert [each.code for each in caught.value.diagnostics] == [code]
    found = imported(path, accept=True)
    assert [(each.code, each.severity) for each in found.diagnostics] == [(code, Severity.WARNING)]
    (subject,) = found.subjects
    assert subject.deviates
    assert not is_same(subject)  # so the warning is true
    names = {name for rule in subject.rules.rules for name in rule.expressions} - {"ros_discovery_info"}
    expected = {"sros2-tilde": {"/ns/n/x"}, "sros2-padded": {"/x"}, "sros2-namespace": {"/ns/x"}}
    assert names == expected.get(code, {"/one", "/two"})


def test_what_has_no_meaning_is_refused_in_any_case(write) -> None:
    path = write(policy(enclave("/e*", "")))
    for accept in (False, True):
        with pytest.raises(ComArmorError) as caught:
            imported(path, accept=accept)
        assert [each.code for each in caught.value.diagnostics] == ["sros2-path"]


def test_what_is_lost_or_strange_is_noted(write) -> None:
    profile = f'<profile ns="/robot" node="n">{INCLUDE}<services><service>x</service></services></profile>'
    text = policy(f'<enclave path="/e"><profiles type="t">{profile}<metadata/></profiles></enclave>')
    found = imported(write(text, COMMON))
    assert [each.code for each in found.diagnostics] == [
        "sros2-lost", "sros2-lost", "sros2-rosout", "sros2-no-qualifier",
    ]  # fmt: skip
    assert "/robot/rosout" in found.diagnostics[2].message
    assert all(is_same(each) for each in found.subjects)


def test_an_old_policy(write) -> None:
    profile = f'<profile ns="/ns" node="n">{topics("t", "/abs")}</profile>'
    (subject,) = imported(write(f'<policy version="0.1.0"><profiles>{profile}</profiles></policy>')).subjects
    assert subject.rules.subject == "/ns/n"
    assert is_same(subject)


NAMES = st.sampled_from(
    [
        "a",
        "b/c",
        "/a",
        "/b/c",
        "~/a",
        "~",
        "*",
        "a*",
        "/*/c",
        "b?c",
        "/[ab]",
        "[!a]*",
        "/**",
        "{a}",
        "@{a}",
        "a b",
        "a[",
    ]
)
QUALIFIERS = st.sampled_from([None, "ALLOW", "DENY"])
LISTS = {"topics": ("publish", "subscribe"), "services": ("request", "reply"), "actions": ("call", "execute")}


@st.composite
def lists(draw: st.DrawFn) -> str:
    tag = draw(st.sampled_from(sorted(LISTS)))
    given = [(name, draw(QUALIFIERS)) for name in LISTS[tag]]
    element = etree.Element(tag, {name: value for name, value in given if value})
    for name in draw(st.lists(NAMES, min_size=1, max_size=4)):
        etree.SubElement(element, tag.removesuffix("s")).text = name
    return etree.tostring(element, encoding="unicode")


def nodes() -> st.SearchStrategy[str]:
    namespaces, names = st.sampled_from(["/", "", "/ns", "/a/b/", "/*"]), st.sampled_from(["n", "a", "*"])
    rules: st.SearchStrategy[Sequence[str]] = st.lists(lists(), max_size=4)
    return st.builds(
        lambda ns, name, each: f'<profile ns="{ns}" node="{name}">{"".join(each)}</profile>', namespaces, names, rules
    )


@settings(max_examples=tries(30, 300), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(nodes(), min_size=1, max_size=3), st.booleans())
def test_any_policy(tmp_path: Path, profiles: list[str], implicit: bool) -> None:
    path = tmp_path / "policy.xml"
    path.write_text(policy(f'<enclave path="/ns/n"><profiles>{"".join(profiles)}</profiles></enclave>'))
    (found,) = imported(path, implicit=implicit).subjects
    assert is_same(found)
    if implicit:  # the policy as verbs read it directly
        rules = policy_type.load([PolicySource("policy.xml", path, Origin("policy.xml"))]).rules("/ns/n")
        assert is_same(ImportedSubject(rules, found.document, found.subject_name))
