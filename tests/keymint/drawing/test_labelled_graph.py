# SPDX-License-Identifier: Apache-2.0
"""Labels, counts and selections."""

from __future__ import annotations

import pytest

from keymint.api.graph import ConfusionMatrix, EdgeOutcome
from keymint.drawing.labelled_graph import (
    LabelledGraph,
    choose_subjects,
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
