# SPDX-License-Identifier: Apache-2.0
"""Bundles of installed enclaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from comarmor.errors import Origin
from keymint.authority.authorities import plan_authorities
from keymint.commands.robots.bundle import MadeBundle, plan_bundles
from keymint.errors import KeymintError
from keymint.life.register import loaded_register
from keymint.robots import bundle
from keymint.robots.certification_request import CertificationRequest
from tests.conftest import NOW
from tests.keymint.stages.sessions import session_of


def made(ws: Path, request: CertificationRequest | None = None) -> MadeBundle:
    session = session_of(ws)
    _, authorities = plan_authorities(session)
    _, (only,) = plan_bundles(session, {"talker": request}, authorities)
    return only


def test_the_register_has_the_number_first(ws: Path) -> None:
    session = session_of(ws)
    _, authorities = plan_authorities(session)
    plan, bundles = plan_bundles(session, dict.fromkeys(["robot1/listener", "talker"]), authorities)
    assert [each.manifest.name for each in bundles] == ["robot1/listener", "talker"]
    [change] = plan.first
    content = b"".join(change.files["register.sqlite3"].pieces())
    register = loaded_register(content, Origin("register"))
    assert register.bundles == {"robot1/listener": NOW, "talker": NOW}
    assert plan.steps == ()


def test_an_answer_has_the_nonce_and_no_key(ws: Path) -> None:
    plain = made(ws)
    assert (plain.secret, plain.manifest.nonce) == (True, "")
    answer = made(ws, CertificationRequest("/talker", b"", "", "ab" * 16))
    assert (answer.secret, answer.manifest.nonce) == (False, "ab" * 16)
    assert "key.pem" not in bundle.read(answer.content, Origin("b")).files


def test_what_ends_first_ends_all_of_it(ws: Path) -> None:
    session = session_of(ws)
    package = session.package("talker")
    certificate = made(ws).manifest
    assert package.grant.validity is not None
    assert certificate.not_after == min(package.grant.validity.not_after, package.identity.validity.not_after)
    assert certificate.not_before == max(package.grant.validity.not_before, package.identity.validity.not_before)


def test_what_no_robot_would_take_is_not_made(ws: Path, made_elsewhere: Path) -> None:
    session = session_of(ws)
    _, authorities = plan_authorities(session)
    _, foreign = plan_authorities(session_of(made_elsewhere))
    mixed = {**authorities, "identity_ca": foreign["identity_ca"]}
    with pytest.raises(KeymintError) as refused:
        plan_bundles(session, {"talker": None}, mixed)
    assert [each.code for each in refused.value.diagnostics] == ["bundle-unusable"]
    keyless = {**authorities, "identity_ca": replace(authorities["identity_ca"], _keyed=KeymintError("x", code="gone"))}
    with pytest.raises(KeymintError) as refused:
        plan_bundles(session, {"talker": None, "robot1/listener": None}, keyless)
    assert {each.code for each in refused.value.diagnostics} == {"gone"}


@pytest.fixture
def made_elsewhere(request: pytest.FixtureRequest) -> Path:
    folder: Path = request.getfixturevalue("made")
    return folder / "foreign"


def test_what_is_not_installed(ws: Path) -> None:
    (ws / "install/enclaves/talker/cert.pem").unlink()
    with pytest.raises(KeymintError) as refused:
        made(ws)
    assert refused.value.diagnostics[0].code == "not-installed"
    assert refused.value.diagnostics[0].subject == "/talker"
