# SPDX-License-Identifier: Apache-2.0
"""What is planned so far, and the workspace as it will be then."""

from __future__ import annotations

from pathlib import Path

import pytest

from comarmor.errors import Diagnostic
from keymint.stages.work import Work
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.stamps import Stamp
from tests.keymint.stages.sessions import session_of


@pytest.fixture
def work(provisioned: Path) -> Work:
    return Work(session_of(provisioned))


def step(folder: Path, name: str, content: bytes) -> Step:
    return Step("test", name, Action.CREATED, (FolderChange(folder, {name: File(content)}),))


def test_no_record_is_lost_although_each_plan_has_one(work: Work) -> None:
    for name in ("first", "second"):
        state = work.session.state.updated("test", {name: Stamp("inputs", {})})
        work = work.then(Plan((Step("test", name, Action.UNCHANGED),), state), name)
    for plan in (work.plan, work.of("first")):
        assert plan.state.stamps["test"].keys() == {"first", "second"}


def test_those_that_follow_see_what_is_planned(work: Work) -> None:
    folder = work.session.workspace.build
    after = work.then(Plan((step(folder, "a", b"1"),), work.session.state))
    assert (work.session.tree.read(folder / "a"), after.session.tree.read(folder / "a")) == (None, b"1")


def test_a_changed_profile_is_loaded_again(work: Work) -> None:
    profile = work.session.workspace.profile / "keymint_profile.xml"
    before = work.session.profile
    assert (
        work.then(Plan((step(work.session.workspace.build, "a", b""),), work.session.state)).session.profile is before
    )
    content = profile.read_bytes().replace(b"</profile>", b"<revoke_superseded/></profile>")
    after = work.then(Plan((step(profile.parent, profile.name, content),), work.session.state))
    assert (before.revoke_superseded, after.session.profile.revoke_superseded) == (False, True)


def test_what_depends_on_the_sources_is_made_again_after_a_change_of_them(work: Work) -> None:
    source = work.session.workspace.src / "talker"
    before = {name: work.session.sources_digest(name) for name in ("talker", "listener")}
    elsewhere = work.then(Plan((step(work.session.workspace.build, "a", b""),), work.session.state))
    assert elsewhere.session.sources_digest("talker") == before["talker"]
    after = elsewhere.then(Plan((step(source, "more.xml", b"<more/>"),), work.session.state)).session
    assert after.sources_digest("talker") != before["talker"]
    assert after.sources_digest("listener") == before["listener"]


def test_what_is_late_keeps_its_place(work: Work) -> None:
    state = work.session.state
    signed = work.then(Plan((Step("signed", "", Action.UNCHANGED),), state), "signed")
    built = signed.then(Plan((Step("built", "", Action.UNCHANGED),), state), "built", before="signed")
    assert [each.stage for each in built.plan.steps] == ["built", "signed"]
    assert [each.stage for each in built.of("signed").steps] == ["signed"]


def test_a_plan_that_does_nothing_changes_nothing_but_what_is_said(work: Work) -> None:
    note = Diagnostic.note("said", "said", None)
    done = work.then(Plan((), work.session.state, (note,)))
    assert done.session is work.session
    assert done.plan.diagnostics == (note,)
    assert work.then(Plan((), work.session.state)) is work
