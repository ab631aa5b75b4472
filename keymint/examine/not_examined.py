# SPDX-License-Identifier: Apache-2.0
"""Say what is not examined, because the user may not read it: an auditor needs no private key."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from keymint.workspace.session import Inputs

_REGISTER = "which certificates were issued and revoked is not known"
_KEYS = "no private key here is compared with its certificate"


def not_examined(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield a note for each entry of the private space that was left out, or has something in it that was."""
    private, register = inputs.workspace.private, inputs.workspace.register
    reasons = {str(private): f"{_KEYS}, and {_REGISTER}", str(register): _REGISTER}
    for path in dict.fromkeys("/".join(each.split("/")[: len(private.parts) + 1]) for each in inputs.tree.left_out):
        message, where = f"not examined: {reasons.get(path, _KEYS)}", inputs.workspace.origin(path)
        yield Diagnostic.note("not-examined", message, where, "a user who may read it examines it as well")


def has_register(inputs: Inputs) -> bool:
    """Tell whether the register of issued certificates is here and was read: without it, revocations are not known."""
    path = inputs.workspace.register
    return inputs.tree.has_file(path) and not inputs.tree.is_left_out(path)
