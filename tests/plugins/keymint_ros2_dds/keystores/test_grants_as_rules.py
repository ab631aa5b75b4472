# SPDX-License-Identifier: Apache-2.0
"""Rules of signed permissions mean what the document means; what no policy can say is refused at its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.compiling.grant_compiler import compile_rules
from keymint_ros2_dds.documents import permissions_document
from keymint_ros2_dds.keystores import grants_as_rules
from keymint_ros2_dds.keystores.grants_as_rules import rules_of
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.settings import package_of

import comarmor
from comarmor.rules import Rule
from keymint.api import BuildOptions, ComparisonTask, DomainRange, Relation
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests import generated
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.proving.test_document_relation import CHATTER, allow, document, part


def learned(document_grants: str, distro: str = "jazzy") -> tuple[Rule, ...]:
    """Return the rules of a document, which are proven to mean the same."""
    content = f"<dds><permissions>{document_grants}</permissions></dds>".encode()
    return learned_of(content, "CN=/a", "/a", distro)


def learned_of(content: bytes, name: str, subject: str, distro: str) -> tuple[Rule, ...]:
    rules, domains, findings = rules_of(signed_permissions.read(content, "d.p7s", 10), name, subject, distro)
    assert not findings
    result = build_type.keystores.compared(
        ComparisonTask(content, "d.p7s", 10, name, SubjectRules(subject, rules), distro, domains, 100_000, lambda: True)
    )
    assert result.relation is Relation.EQUAL
    return rules


def texts(rules: tuple[Rule, ...]) -> list[str]:
    return [f"{rule.effect} {rule.permissions[0]} {rule.expressions[0]}{list(rule.partitions) or ''}" for rule in rules]


TAGS = "<data_tags><tag><name>a</name><value>b</value></tag></data_tags>"
PARTITIONED = "<partitions><partition>p*</partition></partitions>"


@pytest.mark.parametrize(
    ("rules", "expected"),
    [
        ([allow(part("publish", "rt/x"), part("subscribe", "rt/x"))],
         ["ALLOW ros_publish /x", "ALLOW ros_subscribe /x"]),
        ([allow(part("publish", "rt/x"), tag="deny_rule"), allow(part("publish", "rt/*"))],
         ["ALLOW ros_publish /*", "DENY ros_publish /x"]),
        # A denial of what nothing allows stays: it says what must never be allowed.
        ([allow(part("publish", "rt/x"), tag="deny_rule"), allow(part("publish", "rt/y"))],
         ["ALLOW ros_publish /y", "DENY ros_publish /x"]),
        # After a rule that allows all or some of it, it has no effect.
        ([allow(part("publish", "rt/*")), allow(part("publish", "rt/x"), tag="deny_rule"),
          allow(part("publish", "rt/x"))],
         ["ALLOW ros_publish /*", "ALLOW ros_publish /x"]),
        ([allow(part("publish", "rt/x")), allow(part("publish", "rt/*"), tag="deny_rule")], ["ALLOW ros_publish /x"]),
        ([allow(part("publish", "x", more=PARTITIONED))], ["ALLOW publish x['p*']"]),
        ([allow(part("publish", "x", more=PARTITIONED), tag="deny_rule"), allow(part("publish", "rt/x"))],
         ["ALLOW ros_publish /x", "DENY publish x['p*']"]),
        ([allow(part("publish", "rt/x", more="<partitions><partition/></partitions>"))], ["ALLOW ros_publish /x"]),
        ([allow(part("publish", "rt/[z-a]"), part("relay", "rt/x"))], ["ALLOW ros_relay /x"]),
        ([allow(part("publish", "{a} b"))], ["ALLOW publish \\{a\\}\\ b"]),
        ([allow(part("publish", "rt/a\\*"))], ["ALLOW publish rt/a\\*"]),
        ([], []),
    ],
)  # fmt: skip
def test_rules(rules: list[str], expected: list[str]) -> None:
    assert texts(learned(document(*rules))) == expected


def test_the_default_is_a_rule_for_everything() -> None:
    denied = allow(part("publish", "rt/x"), tag="deny_rule", domain="<id_range><min>0</min></id_range>")
    open_for_all = document(denied, default="ALLOW")
    assert texts(learned(open_for_all)) == [
        "DENY ros_publish /x", "ALLOW publish *['*']", "ALLOW subscribe *['*']", "ALLOW relay *['*']",
    ]  # fmt: skip


def test_places_are_those_of_the_document() -> None:
    (rule,) = learned(CHATTER)
    assert str(rule.origin) == "d.p7s:14"


def test_domains_are_those_in_which_anything_is_permitted() -> None:
    def domains(*rules: str) -> tuple[DomainRange, ...]:
        content = f"<dds><permissions>{document(*rules)}</permissions></dds>".encode()
        return rules_of(signed_permissions.read(content), "CN=/a", "/a", "jazzy")[1]

    some = "<id>7</id><id_range><min>1</min><max>2</max></id_range>"
    assert domains(allow(part("publish", "rt/x"), domain=some)) == (DomainRange(1, 2), DomainRange(7, 7))
    assert domains(allow(part("publish", "rt/x"), tag="deny_rule")) == ()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (document(allow(part("publish", "rt/[ab]")), allow(part("publish", "rt/[bc]"), tag="deny_rule"),
                  allow(part("publish", "rt/*"))), "d.p7s:14: denies to publish 'rt/[b-c]', but line 14 before it"),
        (document(allow(part("publish", "rt/x"), tag="deny_rule"), default="ALLOW"),
         "permits something else in domain 0 than in domains 1 to 232"),
        (document(allow(part("publish", "rt/x")), allow(part("publish", "rt/y"), domain="<id>5</id>")),
         "permits something else in domain 0 than in domain 5"),
        (document(allow(part("publish", "rt/x", more=TAGS))), "data tags"),
        (document(allow(part("publish", "rt/x[[.a.]]"))), "d.p7s:14"),
        (CHATTER + document(allow(part("publish", "rt/y")), dates=(2031, 2040)), "another grant from 2031-01-01 on"),
    ],
)  # fmt: skip
def test_what_no_policy_can_say(text: str, reason: str) -> None:
    with pytest.raises(KeymintError) as caught:
        learned(text)
    assert reason in str(caught.value)


def test_what_takes_too_long_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grants_as_rules, "STEPS", 3)
    wide = [allow(part("publish", f"rt/*{each}*")) for each in "abcdef"]
    with pytest.raises(KeymintError, match="overlap in too many ways"):
        learned(document(*wide, allow(part("publish", "rt/*x*"), tag="deny_rule"), *wide))


def test_grants_that_never_apply_are_warnings() -> None:
    content = f"<dds><permissions>{CHATTER}{document(allow(part('publish', 'rt/y')))}</permissions></dds>".encode()
    read = signed_permissions.read(content, "d.p7s")
    rules, _, findings = rules_of(read, "CN=/a", "/a", "jazzy")
    assert texts(rules) == ["ALLOW ros_publish /chatter"]
    assert [(each.code, each.severity) for each in findings] == [("learn-grant", "warning")]
    rules, domains, findings = rules_of(read, "CN=/b", "/b", "jazzy")
    assert (rules, domains) == ((), ())
    assert "no grant is for 'CN=/b'" in findings[0].message


@pytest.mark.parametrize("distro", ["jazzy", "ardent"])
def test_what_keymint_compiles_comes_back_or_is_refused(tmp_path: Path, distro: str) -> None:
    """Random policies with nesting, tunables, partitions and denials: nothing is learned that means something else."""
    count, codes = {"same": 0, "refused": 0}, set()
    for seed in range(tries(8, 400)):
        path = tmp_path / "policy.xml"
        path.write_text(generated.pretty(generated.tokens(seed)))
        policy = comarmor.load(path)
        for subject in (*policy.subjects(), "/r1/talker"):
            if not policy.applicable(subject):
                continue
            package = package_of(SubjectRules(subject, policy.rules(subject)), distro)
            try:
                compiled = compile_rules(package.grant, distro, BuildOptions(allow_vendor_specific=True))
            except KeymintError:
                continue  # no actions in Ardent
            for form in (compiled.plain, *compiled.forms):
                content = permissions_document.render(package.grant, form)
                try:
                    learned_of(content, package.grant.subject_name, subject, distro)
                except KeymintError as error:
                    codes |= {each.code for each in error.diagnostics}
                    count["refused"] += 1
                else:
                    count["same"] += 1
    assert codes <= {"learn-unsayable"}
    assert count["same"] > count["refused"]
