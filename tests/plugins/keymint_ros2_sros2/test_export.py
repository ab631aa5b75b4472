# SPDX-License-Identifier: Apache-2.0
"""Exports are exact or refused, and importing them again gives the same meaning, by the prover."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_sros2 import policy_type

import comarmor
from comarmor.data import locate
from comarmor.errors import ComArmorError
from keymint.api import ExportedPolicy, ImportedSubject, ImportRequest
from keymint.ir import SubjectRules
from tests import generated
from tests.conftest import CHECKOUT
from tests.effort import tries

from .test_translate import is_same

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d" / "foxy"
EXAMPLES = ("action", "add_two_ints", "fleet", "ppac_2018/policy.xml", "talker_listener")
FURTHER = ("/r1/talker", "/robot/ui", "/x/planner")


def exported(path: Path, *, lossy: bool = False, further: tuple[str, ...] = ()) -> ExportedPolicy:
    policy = comarmor.load(path, library=LIBRARY)
    subjects = [*policy.subjects(), *(name for name in further if policy.applicable(name))]
    return policy_type.exported(
        [SubjectRules(each, policy.rules(each)) for each in dict.fromkeys(subjects)], lossy=lossy
    )


def returns(found: ExportedPolicy, folder: Path) -> bool:
    """Tell whether the exported policy means what it says it does, and an import of it the same."""
    path = folder / "policy.xml"
    path.write_bytes(found.document)
    again = {
        (each.rules.subject, implicit): each
        for implicit in (False, True)
        for each in policy_type.translated(ImportRequest(path, "new.xml", LIBRARY, implicit=implicit)).subjects
    }
    return all(
        is_same(each)
        and is_same(
            ImportedSubject(again[each.rules.subject, _has_graph(each)].rules, each.document, each.subject_name)
        )
        for each in found.subjects
    )


def _has_graph(subject: ImportedSubject) -> bool:
    return b"ros_discovery_info" in subject.document


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples(tmp_path: Path, name: str) -> None:
    found = exported(CHECKOUT / "examples" / name, lossy=True)
    assert found.subjects
    assert returns(found, tmp_path)
    lost = {each.code for each in found.diagnostics}
    expected = {"fleet": {"sros2-audit"}, "ppac_2018/policy.xml": {"sros2-unsayable", "sros2-graph"}}
    assert lost <= expected.get(name, set())


def test_random_policies(tmp_path: Path) -> None:
    said = refused = 0
    codes_seen: set[str] = set()
    for seed in range(tries(20, 300)):
        path = tmp_path / "source.xml"
        path.write_text(generated.pretty(generated.tokens(seed)))
        try:
            found = exported(path, lossy=True, further=FURTHER)
        except ComArmorError as error:
            codes_seen |= {each.code for each in error.diagnostics}
            refused += 1
            continue
        if found.subjects:
            assert returns(found, tmp_path), seed
            said += 1
    assert said > refused / 4
    assert codes_seen <= {"sros2-unsayable"}


def write(path: Path, rules: str, subject: str = "/a") -> Path:
    path.write_text(f'<profiles><profile name="p"><attachment>{subject}</attachment>{rules}</profile></profiles>')
    return path


def topic(name: str, effect: str = "ALLOW", more: str = "") -> str:
    attachment = f"<attachment>{name}</attachment>"
    return f'<topic qualifier="{effect}">{attachment}<permissions><publish/></permissions>{more}</topic>'


def codes(path: Path, **options: bool) -> list[str]:
    with pytest.raises(ComArmorError) as caught:
        exported(path, **options)
    assert all(each.where is not None and each.where.line for each in caught.value.diagnostics)
    return [each.code for each in caught.value.diagnostics]


def test_what_only_allows_can_be_left_out(tmp_path: Path) -> None:
    path = write(tmp_path / "p.xml", topic("own") + topic("rt/x"))
    assert codes(path) == ["sros2-unsayable"]
    found = exported(path, lossy=True)
    assert [each.code for each in found.diagnostics] == ["sros2-unsayable", "sros2-graph"]
    assert [rule.expressions for rule in found.subjects[0].rules.rules] == [("rt/x",)]
    assert returns(found, tmp_path)


def test_a_denial_is_never_left_out(tmp_path: Path) -> None:
    path = write(tmp_path / "p.xml", topic("rq/xRequest", "DENY") + topic("rt/x"))
    assert codes(path) == codes(path, lossy=True) == ["sros2-unsayable"]


@pytest.mark.parametrize("subject", ["/" + "a" * 64, "/a/" + "b" * 62])
def test_a_path_that_no_certificate_of_sros2_holds(tmp_path: Path, subject: str) -> None:
    path = write(tmp_path / "p.xml", topic("rt/x"), subject)
    assert codes(path, lossy=True) == ["sros2-path"]


def test_the_document(tmp_path: Path) -> None:
    rules = (
        '<ros_service qualifier="ALLOW"><attachment>/s</attachment><permissions><ros_call/><ros_execute/></permissions>'
        "</ros_service>"
    )
    found = exported(write(tmp_path / "p.xml", rules, "/robot/a"))
    assert b'<enclave path="/robot/a">' in found.document
    assert b'<profile ns="/robot" node="a">' in found.document
    assert b'<services request="ALLOW" reply="ALLOW">' in found.document
    assert [each.code for each in found.diagnostics] == ["sros2-graph"]


def raw(effect: str, permission: str, *names: str, more: str = "") -> str:
    attachments = "".join(f"<attachment>{name}</attachment>" for name in names)
    return f'<topic qualifier="{effect}">{attachments}<permissions><{permission}/></permissions>{more}</topic>'


@pytest.mark.parametrize("effect", ["ALLOW", "DENY"])
@pytest.mark.parametrize(
    ("request_by", "reply_by", "attribute"), [("publish", "subscribe", "request"), ("subscribe", "publish", "reply")]
)
def test_raw_topics_that_form_a_service(
    tmp_path: Path, effect: str, request_by: str, reply_by: str, attribute: str
) -> None:
    rules = raw(effect, request_by, "rq/sRequest", "rq/a*Request") + raw(effect, reply_by, "rr/sReply", "rr/a*Reply")
    found = exported(write(tmp_path / "p.xml", rules))
    assert f'<services {attribute}="{effect}">'.encode() in found.document
    assert b"<service>/s</service>" in found.document
    assert b"<service>/a*</service>" in found.document
    assert returns(found, tmp_path)


@pytest.mark.parametrize(
    "rules",
    [
        raw("ALLOW", "publish", "rq/sRequest"),
        raw("ALLOW", "publish", "rq/sRequest", "rr/sReply"),
        raw("ALLOW", "publish", "rq/sRequest") + raw("DENY", "subscribe", "rr/sReply"),
        raw("ALLOW", "publish", "rq/sRequest") + raw("ALLOW", "subscribe", "rr/tReply"),
        raw("ALLOW", "publish", "rq/sRequest")
        + raw("ALLOW", "subscribe", "rr/sReply", more="<partitions><partition>p</partition></partitions>"),
    ],
)
def test_raw_topics_that_form_none(tmp_path: Path, rules: str) -> None:
    assert set(codes(write(tmp_path / "p.xml", rules))) == {"sros2-unsayable"}


def test_a_partition_beside_a_service(tmp_path: Path) -> None:
    rules = raw("ALLOW", "publish", "rq/sRequest") + raw("ALLOW", "subscribe", "rr/sReply")
    beside = raw("ALLOW", "publish", "rq/sRequest", more="<partitions><partition>p</partition></partitions>")
    path = write(tmp_path / "p.xml", rules + beside)
    assert codes(path) == ["sros2-unsayable"]
    assert returns(exported(path, lossy=True), tmp_path)
