# SPDX-License-Identifier: Apache-2.0
"""``packages.lock.xml``: what the owner accepted of the profiles that ROS packages ship, which Keymint writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
import xmlschema
from keymint_ros import profile_type
from keymint_ros.decisions import PACKAGES_LOCK as FILE

from comarmor.data import locate
from keymint.api import AcceptedPackage

from .workspaces import ROOT, Workspace, diagnostic_of

ONE, TWO = "1" * 64, "2" * 64
ACCEPTED = {
    "nav2_bringup": AcceptedPackage({"controller.xml": ONE, "parts/a-b.xml": TWO}),
    "Linked-1": AcceptedPackage({"x.xml": TWO}, follows_links=True),
}


def loaded(workspace: Workspace, content: bytes | None) -> Mapping[str, AcceptedPackage]:
    files = {**workspace.profile, **({} if content is None else {FILE: content})}
    return profile_type.load(ROOT, files).packages


def written(accepted: Mapping[str, AcceptedPackage]) -> bytes:
    [(file, content)] = profile_type.with_packages(accepted).items()
    assert file == FILE
    return content


@pytest.mark.parametrize("names", [(), ("nav2_bringup",), ("nav2_bringup", "Linked-1")])
def test_what_is_written_is_read(workspace: Workspace, names: tuple[str, ...]) -> None:
    accepted = {name: ACCEPTED[name] for name in names}
    content = written(accepted)
    found = loaded(workspace, content)
    assert {name: (dict(each.files), each.follows_links) for name, each in found.items()} == {
        name: (each.files, each.follows_links) for name, each in accepted.items()
    }
    assert written(dict(reversed(found.items()))) == content
    xmlschema.XMLSchema(locate("keymint_ros", "schemas") / "packages_lock.xsd").validate(content.decode())


def test_a_profile_without_it_accepted_nothing(workspace: Workspace) -> None:
    assert loaded(workspace, None) == {}
    assert profile_type.load(ROOT, workspace.profile).package_copies == Path(ROOT) / "packages.lock.d"


@pytest.mark.parametrize(
    ("before", "after", "code"),
    [
        ('name="Linked-1"', 'name="nav2_bringup"', "package-doubled"),
        ('path="parts/a-b.xml"', 'path="controller.xml"', "package-doubled"),
        ('name="Linked-1"', 'name="../x"', "schema"),
        ('path="x.xml"', 'path="../x.xml"', "schema"),
        ('path="x.xml"', 'path="/x.xml"', "schema"),
        (ONE, "x", "schema"),
        ('links="follow"', 'links="yes"', "schema"),
        ("<packages_lock", "<!DOCTYPE x><packages_lock", "xml-doctype"),
    ],
)
def test_defects(workspace: Workspace, before: str, after: str, code: str) -> None:
    content = written(ACCEPTED)
    changed = content.replace(before.encode(), after.encode())
    assert changed != content
    assert diagnostic_of(lambda: loaded(workspace, changed), str(ROOT / FILE)).code == code
