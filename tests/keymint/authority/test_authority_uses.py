# SPDX-License-Identifier: Apache-2.0
"""Whom authorities serve, and which implementations accept a change of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.authority.authority_changes import Use, implementations, refusing_implementations, uses
from keymint.errors import ExitCode, KeymintError
from keymint.workspace.session import Session
from tests.keymint.stages.sessions import session_of

DDS, ZENOH = "keymint_ros2_dds", "keymint_ros2_zenoh"
CYCLONE, FAST = "Cyclone DDS 0.10", "Fast DDS 2.9"


@pytest.fixture
def session(ws: Path) -> Session:
    return session_of(ws)


@pytest.fixture
def both(keymint, policy: Path, tmp_path: Path) -> Session:
    made = keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "zenoh")
    assert made.code == 0, made.err
    return session_of(tmp_path / "ws")


def test_uses(session: Session) -> None:
    assert uses(session) == {
        "identity_ca": (Use(DDS, "identity", False, 2),),
        "permissions_ca": (Use(DDS, "permissions", True, 2),),
    }


def test_an_authority_above_others_is_used_as_they_are(keymint, ws: Path) -> None:
    path = ws / "profile/authorities.xml"
    path.write_text(
        path.read_text()
        .replace("<authorities>", '<authorities><authority name="root"><cert><issuer_name/></cert></authority>')
        .replace("<issuer_name></issuer_name>", "<issuer_name>root</issuer_name>", 1)
    )
    assert uses(session_of(ws))["root"] == (Use(DDS, "identity", False, 2),)


def test_with_two_transports_both_are_asked(both: Session) -> None:
    roles = {name: {(use.build_type, use.role) for use in of_name} for name, of_name in uses(both).items()}
    assert roles["identity_ca"] == {(DDS, "identity"), (ZENOH, "identity")}
    names = {name: [each.name for each in found] for name, found in implementations(both).items()}
    assert names == {DDS: ["cyclonedds", "fastdds"], ZENOH: ["zenoh"]}
    # What is chosen for one transport leaves the other one as it is.
    chosen = {name: [each.name for each in found] for name, found in implementations(both, ("fastdds",)).items()}
    assert chosen == {DDS: ["fastdds"], ZENOH: ["zenoh"]}


@pytest.mark.parametrize(
    ("name", "chosen", "what", "titles"),
    [
        ("identity_ca", (), "reissues", ()),
        ("permissions_ca", (), "reissues", (CYCLONE, FAST)),
        ("identity_ca", (), "bundles", (CYCLONE,)),
        ("identity_ca", ("fastdds",), "bundles", ()),
        ("identity_ca", ("fastdds", "cyclonedds"), "bundles", (CYCLONE,)),
        ("permissions_ca", ("fastdds",), "bundles", (FAST,)),
    ],
)
def test_who_refuses(session: Session, name: str, chosen: tuple[str, ...], what: str, titles: tuple[str, ...]) -> None:
    assert refusing_implementations(session, name, chosen, what) == titles


def test_an_unknown_implementation_is_a_usage_error(session: Session) -> None:
    with pytest.raises(KeymintError, match="did you mean 'fastdds'") as error:
        implementations(session, ("fastds",))
    assert error.value.exit_code is ExitCode.USAGE
