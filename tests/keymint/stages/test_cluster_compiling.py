# SPDX-License-Identifier: Apache-2.0
"""What another machine compiles, without a cluster: the requests are carried out in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_dds.emit import emission

from keymint.api import BuildOptions, Environment
from keymint.api.plugin_loader import Plugins
from keymint.executors.cluster import Cluster, carry_out
from keymint.pki.tokens.token_sessions import Tokens
from keymint.stages.build import BuildStage, compile_elsewhere
from keymint.stages.work import InstallRequest
from keymint.view.stamps import State
from keymint.view.tree import Tree
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import Workspace, packages
from tests.conftest import CHECKOUT, NOW, Outcome
from tests.keymint.executors.key_material import key_material

CLOCK = datetime.fromtimestamp(NOW, UTC)


class Here:
    """Carries out requests at once, and keeps them."""

    def __init__(self, change: Callable[[bytes], bytes]) -> None:
        self.requests: list[bytes] = []
        self._change = change

    def __call__(self, content: bytes) -> Future[bytes]:
        self.requests.append(content)
        future: Future[bytes] = Future()
        future.set_result(self._change(carry_out(content)))
        return future


@pytest.fixture
def session(keymint: Callable[..., Outcome], tmp_path: Path) -> Iterator[Session]:
    """A workspace with sources and keys, whose documents are to be built again."""
    assert keymint("provision", CHECKOUT / "examples/fleet", "-w", "ws", "-q").code == 0
    workspace = Workspace.at(tmp_path / "ws", {}, tmp_path)
    plugins = Plugins(environment=Environment(CLOCK, tmp_path))
    yield Inputs(workspace, Tree(), State(), plugins, {}, CLOCK, Tokens({})).session()
    emission._received.clear()


def built(session: Session, change: Callable[[bytes], bytes] = bytes, *, trusted: bool = False) -> tuple[Here, bool]:
    """Let another machine compile; return what it was sent, and whether the documents stay what they were."""
    here = Here(change)
    names = packages(session.tree, session.workspace.src)
    pool = Cluster(session.plugins, CLOCK, here, 2, trusted=trusted)
    compile_elsewhere(pool, session, names, BuildOptions())
    stage = BuildStage(session, InstallRequest(force=True, build=BuildOptions()))
    plan = stage.plan([stage.package(name) for name in names])
    return here, not any(step.changes for step in plan.steps)


def test_the_documents_are_those_that_are_compiled_here_and_no_key_is_sent(session: Session) -> None:
    here, same = built(session)
    assert same
    assert here.requests
    assert not emission._received, "what was compiled elsewhere was not used"
    secrets = key_material(session.workspace.root)
    assert [name for name, secret in secrets.items() if any(secret in request for request in here.requests)] == []


def test_rules_that_say_something_else_are_not_used_unless_they_are_trusted(session: Session) -> None:
    def widened(answer: bytes) -> bytes:
        assert b'"rt/' in answer
        return answer.replace(b'"rt/', b'"rt/x')

    assert built(session, widened)[1]
    assert not built(session, widened, trusted=True)[1], "trust makes no difference"


def test_rules_on_relaying_are_never_taken(session: Session) -> None:
    def relaying(answer: bytes) -> bytes:
        assert b'"publish":' in answer
        return answer.replace(b'"topics":{', b'"topics":{"relay":["*"],')

    assert built(session, relaying, trusted=True)[1]
