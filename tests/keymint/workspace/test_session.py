# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.api import Layout
from keymint.errors import KeymintError
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.tree import Tree
from keymint.workspace.package_build_types import inputs_digest
from keymint.workspace.session import Inputs, Session
from tests.conftest import Outcome
from tests.keymint.stages.sessions import session_of

DEEP, TOP = Layout("enclaves"), Layout("", ("enclaves",))


def session_with(layout: str, **build_types: Mapping[str, Layout]) -> Any:
    """Return what of a session its layouts depend on."""
    marker = Origin("profile/keymint_profile.xml")
    return SimpleNamespace(
        profile=SimpleNamespace(layout=layout),
        profile_marker=lambda: marker,
        build_types={name: SimpleNamespace(LAYOUTS=layouts) for name, layouts in build_types.items()},
        workspace=SimpleNamespace(install=Path("/ws/install")),
    )


def layouts(session: Any) -> tuple[Layout, ...]:
    found: tuple[Layout, ...] = Session.layouts.fget(session)  # type: ignore[attr-defined]
    return found


def test_the_layout_is_that_of_each_build_type_that_has_it() -> None:
    session = session_with("top", one={"deep": DEEP}, two={"deep": DEEP, "top": TOP})
    assert layouts(session) == (TOP,)
    assert layouts(session_with("deep", one={"deep": DEEP}, two={"deep": DEEP, "top": TOP})) == (DEEP, DEEP)


def test_a_layout_that_no_build_type_has_is_an_error_of_the_profile() -> None:
    with pytest.raises(KeymintError) as caught:
        layouts(session_with("dep", one={"deep": DEEP}, two={"top": TOP}))
    (said,) = caught.value.diagnostics
    assert (said.code, said.where) == ("layout-unknown", Origin("profile/keymint_profile.xml"))
    assert "no build type of the workspace has a layout 'dep'" in said.message
    assert "'deep'" in said.help


def test_a_profile_is_loaded_from_its_space_without_the_policy(tmp_path: Path) -> None:
    own = {"keymint_profile.xml", "profile.defaults/authorities.xml", "package.defaults/permissions.xml"}
    for file in (*own, "comarmor.d/talker.xml", "comarmor.d/common/node.xml"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    given: list[str] = []
    profile_type = SimpleNamespace(recognises=given.extend)
    inputs: Any = SimpleNamespace(
        workspace=SimpleNamespace(profile=tmp_path),
        tree=Tree(),
        plugins=SimpleNamespace(profile_types=lambda: {"recorder": profile_type}),
        profile_marker=lambda: Origin("profile/keymint_profile.xml"),
    )
    with pytest.raises(KeymintError, match="no installed profile type"):
        Inputs.session(inputs)
    assert sorted(given) == sorted(own)


# -- what a session knows about its sources --------------------------------------------------------------------------


@pytest.fixture
def ws(keymint: Callable[..., Outcome], tmp_path: Path, policy: Path) -> Path:
    """Return a workspace whose packages need one of infrastructure, the router of Zenoh."""
    assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh", "--no-prove").code == 0
    return tmp_path / "ws"


def known(session: Session) -> tuple[object, ...]:
    """Return what a session knows about a package."""
    return (
        session.packages(), session.infrastructure(), session.issuance("talker"), dict(session.file_digests("talker")),
        session.sources_digest("talker"), inputs_digest(session, "talker"),
    )  # fmt: skip


def plan(folder: Path, name: str, content: bytes | None, session: Session) -> Plan:
    files, removed = ({}, (name,)) if content is None else ({name: File(content)}, ())
    return Plan((Step("create", "", Action.UPDATED, (FolderChange(folder, files, removed),)),), session.state)


def test_what_is_known_of_the_sources_is_never_that_of_another_place_of_the_enclaves(ws: Path) -> None:
    session = session_of(ws)
    known(session)
    elsewhere = replace(session.workspace, install=session.workspace.next_install)
    assert known(replace(session, workspace=elsewhere)) == known(replace(session_of(ws), workspace=elsewhere))
    assert session.sources_digest("talker") != replace(session, workspace=elsewhere).sources_digest("talker")


@pytest.mark.parametrize("name", ["permissions.xml", "package.defaults/more.xml", "keymint_package.xml"])
@pytest.mark.parametrize("package", ["talker", "zenoh_router"])
def test_what_is_known_of_the_sources_changes_with_a_plan(ws: Path, name: str, package: str) -> None:
    session = session_of(ws)
    before = known(session)
    path = session.workspace.src / package / name
    content = b"<x/>" if name != "keymint_package.xml" else None
    changed = plan(path.parent, path.name, content, session)
    after = known(session.after(changed))
    assert after == known(replace(session_of(ws), tree=session.tree.overlaid(changed.overlay())))
    assert after != before
    assert known(session) == before


def test_what_is_known_of_the_sources_outlives_a_plan_that_leaves_them(
    ws: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = session_of(ws)
    before = known(session)
    after = session.after(plan(session.workspace.build / "talker", "x", b"", session))
    monkeypatch.setattr("keymint.workspace.session.packages", lambda *_: pytest.fail("read again"))
    assert known(after) == before
