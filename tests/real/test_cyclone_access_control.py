# SPDX-License-Identifier: Apache-2.0
"""Decisions of Cyclone DDS's access control on handmade documents: the facts that the compiler relies on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from cryptography.x509.oid import NameOID
from keymint_ros2_dds.subject_names import parts_occur
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl

from tests.plugins.keymint_ros2_dds.decision.cyclone_matcher import ac_fnmatch

from .handmade import Authorities, criteria, governance_document, rule

if TYPE_CHECKING:
    from collections.abc import Sequence

pytestmark = [pytest.mark.cyclonedds, pytest.mark.usefixtures("cyclone_plugins")]

PUBLISH_X = criteria("publish", ["rt/x"])
SUBSCRIBE_X = criteria("subscribe", ["rt/x"])
RELAY_X = criteria("relay", ["rt/x"])


def asked(authorities: Authorities, folder: Path, rules: str, *questions: tuple[str, str, Sequence[str]]) -> list[bool]:
    with CycloneAccessControl(authorities.enclave(folder, rules)) as access:
        assert access.valid, access.reason
        return [access.allows(*question) for question in questions]


def test_decides_on_direction_topic_and_partitions(authorities: Authorities, tmp_path: Path) -> None:
    rules = rule("allow", criteria("publish", ["rt/x", "rt/p*"]) + criteria("subscribe", ["rt/s"], ["a"]))
    with CycloneAccessControl(authorities.enclave(tmp_path, rules)) as access:
        assert access.joins()
        assert access.allows("publish", "rt/x")
        assert access.allows("publish", "rt/p/q")
        assert access.allows("subscribe", "rt/s", ["a"])
        assert not access.allows("subscribe", "rt/x")
        assert not access.allows("subscribe", "rt/s")
        assert not access.allows("subscribe", "rt/s", ["a", "b"])
        assert access.reason == "rt/s denied by default rule"


def test_every_enclave_has_its_own_rights_while_others_are_open(authorities: Authorities, tmp_path: Path) -> None:
    one = authorities.enclave(tmp_path / "one", rule("allow", PUBLISH_X))
    two = authorities.enclave(tmp_path / "two", rule("allow", SUBSCRIBE_X))
    with CycloneAccessControl(one) as first, CycloneAccessControl(two) as second:
        assert (first.allows("publish", "rt/x"), first.allows("subscribe", "rt/x")) == (True, False)
        assert (second.allows("publish", "rt/x"), second.allows("subscribe", "rt/x")) == (False, True)


def test_a_closed_enclave_answers_no(authorities: Authorities, tmp_path: Path) -> None:
    access = CycloneAccessControl(authorities.enclave(tmp_path, rule("allow", PUBLISH_X)))
    access.close()
    access.close()
    assert not access.allows("publish", "rt/x")
    assert not access.joins()


def test_frees_what_it_allocates(authorities: Authorities, tmp_path: Path) -> None:
    folder = authorities.enclave(tmp_path, rule("allow", PUBLISH_X))

    def run(times: int) -> int:
        for _ in range(times):
            with CycloneAccessControl(folder) as access:
                for number in range(200):
                    access.allows("publish", f"rt/denied{number}")
        return int(Path("/proc/self/statm").read_text().split()[1])

    before = run(50)
    assert run(300) - before < 500  # pages; leaking only the messages of refusals would take about 1,000


@pytest.mark.parametrize("file", ["permissions.p7s", "governance.p7s", "permissions_ca.cert.pem"])
def test_documents_of_another_authority_are_refused(authorities: Authorities, tmp_path: Path, file: str) -> None:
    folder = authorities.enclave(tmp_path / "own", rule("allow", PUBLISH_X))
    foreign = Authorities.new().enclave(tmp_path / "foreign", rule("allow", PUBLISH_X))
    (folder / file).write_bytes((foreign / file).read_bytes())
    with CycloneAccessControl(folder) as access:
        assert not access.valid
        assert "PKCS7" in access.reason
        assert not access.allows("publish", "rt/x")


@pytest.mark.parametrize(("domain", "joins"), [(0, True), (1, False)])
def test_rules_of_another_domain_do_not_apply(
    authorities: Authorities, tmp_path: Path, domain: int, joins: bool
) -> None:
    wide = governance_document(domains="<id_range><min>0</min><max>230</max></id_range>")
    folder = authorities.enclave(tmp_path, rule("allow", PUBLISH_X), governance=wide)
    with CycloneAccessControl(folder, domain) as access:
        assert access.joins() is joins
        assert access.allows("publish", "rt/x") is joins


@pytest.mark.parametrize(
    ("rules", "joins"),
    [("", False), (rule("deny", PUBLISH_X), False), (rule("allow", ""), True), (rule("allow", RELAY_X), True)],
    ids=["no rule", "deny only", "rule without criteria", "relay only"],
)
def test_any_allow_rule_permits_joining_and_nothing_else(
    authorities: Authorities, tmp_path: Path, rules: str, joins: bool
) -> None:
    with CycloneAccessControl(authorities.enclave(tmp_path, rules)) as access:
        assert access.joins() is joins
        assert not access.allows("publish", "rt/x")
        assert not access.allows("subscribe", "rt/x")


def test_rules_without_criteria_change_nothing(authorities: Authorities, tmp_path: Path) -> None:
    empty = rule("allow", "")
    rules = empty + rule("deny", PUBLISH_X) + empty + rule("allow", criteria("publish", ["rt/*"])) + empty
    assert asked(authorities, tmp_path, rules, ("publish", "rt/x", ()), ("publish", "rt/y", ())) == [False, True]


@pytest.mark.parametrize("effect", ["allow", "deny"])
@pytest.mark.parametrize("first", [True, False])
def test_relay_is_ignored_even_by_the_topic_check(
    authorities: Authorities, tmp_path: Path, effect: str, first: bool
) -> None:
    parts = [rule(effect, RELAY_X), rule("allow", PUBLISH_X)]
    rules = "".join(parts if first else reversed(parts))
    assert asked(authorities, tmp_path, rules, ("publish", "rt/x", ()), ("subscribe", "rt/x", ())) == [True, False]


def test_a_denied_direction_denies_the_topic_unless_an_allow_rule_precedes_it(
    authorities: Authorities, tmp_path: Path
) -> None:
    deny, allow = rule("deny", SUBSCRIBE_X), rule("allow", PUBLISH_X)
    question: tuple[str, str, Sequence[str]] = ("publish", "rt/x", ())
    assert asked(authorities, tmp_path / "after", deny + allow, question) == [False]
    assert asked(authorities, tmp_path / "before", allow + deny, question) == [True]


@pytest.mark.parametrize(
    ("listed", "answers"),
    [
        (None, (True, True, False, False)),
        (("",), (True, True, False, False)),
        (("a",), (False, False, True, False)),
        (("a", ""), (True, True, True, False)),
        (("*",), (True, True, True, True)),
        ((), (False, False, False, False)),
    ],
)
def test_partitions(
    authorities: Authorities, tmp_path: Path, listed: Sequence[str] | None, answers: tuple[bool, ...]
) -> None:
    partitions: list[Sequence[str]] = [(), ("",), ("a",), ("*",)]
    questions: list[tuple[str, str, Sequence[str]]] = [("publish", "rt/x", each) for each in partitions]
    rules = rule("allow", criteria("publish", ["rt/x"], listed))
    assert asked(authorities, tmp_path, rules, *questions) == list(answers)


@pytest.mark.parametrize(
    ("subject", "valid"),
    [
        ("CN=/robot,OU=4f3a", True),
        ("OU=4f3a,CN=/robot", True),
        ("CN=/robot, OU=4f3a", False),
        ("CN=/robot", False),
        ("CN=/robot/camera,OU=99", False),
    ],
)
def test_a_second_rdn_binds_the_grant_to_its_identity(
    authorities: Authorities, tmp_path: Path, subject: str, valid: bool
) -> None:
    rdns = [(NameOID.ORGANIZATIONAL_UNIT_NAME, "4f3a"), (NameOID.COMMON_NAME, "/robot")]
    folder = authorities.enclave(tmp_path, rule("allow", PUBLISH_X), subject=subject, rdns=rdns)
    with CycloneAccessControl(folder) as access:
        assert access.valid is valid


def test_without_a_second_rdn_an_identity_selects_the_grant_of_a_longer_path(
    authorities: Authorities, tmp_path: Path
) -> None:
    folder = authorities.enclave(tmp_path, rule("allow", PUBLISH_X), name="/robot", subject="CN=/robot/camera")
    with CycloneAccessControl(folder) as access:
        assert access.allows("publish", "rt/x")


@pytest.mark.parametrize(
    ("name", "subject", "valid"),
    [
        ("/a" * 26, "CN=/a", True),
        ("/a" + "/b" * 25, "CN=/a/b", True),
        ("/a" + "/b" * 25, "CN=/a", False),
        ("/a", "CN=" + "/a" * 19, True),
        ("/a", "CN=" + "/a" * 20, False),
        ("/a" * 26, "CN=" + "/a" * 26, False),
    ],
    ids=lambda value: f"{value[:8]}…{value.count('/')}" if isinstance(value, str) else str(value),
)
def test_of_a_grant_twenty_parts_are_read_and_of_an_identity_all(
    authorities: Authorities, tmp_path: Path, name: str, subject: str, valid: bool
) -> None:
    folder = authorities.enclave(tmp_path, rule("allow", PUBLISH_X), name=name, subject=subject)
    with CycloneAccessControl(folder) as access:
        assert access.valid is valid
        assert access.allows("publish", "rt/x") is valid
    assert parts_occur(subject, f"CN={name}") is valid


@pytest.mark.parametrize(
    ("expression", "yes", "no"),
    [
        ("rt/*", ["rt/", "rt/a", "rt/a/b"], ["rt", "rr/a"]),
        ("a?c", ["abc", "a/c"], ["ac", "abbc"]),
        ("[a-c]x", ["ax", "cx", "]x"], ["dx"]),
        ("[!a]x", ["bx"], ["ax", "]x"]),
        ("[*]", ["*", "]"], ["a"]),
        ("[a]-x", ["a", "x"], ["a-x"]),
        ("[^a]", ["^", "a"], ["b"]),
        (r"\*", ["\\", r"\a"], ["*"]),
    ],
)
def test_matcher(expression: str, yes: Sequence[str], no: Sequence[str]) -> None:
    assert [name for name in [*yes, *no] if ac_fnmatch(expression.encode(), name.encode())] == list(yes)
