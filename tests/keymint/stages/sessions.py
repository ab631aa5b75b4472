# SPDX-License-Identifier: Apache-2.0
"""The session of a workspace on the disk, for tests that plan without a verb."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from keymint.api import Environment
from keymint.pki.tokens.token_sessions import Tokens
from keymint.view.stamps import load
from keymint.view.tree import Tree
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import Workspace
from tests.conftest import NOW, installed_plugins


def session_of(root: Path, now: float = NOW) -> Session:
    """Return the session of a workspace at a time (seconds since the epoch)."""
    workspace, clock = Workspace.at(root, {}, root.parent), datetime.fromtimestamp(now, UTC)
    record = workspace.state / "state.json"
    state = load(record.read_bytes() if record.exists() else None)
    plugins = installed_plugins(Environment(clock, root.parent))
    return Inputs(workspace, Tree(), state, plugins, {}, clock, lambda: Tokens({})).session()
