# SPDX-License-Identifier: Apache-2.0
"""Includes of SROS2 policies: both namespaces, the xpointers in use, and no file outside of the policy's folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_sros2.parse import INCLUDES, parse
from lxml import etree

from comarmor.errors import ComArmorError
from comarmor.language.source import load_tree
from comarmor.xml.reader import Limits
from tests.effort import calls_of

from .sros2_policies import COMMON, DRAFT, LOGGING, XI, enclave, policy


def include(href: str, more: str = 'xpointer="xpointer(/profile/*)"') -> str:
    return f'<xi:include href="{href}" {more}/>'


def names(path: Path) -> list[str]:
    return [entry.text for each in parse(path).enclaves for node in each.nodes() for rules in node.lists
            for entry in rules.entries]  # fmt: skip


@pytest.mark.parametrize("namespace", [XI, DRAFT])
def test_both_namespaces(write, namespace: str) -> None:
    text = policy(enclave("/a", include("logging.xml"))).replace(XI, namespace)
    assert names(write(text, {"logging.xml": LOGGING})) == ["rosout"]


@pytest.mark.parametrize("xpointer", ["xpointer(/profile/*)", "xpointer(/profile/topics)", "xpointer(/*/*)"])
def test_the_rules_of_a_profile(write, xpointer: str) -> None:
    text = policy(enclave("/a", include("logging.xml", f'xpointer="{xpointer}"')))
    assert names(write(text, {"logging.xml": LOGGING})) == ["rosout"]


OTHER = policy(enclave("/b", '<topics publish="ALLOW"><topic>/x</topic></topics>', node="m"))


def test_enclaves_of_another_policy(write) -> None:
    pointer = "xpointer='xpointer(/policy/enclaves/*)'"
    text = policy(include("o.xml", pointer))
    assert [each.path for each in parse(write(text, {"o.xml": OTHER})).enclaves] == ["/b"]


def test_profiles_of_another_policy(write) -> None:
    pointer = "xpointer='xpointer(/policy/enclaves/enclave/profiles/*)'"
    text = policy(f'<enclave path="/a"><profiles>{include("o.xml", pointer)}</profiles></enclave>')
    (found,) = parse(write(text, {"o.xml": OTHER})).enclaves
    assert [node.name for node in found.nodes()] == ["m"]


@pytest.mark.parametrize(
    "text",
    [
        policy(enclave("/a", include("common/node.xml", 'xpointer="xpointer(/profile/topics)"'))),
        policy(enclave("/a", include("common/node.xml", 'xpointer="xpointer(/*/services)"'))),
        policy(
            '<enclave path="/a"><profiles>'
            + include("fleet.xml", 'xpointer="xpointer(/policy/enclaves/enclave/profiles/*)"')
            + "</profiles></enclave>"
        ),
    ],
)
def test_an_xpointer_selects_from_what_is_included_too(write, text: str) -> None:
    """As libxml2 does, by which SROS2 includes: it resolves the includes of a file before it selects from it."""
    everywhere = "xpointer='xpointer(/policy/enclaves/*)'"
    denied = enclave("/b", '<topics subscribe="DENY"><topic>/y</topic></topics>', node="m")
    files = COMMON | {"fleet.xml": policy(include("o.xml", everywhere), denied), "o.xml": OTHER}
    path = write(text, files)
    expected = etree.parse(path)
    expected.xinclude()
    assert names(path) == [each.text for each in expected.iter("topic", "service")]


def test_all_of_an_empty_element_is_nothing(write) -> None:
    path = write(policy(enclave("/a", include("empty.xml") + LOGGING[9:-10])), {"empty.xml": "<profile/>"})
    assert names(path) == ["rosout"]


def test_an_xml_base_does_not_change_silently_what_is_included(write) -> None:
    """Libxml2 reads ``sub/logging.xml`` here."""
    text = policy(enclave("/a", include("logging.xml"))).replace("<profile ", '<profile xml:base="sub/" ')
    with pytest.raises(ComArmorError) as caught:
        parse(write(text, {"logging.xml": LOGGING, "sub/logging.xml": LOGGING}))
    assert [each.code for each in caught.value.diagnostics] == ["include-base"]
    assert names(write(text.replace(include("logging.xml"), LOGGING[9:-10]))) == ["rosout"]


def test_without_an_xpointer_the_root_is_included(write) -> None:
    whole = '<profile ns="/" node="n"><topics publish="ALLOW"><topic>/y</topic></topics></profile>'
    text = policy(f'<enclave path="/a"><profiles>{include("p.xml", "")}</profiles></enclave>')
    assert names(write(text, {"p.xml": whole})) == ["/y"]


def test_a_fragment_in_place_of_a_profile_says_which_xpointer_is_missing(write) -> None:
    text = policy(f'<enclave path="/a"><profiles>{include("logging.xml", "")}</profiles></enclave>')
    with pytest.raises(ComArmorError, match="names no node") as caught:
        parse(write(text, {"logging.xml": LOGGING}))
    assert "xpointer(/profile/*)" in caught.value.diagnostics[0].help


def test_the_place_of_a_rule_has_the_chain_of_includes(robot: Path) -> None:
    talker = parse(robot).enclaves[0]
    rosout = next(talker.nodes()).lists[0]
    assert [Path(each.file).name for each in (rosout.where, *rosout.where.chain)] == [
        "logging.xml", "node.xml", "policy.xml",
    ]  # fmt: skip
    assert [each.line for each in rosout.where.chain] == [2, 1]


def test_a_file_that_is_not_xml_is_reported_with_the_chain_of_includes(write) -> None:
    with pytest.raises(ComArmorError) as caught:
        parse(write(policy(enclave("/a", include("logging.xml"))), {"logging.xml": "<profile>"}))
    (found,) = caught.value.diagnostics
    assert found.where
    assert [Path(each.file).name for each in (found.where, *found.where.chain)] == ["logging.xml", "policy.xml"]


@pytest.mark.parametrize(
    ("href", "code"),
    [
        ("/etc/hostname", "include-outside"),
        ("../other.xml", "include-outside"),
        ("missing.xml", "include-missing"),
        ("http://host/x.xml", "include-href"),
        ("", "include-href"),
        ("policy.xml", "include-loop"),
        ("link.xml", "include-outside"),
    ],
)
def test_refused(write, tmp_path: Path, href: str, code: str) -> None:
    (tmp_path.parent / "other.xml").write_text(LOGGING)
    (tmp_path / "link.xml").symlink_to(tmp_path.parent / "other.xml")
    with pytest.raises(ComArmorError) as caught:
        parse(write(policy(enclave("/a", include(href)))))
    (found,) = caught.value.diagnostics
    assert (found.code, found.where and found.where.line) == (code, 1)


@pytest.mark.parametrize(
    ("attributes", "code"),
    [
        ('xpointer="element(/1/2)"', "include-xpointer"),
        ('xpointer="xpointer(/policy/*)"', "include-xpointer"),
        ('xpointer="xpointer(//topics)"', "include-xpointer"),
        ('parse="text"', "include-parse"),
        ('accept="x"', "schema"),
    ],
)
def test_refused_attributes(write, attributes: str, code: str) -> None:
    with pytest.raises(ComArmorError) as caught:
        parse(write(policy(enclave("/a", include("logging.xml", attributes))), {"logging.xml": LOGGING}))
    assert caught.value.diagnostics[0].code == code


@pytest.mark.parametrize("inner", ["<xi:fallback/>", "text"])
def test_an_include_with_content_is_refused(write, inner: str) -> None:
    text = policy(enclave("/a", include("logging.xml").replace("/>", f">{inner}</xi:include>")))
    with pytest.raises(ComArmorError, match="must be empty") as caught:
        parse(write(text, {"logging.xml": LOGGING}))
    assert caught.value.diagnostics[0].code == "include-fallback"


def test_a_loop_over_two_files(write) -> None:
    files = {
        "a.xml": f"<profile {XI}>{include('b.xml')}</profile>",
        "b.xml": f"<profile {XI}>{include('a.xml')}</profile>",
    }
    with pytest.raises(ComArmorError, match="includes itself"):
        parse(write(policy(enclave("/a", include("a.xml"))), files))


def test_includes_that_multiply_are_bounded(write) -> None:
    files = {f"{level}.xml": f"<profile {XI}>{include(f'{level + 1}.xml') * 10}</profile>" for level in range(8)}
    path = write(policy(enclave("/a", include("0.xml"))), {**files, "8.xml": LOGGING})
    for limits, message in ((Limits(inclusions=500), "500 inclusions"), (Limits(nodes=200), "200 elements")):
        with pytest.raises(ComArmorError, match=f"more than .*{message}"):
            load_tree(path, limits=limits, form=INCLUDES)


@pytest.mark.parametrize("steps", ["/profile/topics/*", "/profile/*/topic"])
def test_what_an_xpointer_selects_counts_each_time(write, steps: str) -> None:
    listed = f'<profile {XI}><topics publish="ALLOW">{"<topic>/x</topic>" * 50}</topics></profile>'
    selected = include("many.xml", f'xpointer="xpointer({steps})"')
    path = write(policy(enclave("/a", f'<topics publish="ALLOW">{selected * 5}</topics>')), {"many.xml": listed})
    with pytest.raises(ComArmorError, match="more than the 200 elements"):
        load_tree(path, limits=Limits(nodes=200), form=INCLUDES)


def test_the_depth_of_includes_is_bounded(write) -> None:
    files = {f"{level}.xml": f"<profile {XI}>{include(f'{level + 1}.xml')}</profile>" for level in range(17)}
    with pytest.raises(ComArmorError, match="nested more than 16 deep"):
        parse(write(policy(enclave("/a", include("0.xml"))), {**files, "17.xml": LOGGING}))


def test_the_limit_of_bytes(write) -> None:
    path = write(policy(enclave("/a", include("logging.xml"))), {"logging.xml": LOGGING})
    with pytest.raises(ComArmorError, match="bytes allowed"):
        load_tree(path, limits=Limits(total_bytes=100), form=INCLUDES)


def test_a_missing_policy_and_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.xml", tmp_path):
        with pytest.raises(ComArmorError) as caught:
            parse(path)
        assert caught.value.diagnostics[0].code == "policy-missing"


def test_every_file_is_seen(robot: Path) -> None:
    seen = parse(robot).seen
    assert {path.name for path in seen} == {"policy.xml", "node.xml", "logging.xml", "time.xml", "parameters.xml"}
    assert all(seen.values())


def test_a_missing_file_says_where_to_get_it(robot: Path, tmp_path: Path) -> None:
    (tmp_path / "common").rename(tmp_path / "moved")
    with pytest.raises(ComArmorError, match="does not exist") as caught:
        parse(robot)
    (found,) = caught.value.diagnostics
    assert found.help.startswith(f"looked for '{tmp_path}/common/node.xml'; copy SROS2's 'common' folder beside")


def test_names_that_links_multiply_are_read_once(write) -> None:
    links = [f"d{i}" for i in range(10)]
    files = {
        f"s/{i}.xml": f"<profile {XI}>{''.join(include(f'{link}/{i + 1}.xml') for link in links)}</profile>"
        for i in range(14)
    }
    path = write(policy(enclave("/a", include("s/0.xml"))), files | {"s/14.xml": LOGGING})
    for link in links:
        (path.parent / "s" / link).symlink_to(".")

    def refused() -> str:
        with pytest.raises(ComArmorError) as caught:
            parse(path)
        return caught.value.diagnostics[0].code

    assert (found := calls_of(refused))[0] == "xml-limit"
    assert found[1] < 100_000


def test_rules_of_profiles_alone_count_each_time(write) -> None:
    """A file with nothing but includes is no file of rules that ComArmor would read once."""
    files = {f"{level}.xml": f"<profiles {XI}>{include(f'{level + 1}.xml', '') * 10}</profiles>" for level in range(8)}
    path = write(f'<policy version="0.1.0" {XI}>{include("0.xml", "")}</policy>', {**files, "8.xml": "<profiles/>"})
    with pytest.raises(ComArmorError, match="50,000 inclusions allowed"):
        parse(path)
