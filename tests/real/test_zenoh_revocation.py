# SPDX-License-Identifier: Apache-2.0
"""A revoked identity has no rights on real Zenoh: the router knows the CN of the next generation only."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .compiled_space import CompiledSpace, compiled, policy
from .provisioning import keymint
from .zenoh_network import real_network

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.usefixtures("zenoh_library"),
    pytest.mark.xdist_group("revoked on Zenoh"),
]

CHATTER = "0/chatter/type/hash"
HOSTILE = {"access_control": {"enabled": False}}
"""A session that does not restrict itself."""


@pytest.fixture(scope="module")
def workspace(zenoh_library: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A keystore before and after two revocations; afterwards it also has the enclaves from before."""
    source = policy(
        listener=[("subscribe", "chatter")], stolen=[("publish", "chatter")], talker=[("publish", "chatter")]
    )
    folder = tmp_path_factory.mktemp("zenoh")
    made = compiled(source, folder)
    shutil.copytree(made, folder / "before")
    keymint("revoke", "stolen", "--reason", "key-compromise", "-w", made)
    keymint("revoke", "talker", "--reason", "superseded", "-w", made)
    for name in ("stolen", "talker"):
        shutil.copytree(folder / f"before/install/enclaves/{name}", made / f"install/enclaves/old_{name}")
    return folder


@pytest.mark.parametrize("name", ["stolen", "talker"])
def test_a_revoked_identity_has_no_rights(workspace: Path, tmp_path: Path, name: str) -> None:
    with real_network(CompiledSpace(workspace / "ws", tmp_path / "install")) as network:
        network.router()
        listener, revoked = network.session("listener"), network.session(f"old_{name}", HOSTILE)
        assert not network.reaches(revoked, listener, CHATTER)
        assert network.reaches(network.session("talker"), listener, CHATTER)


@pytest.mark.parametrize("name", ["stolen", "talker"])
def test_until_the_router_restarts_with_its_new_file_it_has_them(workspace: Path, tmp_path: Path, name: str) -> None:
    with real_network(CompiledSpace(workspace / "before", tmp_path / "install")) as network:
        network.router()
        assert network.reaches(network.session(name, HOSTILE), network.session("listener"), CHATTER)


def test_nothing_is_issued_for_the_stolen_key(workspace: Path) -> None:
    assert not (workspace / "ws/install/enclaves/stolen").exists()
    router = (workspace / "ws/install/zenoh/router.json5").read_text()
    assert '"cert_common_names": ["/stolen"]' not in router
