# SPDX-License-Identifier: Apache-2.0
"""Say what is not examined, because the user may not read it: an auditor needs no private key."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from keymint.session import Inputs

_REGISTER = "which certificates were issued and revoked is not known"
_KEYS = "no private key here is compared with its certificate"


def not_examined(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield a note for each entry of the private space that was left out, or has something in it that was."""
    workspace = inputs.workspace
    entries: dict[str, str] = {}
    for path in inputs.tree.left_out:
        below = path.removeprefix(f"{workspace.private}/").partition("/")[0]
        whole = path == str(workspace.private)
        entries[path if whole else f"{workspace.private}/{below}"] = f"{_KEYS}, and {_REGISTER}" if whole else _KEYS
    entries |= {path: _REGISTER for path in entries if path == str(workspace.register)}
    for path, reason in entries.items():
        where, help_ = workspace.origin(path), "a user who may read it examines it as well"
        yield Diagnostic.note("not-examined", f"not examined: {reason}", where, help_)


def has_register(inputs: Inputs) -> bool:
    """Tell whether the register of issued certificates is here and was read: without it, revocations are not known."""
    path = inputs.workspace.register
    return inputs.tree.has_file(path) and not inputs.tree.is_left_out(path)
