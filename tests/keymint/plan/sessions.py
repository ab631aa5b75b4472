# SPDX-License-Identifier: Apache-2.0
"""The session of a workspace on the disk, for tests that plan without a verb."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from keymint.api import Environment
from keymint.pins import Pins
from keymint.pki.tokens import Tokens
from keymint.plugins import Plugins
from keymint.session import Inputs, Session
from keymint.state import load
from keymint.tree import Tree
from keymint.workspace import Workspace
from tests.conftest import NOW


def session_of(root: Path, now: float = NOW) -> Session:
    """Return the session of a workspace at a time (seconds since the epoch)."""
    workspace, clock = Workspace.at(root, {}, root.parent), datetime.fromtimestamp(now, UTC)
    record = workspace.state / "state.json"
    state = load(record.read_bytes() if record.exists() else None)
    plugins = Plugins(environment=Environment(clock, root.parent))
    return Inputs(workspace, Tree(), state, plugins, {}, clock, Tokens({}, Pins({}).pin)).session()
