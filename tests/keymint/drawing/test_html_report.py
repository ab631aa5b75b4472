# SPDX-License-Identifier: Apache-2.0
"""The HTML report as a document; ``test_html_report_in_chromium.py`` uses it in a browser."""

from __future__ import annotations

import base64
import hashlib
import re

import pytest
from hypothesis import given, settings
from lxml import html

from keymint.api.graph import ConfusionMatrix
from keymint.drawing.appearance import KIND_NAMES
from keymint.drawing.html_report import html_report
from keymint.drawing.labelled_graph import LabelledGraph

from .graphs import ALLOWED, DENIED, HOSTILE, graphs, hostile, labelled, one_of_each
from .test_appearance import contrast

SOURCES = {"policy.xml": b"<profiles>\n  <!-- <b>&amp;\x01 -->\n  <rule/>\n</profiles>\n"}


def page(graph: LabelledGraph) -> html.HtmlElement:
    return html.document_fromstring(html_report(graph, SOURCES))


def test_what_a_subject_may_do_and_why() -> None:
    rows = {
        " ".join(row.xpath("td[position()<3]//text()")): row
        for row in page(one_of_each()).xpath("//section[h3//text()='/listener']//tr[@data-v]")
    }
    assert len(rows) == 2
    row = next(row for text, row in rows.items() if "ros_subscribe" in text)
    assert row.get("data-v") == "false-negative"
    assert "✓ allowed" in row.text_content()
    assert "✗ denied (unlike the policy)" in row.text_content()
    assert row.xpath(".//a[text()='policy.xml:3']/@href") == ["#f0-3"]


def test_false_positives_look_dangerous_in_every_table() -> None:
    document = page(one_of_each())
    found = [
        one for one in document.xpath("//span[contains(., 'allowed')]") if "unlike the policy" in one.text_content()
    ]
    assert found
    for one in found:
        assert "yes" not in one.get("class").split()
        assert one.text_content().startswith("⚠ allowed")


def test_every_link_has_its_place() -> None:
    for graph in (one_of_each(), hostile()):
        document = page(graph)
        places = set(document.xpath("//@id"))
        targets = {target.removeprefix("#") for target in document.xpath("//@href")}
        assert targets <= places
    assert len(document.xpath("//@id")) == len(places)


def test_the_source_is_there_line_by_line() -> None:
    lines = page(one_of_each()).xpath("//ol[@class='code']/li")
    assert [line.get("id") for line in lines[:3]] == ["f0-1", "f0-2", "f0-3"]
    assert [line.text_content() for line in lines[:3]] == ["<profiles>", "  <!-- <b>&amp;\\x01 -->", "  <rule/>"]


def test_the_confusion_of_each_transport() -> None:
    cells = page(one_of_each()).xpath("//section[@id='summary']//tbody/tr/*/text()")
    assert cells == ["omg", "1", "1", "1", "1"]
    counted = LabelledGraph.of("t", one_of_each().edges, transports=["omg"], confusions=[ConfusionMatrix(7, 1, 1, 9)])
    assert page(counted).xpath("//section[@id='summary']//tbody/tr/*/text()") == ["omg", "7", "9", "1", "1"]


def test_differences_are_listed_apart() -> None:
    found = page(one_of_each()).xpath("//section[@id='differences']//tr/@data-v")
    assert sorted(found) == ["false-negative", "false-positive"]
    same = LabelledGraph.of("t", [labelled("/a", "ros_publish", "/t", ALLOWED, ALLOWED)], transports=["omg"])
    assert not page(same).xpath("//section[@id='differences']")


def test_nothing_from_outside_and_nothing_inline() -> None:
    text = html_report(one_of_each(), SOURCES).decode()
    document = html.document_fromstring(text)
    assert not re.findall(r"https?://(?!www\.w3\.org/2000/svg)", text)
    assert not document.xpath("//@src | //@style | //link | //img | //iframe | //object | //embed | //base")
    assert not [name for node in document.iter() for name in node.attrib if name.startswith("on")]


def test_the_policy_of_the_page_allows_its_own_parts_only() -> None:
    text = html_report(one_of_each(), SOURCES).decode()
    policy = html.document_fromstring(text).xpath("//meta[@http-equiv='Content-Security-Policy']/@content")[0]
    directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    for tag in ("style", "script"):
        (content,) = re.findall(f"<{tag}>(.*?)</{tag}>", text, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert directives.pop(f"{tag}-src") == f"'sha256-{digest}'"
    assert directives == {"default-src": "'none'", "base-uri": "'none'", "form-action": "'none'"}


def test_hostile_names_are_escaped() -> None:
    text = html_report(hostile(), {HOSTILE: HOSTILE.encode()}).decode()
    document = html.document_fromstring(text)
    assert not document.xpath("//img")
    assert len(document.xpath("//script")) == len(document.xpath("//style")) == 1
    assert not {"\u202e", "\x01"} & set(text)
    assert "</script></style><img" in document.xpath("//h1")[0].text_content()


@given(graphs(transports=2))
@settings(max_examples=30)
def test_every_edge_is_listed_once(graph: LabelledGraph) -> None:
    document = page(graph)
    assert len(document.xpath("//section[@class='subject-part']//tr[@data-v]")) == len(graph.edges)
    assert len(document.xpath("//section[@class='subject-part']")) == len(graph.subjects)


def test_a_large_graph_says_what_it_leaves_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("keymint.drawing.html_report.MOST_ROWS", most := 200)
    denied = [labelled("/a", "ros_publish", f"/t{at}", DENIED) for at in range(most)]
    allowed = [labelled("/b", "ros_publish", f"/t{at}", ALLOWED) for at in range(5)]
    document = page(LabelledGraph.of("t", [*denied, *allowed]))
    assert len(document.xpath("//section[h3//text()='/b']//tr[@data-v]")) == 5
    note = document.xpath("string(//p[@class='note'])")
    assert note.startswith("NOT LISTED: 5 of these edges: 5 denied (5 topic).")
    assert f"{most + 5} edges" in document.xpath("string(//header)")
    assert [int(one.text) for one in document.xpath("//ul[@class='counts']//strong")] == [5, most]


def test_contrast_of_the_page() -> None:
    style = page(one_of_each()).xpath("string(//style)")
    for block in re.findall(r":root\{([^}]*)\}", style)[:2]:
        colours = dict(re.findall(r"--([\w-]+):(#\w+)", block))
        colours = {
            name: value if len(value) == 7 else "#" + "".join(2 * c for c in value[1:])
            for name, value in colours.items()
        }
        for name in ("text", "muted", "link", "yes", "no", *KIND_NAMES):
            for behind in ("background", "bad", "band"):
                assert contrast(colours[name], colours[behind]) >= 4.5, (name, behind, block[:40])


def test_an_empty_graph_is_a_page() -> None:
    assert page(LabelledGraph.of("nothing", [])).xpath("string(//h1)") == "nothing"
