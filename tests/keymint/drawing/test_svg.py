# SPDX-License-Identifier: Apache-2.0
"""Pictures as SVG."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st
from lxml import etree

from keymint.api.graph import MISMATCHES, Object
from keymint.drawing.appearance import Theme
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph, select_edges
from keymint.drawing.other_formats import dot
from keymint.drawing.simplify import DrawingOptions, Split, shown_edges
from keymint.drawing.svg import svg

from .graphs import ALLOWED, DENIED, EXPRESSLY_DENIED, HOSTILE, edge, fleet, graphs, hostile, labelled, one_of_each

NS = {"s": "http://www.w3.org/2000/svg"}


def tree(document: bytes) -> etree._Element:
    return etree.fromstring(document)


def classes(root: etree._Element) -> dict[str, str]:
    """Return the classes of the drawn edges by what their tooltip begins with."""
    found = root.xpath("//s:g[contains(concat(' ', @class, ' '), ' edge ')]", namespaces=NS)
    return {edge.findtext("s:title", namespaces=NS).split(" - ")[0]: edge.get("class") for edge in found}


def legend(root: etree._Element) -> list[str]:
    return root.xpath("//s:g[@class='legend']//s:text/text()", namespaces=NS)


def test_labels_are_drawn_as_in_the_paper() -> None:
    drawn = classes(tree(svg(one_of_each())))
    assert drawn == {
        "/talker ros_publish /chatter": "edge allow true",
        "/talker ros_subscribe /chatter": "edge deny true",
        "/listener ros_subscribe /chatter": "edge deny false",
        "/listener ros_call /talker/set_parameters": "edge danger false",
    }
    style = tree(svg(one_of_each())).findtext("s:style", namespaces=NS)
    assert ".keymint .true .curve{stroke-dasharray" in style
    assert ".keymint .false .curve{stroke-width:3" in style


def test_arrows_follow_the_role() -> None:
    graph = LabelledGraph.of(
        "t", [labelled("/a", permission, "/t", ALLOWED) for permission in ("ros_publish", "ros_subscribe")], ["/a"]
    )
    root = tree(svg(graph))
    tips = {
        edge.findtext("s:title", namespaces=NS).split()[1]: float(
            edge.xpath("s:path[2]/@d", namespaces=NS)[0][1:].split()[0]
        )
        for edge in root.xpath("//s:g[starts-with(@class, 'edge')]", namespaces=NS)
    }
    right_of_subject = float(root.xpath("//s:g[@class='box subject']/s:rect/@width", namespaces=NS)[-1])
    left_of_object = float(root.xpath("//s:g[@class='box ros_topic']/s:rect/@x", namespaces=NS)[-1])
    assert tips == {"ros_publish": left_of_object, "ros_subscribe": right_of_subject}


def test_legend_contains_only_what_is_drawn() -> None:
    assert legend(tree(svg(one_of_each()))) == [
        "subject",
        "topic",
        "service",
        "to the object: publish",
        "to the subject: subscribe, call",
        "allowed (true positive)",
        "denied (true negative)",
        "DANGER: allowed, but the policy denies it (false positive)",
        "denied, but the policy allows it (false negative)",
    ]
    plain = LabelledGraph.of("t", [labelled("/a", "ros_request", "/go", None)])
    assert legend(tree(svg(plain))) == ["subject", "action", "to the subject: request"]


def test_expressions_and_audit_are_marked() -> None:
    audited = labelled("/a", "ros_publish", "/robot/*", DENIED)
    found = type(audited)(audited.edge, audited.policy, (), audit=True)
    graph = LabelledGraph.of("t", [found], patterns=[Object("ros_topic", "/robot/*")])
    root = tree(svg(graph))
    assert {"expression", "AUDIT rule"} <= set(legend(root))
    assert root.xpath("//s:g[contains(@class, 'pattern') and contains(@class, 'ros_topic')]", namespaces=NS)
    assert root.xpath("//s:g[@class='edge deny']/s:circle", namespaces=NS)


def test_only_mismatches() -> None:
    graph = select_edges(one_of_each(), only=MISMATCHES)
    assert set(classes(tree(svg(graph))).values()) == {"edge deny false", "edge danger false"}


def test_a_panel_for_each() -> None:
    graph = LabelledGraph.of(
        "t", [labelled(name, "ros_publish", "/t", ALLOWED) for name in ("/r1/a", "/r1/b", "/r2/a")]
    )
    headings = "//s:text[@class='heading']/text()"
    by_subject = tree(svg(graph, DrawingOptions(split=Split.SUBJECT)))
    assert by_subject.xpath(headings, namespaces=NS) == ["/r1/a", "/r1/b", "/r2/a"]
    assert tree(svg(graph, DrawingOptions(split=Split.NAMESPACE))).xpath(headings, namespaces=NS) == ["/r1/", "/r2/"]


def test_objects_with_the_same_edges_are_folded() -> None:
    names = [f"/a/{name}" for name in "bcd"]
    graph = LabelledGraph.of("t", [labelled("/a", "ros_execute", name, ALLOWED) for name in (*names, "/other")])
    root = tree(svg(graph, DrawingOptions(fold=True)))
    labels = root.xpath("//s:g[@class='box ros_service']/s:text/text()", namespaces=NS)
    assert sorted(labels)[:2] == ["/a/… (3 services)", "/other"]
    assert "/a/b\n/a/c\n/a/d" in root.xpath("//s:g[@class='box ros_service']/s:title/text()", namespaces=NS)
    assert "drawn as one" in root.findtext("s:desc", namespaces=NS)


def test_objects_with_different_edges_are_not_folded() -> None:
    graph = LabelledGraph.of(
        "t",
        [
            labelled("/a", "ros_execute", "/a/b", ALLOWED, ALLOWED),
            labelled("/a", "ros_execute", "/a/c", ALLOWED, DENIED),
        ],
        transports=["t"],
    )
    assert len(classes(tree(svg(graph, DrawingOptions(fold=True))))) == 2


def test_important_edges_stay_beyond_the_limit() -> None:
    denied = [labelled("/a", "ros_publish", f"/d{at}", DENIED, DENIED) for at in range(20)]
    wrong = [labelled("/a", "ros_publish", f"/w{at}", DENIED, ALLOWED) for at in range(3)]
    graph = LabelledGraph.of("t", [*denied, *wrong], transports=["t"])
    assert {one.edge.object.name for one in shown_edges(graph.edges, DrawingOptions(limit=10))} == {"/w0", "/w1", "/w2"}
    assert len(shown_edges(graph.edges, DrawingOptions(limit=2))) == 3
    root = tree(svg(graph, DrawingOptions(limit=10, fold=False)))
    assert "20 of 23 lines left out" in root.findtext("s:desc", namespaces=NS)


@given(graphs(), st.sampled_from(Theme), st.sampled_from(Split), st.sampled_from([None, True, False]))
def test_every_graph_is_a_well_formed_picture(
    graph: LabelledGraph, theme: Theme, split: Split, fold: bool | None
) -> None:
    root = tree(svg(graph, DrawingOptions(theme, split, 0, fold=fold)))
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    if fold is False:
        assert len(root.xpath("//s:g[starts-with(@class, 'edge')]", namespaces=NS)) == len(graph.edges)


def test_hostile_names_are_escaped() -> None:
    root = tree(svg(hostile()))
    assert {etree.QName(node).localname for node in root.iter()} <= {
        *("svg", "title", "desc", "style", "rect", "text", "g", "path", "circle"),
    }
    assert "\u202e" not in svg(hostile()).decode()


def test_an_empty_graph_is_a_picture() -> None:
    assert tree(svg(LabelledGraph.of("nothing", []))).findtext("s:desc", namespaces=NS).startswith("no subjects")


def test_nothing_is_fetched() -> None:
    document = svg(one_of_each()).decode().replace('xmlns="http://www.w3.org/2000/svg"', "")
    assert not re.search(r"https?:|href|url\(|@import", document)


COMMON = LabelledEdge(edge("/a", "ros_publish", "ros_topic", "/rosout"), ALLOWED, common=True)


def texts(root: etree._Element) -> list[str]:
    return root.xpath("//s:g[@class='panel']//s:text/text()", namespaces=NS)


def test_common_rules_become_a_mark_at_the_subject() -> None:
    own = labelled("/a", "ros_publish", "/chatter", ALLOWED)
    graph = LabelledGraph.of("t", [COMMON, own])
    root = tree(svg(graph))
    assert sorted(texts(root)) == ["+1 common", "/a", "/chatter"]
    assert "what every node may do (--common draws it)" in legend(root)
    assert "1 common edge shown as marks" in root.findtext("s:desc", namespaces=NS)
    assert "/a ros_publish /rosout" in root.xpath("string(//s:g[s:text='+1 common']/s:title)", namespaces=NS)
    assert sorted(texts(tree(svg(graph, DrawingOptions(common=True))))) == ["/a", "/chatter", "/rosout"]
    assert "+1 common" in dot(graph).decode()


def test_a_fleet_is_grouped_by_namespace() -> None:
    root = tree(svg(fleet(10)))
    assert sorted(texts(root)) == ["/estop", "/fleet/state", *(f"/robot{at}/… (4 subjects)" for at in range(10))]
    assert "grouped by namespace" in root.findtext("s:desc", namespaces=NS)
    assert len(classes(root)) == 11
    title = root.xpath("string(//s:g[s:text='/robot3/… (4 subjects)']/s:title)", namespaces=NS)
    assert title == "\n".join(f"/robot3/node{at}" for at in range(4))
    assert "/robot0/node0" in texts(tree(svg(fleet(10), DrawingOptions(group=False))))
    assert "/robot0/node0" in texts(tree(svg(fleet(7))))
    assert "/robot0/… (4 subjects)" in texts(tree(svg(fleet(7), DrawingOptions(group=True))))


def test_a_group_shows_every_label_of_its_members() -> None:
    edges = [
        *(labelled(f"/r/n{at}", "ros_publish", "/t", ALLOWED, ALLOWED) for at in range(20)),
        *(labelled(f"/r/n{at}", "ros_publish", "/t", EXPRESSLY_DENIED, DENIED) for at in range(20, 30)),
        labelled("/r/n30", "ros_publish", "/t", DENIED, ALLOWED),
        labelled("/s/n", "ros_publish", "/t", ALLOWED, ALLOWED),
    ]
    root = tree(svg(LabelledGraph.of("t", edges, transports=["x"])))
    drawn = root.xpath("//s:g[contains(@class, ' false') or contains(@class, ' true')][s:title]/@class", namespaces=NS)
    assert sorted(drawn) == ["edge allow true", "edge allow true", "edge danger false", "edge deny true"]


def test_hostile_is_hostile() -> None:
    assert {"<", ">", '"', "'", "&", "\x01", "\u202e"} <= set(HOSTILE)


def test_subtitle_is_never_cut_off() -> None:
    """A line of monospaced text fits into the picture's width, and the legend begins below the last one."""
    said = "a_transport_of_a_long_name_that_has_to_be_said_as_well"
    edges = [
        labelled(f"/robot{robot}/node{node}", "ros_publish", f"/robot{robot}/topic{node}", ALLOWED, ALLOWED)
        for robot in range(6)
        for node in range(10)
    ]
    root = tree(svg(LabelledGraph.of("t", edges, transports=[said])))
    width, margin = float(root.get("width")), 24.0
    lines = root.xpath("/s:svg/s:text[@class='muted']", namespaces=NS)
    assert len(lines) > 1
    assert " ".join(line.text for line in lines) == root.findtext("s:desc", namespaces=NS)
    assert all(margin + len(line.text) * 7.3 <= width for line in lines)
    (at,) = root.xpath("/s:svg/s:g[@class='legend']/@transform", namespaces=NS)
    assert float(at.rstrip(")").split()[1]) > max(float(line.get("y")) for line in lines)
