# SPDX-License-Identifier: Apache-2.0
"""Labels, counts and selections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from keymint_ros2_comarmor import policy_type

from comarmor.errors import Origin
from keymint.api import PolicySource
from keymint.api.graph import ConfusionMatrix, Edge, EdgeOutcome, Graph, Object, complete
from keymint.drawing import labelled_graph as room
from keymint.drawing.labelled_graph import (
    DrawnPolicy,
    LabelledGraph,
    choose_subjects,
    label_graph,
    policy_graph,
    select_edges,
)
from keymint.errors import KeymintError

from .graphs import ALLOWED, DENIED, labelled, one_of_each


@pytest.mark.parametrize(
    ("policy", "transports", "outcome"),
    [
        (None, (), EdgeOutcome.UNLABELLED),
        (None, (ALLOWED, DENIED), EdgeOutcome.DENY),
        (ALLOWED, (), EdgeOutcome.ALLOW),
        (DENIED, (None,), EdgeOutcome.DENY),
        (ALLOWED, (ALLOWED, None), EdgeOutcome.ALLOW),
        (ALLOWED, (ALLOWED, DENIED), EdgeOutcome.FALSE_NEGATIVE),
        (DENIED, (DENIED, ALLOWED), EdgeOutcome.FALSE_POSITIVE),
    ],
)
def test_outcome(policy, transports, outcome) -> None:
    assert labelled("/a", "ros_publish", "/t", policy, *transports).outcome() is outcome


def test_outcome_of_one_transport() -> None:
    found = labelled("/a", "ros_publish", "/t", ALLOWED, ALLOWED, DENIED)
    assert [found.outcome(0), found.outcome(1)] == [EdgeOutcome.ALLOW, EdgeOutcome.FALSE_NEGATIVE]


def test_confusion_is_counted_or_given() -> None:
    assert one_of_each().confusion(0) == ConfusionMatrix(1, 1, 1, 1)
    counted = ConfusionMatrix(100, 0, 0, 900)
    given = LabelledGraph.of("t", one_of_each().edges, transports=["omg"], confusions=[counted])
    assert given.confusion(0) == counted


def test_an_edge_that_was_not_asked_is_not_counted() -> None:
    graph = LabelledGraph.of("t", [labelled("/a", "ros_publish", "/t", ALLOWED, None)], transports=["omg"])
    assert graph.confusion(0) == ConfusionMatrix(0, 0, 0, 0)


def test_choose() -> None:
    known = ["/robot1", "/robot1/arm", "/robot10/arm", "/fleet"]
    assert choose_subjects(known) == ("/fleet", "/robot1", "/robot1/arm", "/robot10/arm")
    assert choose_subjects(known, namespaces=["/robot1/"]) == ("/robot1", "/robot1/arm")
    assert choose_subjects(known, ["/fleet"], ["/robot10"]) == ("/fleet", "/robot10/arm")


@pytest.mark.parametrize(("asked", "hint"), [(["/flet"], "did you mean '/fleet'?"), (["zzz"], "there are /fleet")])
def test_choose_an_unknown_subject(asked: list[str], hint: str) -> None:
    with pytest.raises(KeymintError) as caught:
        choose_subjects(["/fleet"], asked)
    assert hint in caught.value.diagnostics[0].help


def test_choose_an_unknown_namespace() -> None:
    with pytest.raises(KeymintError, match="no subject in the namespace"):
        choose_subjects(["/fleet/a"], namespaces=["/flee"])


def test_select() -> None:
    graph = one_of_each()
    assert select_edges(graph, subjects={"/talker"}).subjects == ("/talker",)
    assert {one.edge.subject for one in select_edges(graph, subjects={"/talker"}).edges} == {"/talker"}
    assert [one.outcome() for one in select_edges(graph, only={EdgeOutcome.DENY}).edges] == [EdgeOutcome.DENY]


RULE = """<{kind} qualifier="{effect}"{more}><attachment>{name}</attachment><permissions><{permission}/></permissions>
</{kind}>"""


def rule(kind: str, permission: str, name: str, effect: str = "ALLOW", more: str = "") -> str:
    return RULE.format(kind=kind, permission=permission, name=name, effect=effect, more=more)


Load = Callable[..., DrawnPolicy]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Load a policy of profiles: rules by attachment."""

    def loaded(**profiles: str) -> DrawnPolicy:
        body = "".join(
            f'<profile name="{name}"><attachment>{name.replace("_", "/")}</attachment>\n{rules}</profile>\n'
            for name, rules in profiles.items()
        )
        path = tmp_path / "policy.xml"
        path.write_text(f"<profiles>\n{body}</profiles>\n")
        return DrawnPolicy(policy_type.load([PolicySource("p", path, Origin("p"))], None), "p")

    return loaded


def drawn(graph: LabelledGraph) -> dict[str, EdgeOutcome]:
    return {f"{one.edge.subject} {one.edge.permission} {one.edge.object.name}": one.outcome() for one in graph.edges}


def test_allowed_and_expressly_denied(load: Load) -> None:
    policy = load(
        _a=rule("ros_topic", "ros_publish", "/t") + rule("ros_topic", "ros_subscribe", "/t", "DENY"),
        _b=rule("ros_topic", "ros_subscribe", "/t"),
    )
    assert drawn(policy_graph("t", policy)) == {
        "/a ros_publish /t": EdgeOutcome.ALLOW,
        "/a ros_subscribe /t": EdgeOutcome.DENY,
        "/b ros_subscribe /t": EdgeOutcome.ALLOW,
    }


def test_everything(load: Load) -> None:
    policy = load(_a=rule("ros_topic", "ros_publish", "/t"), _b=rule("ros_service", "ros_call", "/s"))
    graph = policy_graph("t", policy, everything=True)
    assert len(graph.edges) == 8
    assert graph.counts[EdgeOutcome.ALLOW] == 2


def test_expressions_stand_for_themselves(load: Load) -> None:
    policy = load(
        _a=rule("ros_topic", "ros_subscribe", "/r/*")
        + rule("ros_topic", "ros_subscribe", "/r/private/*", "DENY")
        + rule("ros_topic", "ros_subscribe", "/r/[ab]?"),
        _b=rule("ros_topic", "ros_publish", "/r/scan"),
    )
    graph = policy_graph("t", policy)
    assert drawn(graph) == {
        "/a ros_subscribe /r/*": EdgeOutcome.ALLOW,
        "/a ros_subscribe /r/private/*": EdgeOutcome.DENY,
        "/a ros_subscribe /r/[ab]?": EdgeOutcome.ALLOW,
        "/a ros_subscribe /r/scan": EdgeOutcome.ALLOW,
        "/b ros_publish /r/scan": EdgeOutcome.ALLOW,
    }
    assert {found.name for found in graph.patterns} == {"/r/*", "/r/private/*", "/r/[ab]?"}


def test_an_expression_under_a_wider_deny_is_denied(load: Load) -> None:
    policy = load(_a=rule("ros_topic", "ros_publish", "/r/*") + rule("ros_topic", "ros_publish", "*", "DENY"))
    assert drawn(policy_graph("t", policy))["/a ros_publish /r/*"] is EdgeOutcome.DENY


def test_an_escaped_name_is_a_name(load: Load) -> None:
    graph = policy_graph("t", load(_a=rule("topic", "publish", r"a\*b")))
    assert drawn(graph) == {"/a publish a*b": EdgeOutcome.ALLOW}
    assert not graph.patterns


def test_why_and_where(load: Load) -> None:
    policy = load(_a=rule("ros_topic", "ros_publish", "/t", more=' modifier="AUDIT"'))
    (one,) = policy_graph("t", replace(policy, typed=lambda file: Path(file).name)).edges
    assert one.audit
    assert one.policy.where is not None
    assert (one.policy.where.file, one.policy.where.line) == ("policy.xml", 3)
    assert "policy.xml" not in one.policy.reason


def test_a_graph_labelled_by_a_policy(load: Load) -> None:
    policy = load(_a=rule("ros_topic", "ros_publish", "/t"))
    graph = Graph.of(
        [Edge("/a", "ros_publish", Object("ros_topic", "/t")), Edge("/b", "ros_publish", Object("ros_topic", "/t"))]
    )
    assert drawn(label_graph("t", policy, graph, graph.subjects)) == {
        "/a ros_publish /t": EdgeOutcome.ALLOW,
        "/b ros_publish /t": EdgeOutcome.DENY,
    }
    whole = label_graph("t", policy, graph, graph.subjects, everything=True)
    assert [one.edge for one in whole.edges] == list(complete(graph))
    assert {one.edge.subject for one in label_graph("t", policy, graph, ["/b"], everything=True).edges} == {"/b"}


def test_no_subject_is_named_exactly(load: Load) -> None:
    policy = load(**{"_r_*": rule("ros_topic", "ros_publish", "/t")})
    with pytest.raises(KeymintError, match="names no subject exactly"):
        policy_graph("t", policy)
    assert drawn(policy_graph("t", policy, ["/r/x"])) == {"/r/x ros_publish /t": EdgeOutcome.ALLOW}


def test_an_unknown_subject(load: Load) -> None:
    with pytest.raises(KeymintError, match="did you mean '/talker'"):
        policy_graph("t", load(_talker=rule("ros_topic", "ros_publish", "/t")), ["/taker"])


def test_what_is_too_large_is_refused(load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "MOST_EDGES", 3)
    policy = load(_a="".join(rule("ros_topic", "ros_publish", f"/t{at}") for at in range(4)))
    for everything in (True, False):
        with pytest.raises(KeymintError, match="more than 3 edges"):
            policy_graph("t", policy, everything=everything)
