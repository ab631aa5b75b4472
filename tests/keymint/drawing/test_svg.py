# SPDX-License-Identifier: Apache-2.0
"""Pictures as SVG."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

from hypothesis import given, strategies as st
from lxml import etree

from keymint.api.graph import MISMATCHES, Object
from keymint.drawing.appearance import Theme, columns
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph, select_edges
from keymint.drawing.layout import CHARACTER, lay_out_matrix
from keymint.drawing.simplify import DrawingOptions, Split, shown_edges, simplify
from keymint.drawing.svg import draw, svg

from .graphs import (
    ALLOWED,
    DENIED,
    EXPRESSLY_DENIED,
    HOSTILE,
    dot,
    edge,
    fleet,
    graphs,
    hostile,
    labelled,
    names,
    one_of_each,
)

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
    assert "NOT DRAWN: 20 of 23 edges: 20 denied (20 topic)" in root.findtext("s:desc", namespaces=NS)


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


def signs(root: etree._Element) -> list[str]:
    found = root.xpath("//s:g[contains(@class, 'sign') and s:title]", namespaces=NS)
    return [f"{sign.get('class')} {sign.findtext('s:text', namespaces=NS)}" for sign in found]


def test_robots_that_are_alike_are_drawn_once() -> None:
    root = tree(svg(fleet(10)))
    assert sorted(texts(root)) == ["/estop", "/fleet/state", "/robot0/node0", "/robot0/node1", "39 alike"]
    assert "39 subjects like /robot0/node1 (" in root.findtext("s:desc", namespaces=NS)
    assert "no edge is left out" in root.findtext("s:desc", namespaces=NS)
    assert len(classes(root)) == 3
    assert "/robot0/node3\n" in root.xpath("string(//s:g[s:text='/robot0/node1']/s:title)", namespaces=NS)
    assert "/robot9/node3" in texts(tree(svg(fleet(10), DrawingOptions(fold=False, group=False))))
    assert "/robot0/node3" in texts(tree(svg(fleet(7))))


def test_a_matrix_says_whom_each_sign_concerns() -> None:
    edges = [
        *(labelled(f"/r/n{at}", "ros_publish", "/t", ALLOWED, ALLOWED) for at in range(20)),
        *(labelled(f"/r/n{at}", "ros_publish", "/t", EXPRESSLY_DENIED, DENIED) for at in range(20, 30)),
        labelled("/r/n30", "ros_subscribe", "/t", DENIED, ALLOWED),
        labelled("/s/n", "ros_publish", "/t", ALLOWED, ALLOWED),
    ]
    root = tree(svg(LabelledGraph.of("t", edges, transports=["x"]), DrawingOptions(fold=False)))
    assert Counter(signs(root)) == {
        "edge sign allow true P": 21,
        "edge sign deny true P": 10,
        "edge sign danger false S!": 1,
    }
    headings = root.xpath("//s:text[@class='heading']/text()", namespaces=NS)
    assert headings == ["/r/ 1 to 30", "/r/ 31 to 31", "/s/"]
    assert {"to the object: P publish", "to the subject: S subscribe"} <= set(legend(root))


@given(graphs())
def test_every_edge_of_a_matrix_has_a_place_of_its_own(graph: LabelledGraph) -> None:
    panel = lay_out_matrix(graph.edges, graph.subjects, names(graph.edges, graph.subjects), {})
    places = {(sign.x1, sign.y1) for sign in panel.lines}
    assert len(places) == len(panel.lines) == len(graph.edges)
    boxes = {box.key: box for box in panel.boxes}
    for sign in panel.lines:
        column, row = boxes[sign.labelled.edge.subject], boxes[sign.labelled.edge.domain_object]
        assert column.x < sign.x1 < column.x + column.width
        assert row.y < sign.y1 < row.y + row.height
        assert sign.x1 < panel.width
    for box in panel.boxes:
        length = box.height if isinstance(box.key, str) else box.width
        assert columns(box.label) * CHARACTER < length
    drawn = simplify(graph, DrawingOptions(group=True, fold=False))
    assert len(signs(tree(draw(drawn).encode()))) == len(drawn.stands)


def test_what_it_is_made_of_is_below() -> None:
    made = ("keymint 1, 2027-01-15", "policy sha256 " + 64 * "f")
    root = tree(svg(replace(one_of_each(), made=made)))
    assert tuple(root.xpath("/s:svg/s:text[contains(@class, 'made')]/text()", namespaces=NS)) == made
    assert float(root.get("height")) > max(map(float, root.xpath("/s:svg/s:text/@y", namespaces=NS)))
    assert "policy sha256" in dot(replace(one_of_each(), made=made)).decode()


def test_probes_are_marked() -> None:
    graph = LabelledGraph.of("t", [labelled("/a", "ros_publish", "/imagex", DENIED, DENIED)], transports=["x"])
    root = tree(svg(replace(graph, probes=frozenset({graph.edges[0].edge.object}))))
    assert "name made up to probe a pattern" in legend(root)
    assert "probe" in root.xpath("string(//s:g[s:text='/imagex']/@class)", namespaces=NS)


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
