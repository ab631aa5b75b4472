# SPDX-License-Identifier: Apache-2.0
"""A permissions document permits the same as rules, less, more, or something else; each with a shortest name."""

from __future__ import annotations

import pytest
from keymint_ros2_dds import build_type

from comarmor.errors import ComArmorError, Origin
from comarmor.rules import KIND_OF, Effect
from keymint.api import ComparisonTask, DocumentComparison, DomainRange, Relation
from keymint.ir import Rule, SubjectRules

PLACE = Origin("policy.xml", 3)


def rule(permission: str, *names: str, effect: Effect = Effect.ALLOW, partitions: tuple[str, ...] = ()) -> Rule:
    return Rule(effect, KIND_OF[permission], (permission,), names, partitions, False, PLACE)


def part(action: str, *topics: str, more: str = "") -> str:
    listed = "".join(f"<topic>{topic}</topic>" for topic in topics)
    return f"<{action}><topics>{listed}</topics>{more}</{action}>"


def document(*rules: str, default: str = "DENY", subject: str = "CN=/a", dates: tuple[int, int] = (2020, 2030)) -> str:
    validity = "".join(
        f"<{tag}>{year}-01-01T00:00:00</{tag}>" for tag, year in zip(("not_before", "not_after"), dates, strict=True)
    )
    return (
        f'<grant name="g">\n<subject_name>{subject}</subject_name>\n<validity>{validity}</validity>\n'
        f"{''.join(rules)}\n<default>{default}</default></grant>"
    )


def allow(*parts: str, tag: str = "allow_rule", domain: str = "<id>0</id>") -> str:
    return f"<{tag}><domains>{domain}</domains>{''.join(parts)}</{tag}>"


def compared(grants: str, *rules: Rule, first: int = 0, last: int = 0, states: int = 10_000) -> DocumentComparison:
    content = f"<dds><permissions>{grants}</permissions></dds>".encode()
    task = ComparisonTask(
        content, "enclaves/a/permissions.p7s", 10, "CN=/a", SubjectRules("/a", rules), "jazzy",
        (DomainRange(first, last),), states, lambda: True,
    )  # fmt: skip
    return build_type.keystores.compared(task)


CHATTER = document(allow(part("publish", "rt/chatter")))


def found(result: DocumentComparison) -> tuple[str, str, str]:
    """Return the relation, what is missing, and what is in excess."""
    missing, excess = (
        "" if each is None else f"{each.endpoint.action} {each.endpoint.name}"
        for each in (result.missing, result.excess)
    )
    assert (result.relation is Relation.UNKNOWN) is bool(result.reason)
    return str(result.relation), missing, excess


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("/chatter",), ("equal", "", "")),
        (("/chatter", "/x"), ("narrower", "publish rt/x", "")),
        (("/c*",), ("narrower", "publish rt/c", "")),
        (("/ch?tter",), ("narrower", "publish rt/ch!tter", "")),
        (("/x",), ("different", "publish rt/x", "publish rt/chatter")),
    ],
)
def test_relations(names: tuple[str, ...], expected: tuple[str, str, str]) -> None:
    result = found(compared(CHATTER, rule("ros_publish", *names)))
    if "?" in names[0]:
        assert (result[0], result[2]) == (expected[0], expected[2])  # any character but one will do
    else:
        assert result == expected


def test_a_document_that_permits_more() -> None:
    result = compared(CHATTER)
    assert found(result) == ("wider", "", "publish rt/chatter")
    assert result.excess is not None
    assert result.excess.meaning is not None
    assert result.excess.meaning.object.name == "/chatter"
    assert str(result.excess.document.where) == "enclaves/a/permissions.p7s:14"
    assert not result.excess.policy.allowed


def test_a_rule_that_the_document_lacks_is_cited() -> None:
    missing = compared(CHATTER, rule("ros_publish", "/chatter"), rule("ros_subscribe", "/chatter")).missing
    assert missing is not None
    assert missing.policy.where == PLACE
    assert not missing.document.allowed


def test_denials_count_on_both_sides() -> None:
    denied = document(allow(part("publish", "rt/x"), tag="deny_rule"), allow(part("publish", "rt/*")))
    own = (rule("ros_publish", "/*"), rule("ros_publish", "/x", effect=Effect.DENY))
    assert found(compared(denied, *own)) == ("equal", "", "")
    assert found(compared(denied, own[0])) == ("narrower", "publish rt/x", "")
    late = document(allow(part("publish", "rt/*")), allow(part("publish", "rt/x"), tag="deny_rule"))
    assert found(compared(late, *own)) == ("wider", "", "publish rt/x")  # the first match decides


def test_the_default_counts() -> None:
    result = compared(document(default="ALLOW"), rule("publish", "*", partitions=("*",)))
    assert (result.relation, result.missing) == (Relation.WIDER, None)
    everything = [rule(each, "*", partitions=("*",)) for each in ("publish", "subscribe", "relay")]
    assert found(compared(document(default="ALLOW"), *everything, last=232)) == ("equal", "", "")


def test_domains_count() -> None:
    elsewhere = document(allow(part("publish", "rt/chatter"), domain="<id>5</id>"))
    own = rule("ros_publish", "/chatter")
    result = compared(elsewhere, own)
    assert found(result) == ("different", "publish rt/chatter", "publish rt/chatter")
    assert result.missing is not None
    assert result.excess is not None
    assert (result.missing.endpoint.domain, result.excess.endpoint.domain) == (0, 5)
    assert found(compared(elsewhere, own, first=5, last=5)) == ("equal", "", "")
    ranged = document(allow(part("publish", "rt/chatter"), domain="<id_range><min>3</min><max>9</max></id_range>"))
    assert found(compared(ranged, own, first=3, last=9)) == ("equal", "", "")
    assert found(compared(ranged, own, first=3, last=10))[0] == "narrower"


def test_partitions_count() -> None:
    some = document(allow(part("publish", "x", more="<partitions><partition>p</partition></partitions>")))
    assert found(compared(some, rule("publish", "x", partitions=("p",)))) == ("equal", "", "")
    assert found(compared(some, rule("publish", "x")))[0] == "different"


def test_relay_counts() -> None:
    relays = document(allow(part("publish", "rt/x"), part("relay", "rt/x")))
    assert found(compared(relays, rule("ros_publish", "/x"))) == ("wider", "", "relay rt/x")
    assert found(compared(relays, rule("ros_publish", "/x"), rule("ros_relay", "/x"))) == ("equal", "", "")
    assert found(compared(document(), rule("ros_relay", "/x"))) == ("narrower", "relay rt/x", "")


def test_grants_of_the_subject_count_each_in_its_time() -> None:
    other = document(allow(part("publish", "rt/x")), subject="CN=/b")
    assert found(compared(other, rule("ros_publish", "/x"))) == ("narrower", "publish rt/x", "")
    later = document(allow(part("publish", "rt/y")), dates=(2031, 2040))
    result = found(compared(CHATTER + later, rule("ros_publish", "/chatter")))
    assert result == ("different", "publish rt/chatter", "publish rt/y")
    assert found(compared(CHATTER + document(), rule("ros_publish", "/chatter"))) == ("equal", "", "")


@pytest.mark.parametrize(
    ("grants", "reason"),
    [
        ("<grant>", "permissions.p7s"),
        (CHATTER.replace("<default>DENY</default>", ""), "the schema refuses it"),
        (CHATTER.replace("<id>0</id>", "<id>x</id>"), "'x' is no domain id"),
        (document(allow(part("publish", "rt/[ä]"))), "depends on the locale"),
        (document(allow(part("publish", "rt/[[:alpha:]]"))), "depends on the locale"),
    ],
)
def test_what_the_reader_refuses_is_unknown(grants: str, reason: str) -> None:
    result = compared(grants, rule("ros_publish", "/[[:alpha:]]"))
    assert result.relation is Relation.UNKNOWN
    assert reason in result.reason


def test_what_is_not_decided_within_the_budget_is_unknown() -> None:
    names = [f"rt/*{letter}*" for letter in "abcdefg"]
    wide = document(*(allow(part("publish", name), tag="deny_rule") for name in names), allow(part("publish", "rt/*")))
    result = compared(wide, rule("ros_publish", "/*a*b*c*d*", "/[!abcdefg]*"), states=3)
    assert result.relation is Relation.UNKNOWN
    assert "states" in result.reason


def test_rules_that_cannot_be_mapped_are_an_error() -> None:
    with pytest.raises(ComArmorError):
        compared(CHATTER, rule("ros_publish", "[[.a.]]"))
