# SPDX-License-Identifier: Apache-2.0
"""What ROS packages ship, where plugins can keep less or read less."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from comarmor.errors import Origin
from comarmor.xml.package_folders import ShippedFile
from keymint.api import AcceptedPackage
from keymint.errors import KeymintError
from keymint.store.changes import Action
from keymint.workspace import shipped_profiles
from keymint.workspace.shipped_profiles import (
    UnacceptedPackagesError,
    plan_acceptance,
    refuse_unaccepted,
)
from tests.keymint.stages.sessions import session_of

FILE = ShippedFile("nav2_bringup", "controller.xml", b"<profiles/>", Origin("p.xml", 2))
VALUE = hashlib.sha256(FILE.content).hexdigest()


@pytest.fixture
def session(keymint, tmp_path: Path) -> Any:
    assert keymint("init", "ws").code == 0
    return session_of(tmp_path / "ws")


def policy(*shipped: ShippedFile) -> Any:
    return SimpleNamespace(shipped=shipped)


def accepting(session: Any, **accepted: AcceptedPackage) -> Any:
    return replace(session, profile=replace(session.profile, packages=accepted))


def test_what_was_accepted_is_not_refused(session: Any) -> None:
    accepted = accepting(session, nav2_bringup=AcceptedPackage({"controller.xml": VALUE, "gone.xml": "0" * 64}))
    refuse_unaccepted(accepted, policy(FILE), policy)
    refuse_unaccepted(session, policy(), policy)


@pytest.mark.parametrize(
    ("accepted", "code", "before"),
    [
        ({}, "package-unaccepted", ""),
        ({"nav2_bringup": AcceptedPackage({"other.xml": VALUE})}, "package-unaccepted", ""),
        ({"other": AcceptedPackage({"controller.xml": VALUE})}, "package-unaccepted", ""),
        ({"nav2_bringup": AcceptedPackage({"controller.xml": "0" * 64})}, "package-changed", "0" * 64),
    ],
)
def test_what_was_not_accepted(session: Any, accepted: dict[str, AcceptedPackage], code: str, before: str) -> None:
    with pytest.raises(UnacceptedPackagesError) as caught:
        refuse_unaccepted(accepting(session, **accepted), policy(FILE), policy)
    assert [(each.code, each.where) for each in caught.value.diagnostics] == [(code, FILE.where)]
    assert [(each.sha256, accepted) for each, accepted in caught.value.files.items()] == [(VALUE, before)]


def test_one_error_for_each_package(session: Any) -> None:
    files = [replace(FILE, path=f"{name}.xml") for name in "abcdefg"]
    with pytest.raises(UnacceptedPackagesError) as caught:
        refuse_unaccepted(session, policy(*files, replace(FILE, package="second")), policy)
    assert [each.message.rpartition(": ")[2] for each in caught.value.diagnostics] == [
        "a.xml, b.xml, c.xml, d.xml, e.xml, …",
        "controller.xml",
    ]


def test_the_plan_writes_copies_and_the_lock_and_only_what_changes(session: Any) -> None:
    plan = plan_acceptance(session, {"nav2_bringup": ""}, lambda _: policy(FILE), trust_links=False)
    written = [str(change.folder / name) for change in plan.changes() for name in change.written]
    profile = session.workspace.profile
    assert written == [f"{profile}/packages.lock.d/nav2_bringup/controller.xml", f"{profile}/packages.lock.xml"]
    after = session.after(plan).session()
    assert after.profile.packages == {"nav2_bringup": AcceptedPackage({"controller.xml": VALUE})}
    again = plan_acceptance(after, {"nav2_bringup": ""}, lambda _: policy(FILE), trust_links=False)
    assert ([step.action for step in again.steps], again.writes()) == ([Action.UNCHANGED], False)
    linked = plan_acceptance(after, {"nav2_bringup": ""}, lambda _: policy(FILE), trust_links=True)
    trusting = after.after(linked).session()
    assert trusting.profile.packages["nav2_bringup"].follows_links
    assert shipped_profiles.installed_packages(trusting).trusted == {"nav2_bringup"}
    assert shipped_profiles.installed_packages(trusting, trust_links=True).trusted is None
    kept = plan_acceptance(trusting, {"nav2_bringup": ""}, lambda _: policy(FILE), trust_links=False)
    assert not kept.writes()


def test_a_profile_that_cannot_keep_it(session: Any) -> None:
    without = replace(session, profile=replace(session.profile, package_copies=None))
    with pytest.raises(KeymintError, match="cannot keep what was accepted") as caught:
        plan_acceptance(without, {"nav2_bringup": ""}, lambda _: policy(FILE), trust_links=False)
    assert caught.value.diagnostics[0].code == "profile-without-packages"
