# SPDX-License-Identifier: Apache-2.0
"""What the verbs share that a robot runs: its keystore, which is no workspace."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from keymint.command_line.verb import PATH, option
from keymint.errors import usage_error
from keymint.robots.robot_keystore import RECORDS, Keystore
from keymint.run.run import Run
from keymint.store.store import Store
from keymint.workspace.workspace import shown_path

VARIABLE = "ROS_SECURITY_KEYSTORE"
"""The environment variable by which ROS 2 finds the keystore."""

folder_option = option(type=PATH, metavar="DIR", help=f"The keystore of this robot; need not exist [${VARIABLE}].")


def keystore_of(run: Run, folder: Path | None) -> Keystore:
    """Return the keystore that the user named, or that the environment names.

    Raises:
        KeymintError: neither does; a usage error.
    """
    named = folder or Path(run.setting.environment.get(VARIABLE, ""))
    if named == Path():
        raise usage_error(
            "the keystore is not known", f"name it with --folder, or set {VARIABLE} as for the nodes of this robot"
        )
    root = (run.setting.cwd / named).resolve()
    return Keystore(root, shown_path(root, run.setting.cwd))


@contextlib.contextmanager
def opened_store(run: Run, keystore: Keystore) -> Iterator[Store]:
    """Yield the writer of a keystore, whose lock is held; what was interrupted is finished or dropped first."""
    store = Store({keystore.root: False}, keystore.root / RECORDS)
    with store.locked(run.console.waiting):
        run.interrupted = store.recover()
        yield store
        store.end()
