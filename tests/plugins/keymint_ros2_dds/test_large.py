"""Large documents: no blanks that handshakes would carry, and still a line for each topic."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from keymint_ros2_dds import build_type, vendor_limits
from keymint_ros2_dds.documents import dds_xml
from lxml import etree

from benchmarks import navigation
from keymint.api import BuildOptions
from keymint.pki import mime

from .packages import package, rule

NAMES = st.lists(st.from_regex(r"/[a-z][a-z0-9_]{0,30}(/[a-z][a-z0-9_]{0,30}){0,2}", fullmatch=True), max_size=30)


def built(*names: str, indented: int, **options: bool) -> bytes:
    """Return the permissions of who may publish and subscribe to these topics."""
    rules = [rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", name) for name in names]
    with mock.patch.object(dds_xml, "INDENTED", indented):
        done = build_type.build(package(*rules), replace(BuildOptions(), **options))
    (name,) = done.plain_sizes
    assert name == "permissions.xml"
    if options == {"optimise": False}:
        assert done.plain_sizes[name] == len(done.documents[name])
    return done.documents[name]


@settings(max_examples=60)
@given(NAMES, st.integers(500, 6_000))
def test_only_a_document_beyond_the_limit_loses_its_blanks_and_nothing_else(names: list[str], limit: int) -> None:
    usual, limited = built(*names, indented=10**9), built(*names, indented=limit)
    bare = b"".join(line.lstrip(b" ") for line in usual.splitlines(keepends=True))
    assert limited == (usual if len(usual) <= limit else bare)
    trees = [etree.fromstring(each, etree.XMLParser(remove_blank_text=True)) for each in (usual, limited)]
    assert etree.tostring(trees[0], method="c14n") == etree.tostring(trees[1], method="c14n")
    assert usual.count(b"\n") == limited.count(b"\n"), "the number of a line means the same"


@settings(max_examples=60)
@given(NAMES, st.integers(500, 12_000))
def test_the_size_of_the_plain_form_is_what_it_would_have(names: list[str], limit: int) -> None:
    rules = [rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", name) for name in names]
    with mock.patch.object(dds_xml, "INDENTED", limit):
        small = build_type.build(package(*rules), BuildOptions())
        plain = build_type.build(package(*rules), BuildOptions(optimise=False))
    assert small.plain_sizes == {"permissions.xml": len(plain.documents["permissions.xml"])}


def test_the_limit() -> None:
    """As many names as fit are indented; one more, and none is."""
    names = [f"/some/namespace/topic_{number:04}/of_words" for number in range(600)]
    sizes = [(count, built(*names[:count], indented=32_000, optimise=False)) for count in (30, 40, 600)]
    assert [any(line.startswith(b" ") for line in content.splitlines()) for _, content in sizes] == [True, True, False]


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("navigation") / "policy.xml"
    path.write_text(navigation.policy())
    return path


def test_the_policy_of_a_navigation_stack_fits(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    """One enclave for a dozen nodes: 70 kB before, and vendors were seen to fail at 67 kB."""
    outcome = keymint("provision", policy, "-w", "ws", "--json")
    assert outcome.code == 0
    assert {"compile-unproven", "rewriting-unproven"}.isdisjoint(outcome.codes())
    enclave = tmp_path / "ws/install/enclaves/navigation"
    signed, content = ((enclave / name).read_bytes() for name in ("permissions.p7s", "permissions.xml"))
    assert len(set(re.findall(b"<topic>(.*)</topic>", content))) > 600
    assert len(signed) < 60_000
    assert mime.unwrap(signed).content == content, "what is signed is what lies beside it"
    assert content.count(b"\n") > content.count(b"<topic>"), "a line for each"
    (said,) = (found for found in outcome.document["diagnostics"] if found["code"] == "size-permissions")
    (size,) = re.findall(r"about ([\d,]+) bytes", said["message"])
    assert abs(int(size.replace(",", "")) - len(signed)) < 200
    assert vendor_limits.TIGHT < len(signed) < vendor_limits.BROKEN

    why = keymint("why", "/navigation", "ros_publish", "/cmd_vel_smoothed", "-w", "ws", "-t", "omg", "--json")
    (transport,) = why.document["result"]["transports"]
    line = content.splitlines()[transport["rule"]["line"] - 1]
    assert line == b"<publish>", "the criterion that decides, as in a document with blanks"
