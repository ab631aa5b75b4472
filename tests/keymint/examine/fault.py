# SPDX-License-Identifier: Apache-2.0
"""A fault: what it changes, whether a vendor then decides otherwise, and what the verbs must say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .fault_keystores import SUBJECTS, Keystore

CLASSES = {
    1: "a grant for another by its exact name",
    2: "a grant for another by containment",
    3: "a grant for another by order of RDNs, blanks or quotes",
    4: "rules widened",
    5: "rules narrowed",
    6: "rules reordered",
    7: "dates",
    8: "domains",
    9: "documents of an older generation",
    10: "self-signed documents",
    11: "documents and certificates by another authority",
    12: "governance opened",
    13: "rules missing or doubled",
    14: "a revocation list missing",
    15: "an older revocation list",
    16: "a revocation list that revokes the living",
    17: "tampering in a phase of a rollover",
    18: "an adopted keystore with one CA",
    19: "modes, links and strays",
    20: "keys and certificates exchanged",
    21: "bundles",
    22: "the router's file of Zenoh",
    23: "session files of Zenoh",
}


@dataclass(frozen=True)
class Fault:
    """A change of a provisioned workspace.

    Attributes:
        kind: number of its class in :data:`CLASSES`.
        name: what it does; unique in its class.
        workspace: kind of the workspace that it changes.
        apply: does it.
        decides: whether a vendor decides otherwise for the holder of some certificate in force, by construction; None
            if the meaning of the permissions before and after is to be compared (rules that apply first, fnmatch).
        vendors: who decides otherwise, or would.
        check: whether ``check`` must end with 3 (True) or 0 (False); None for either.
        prove: the same of ``prove``.
        why: why one of the two may pass what the other calls an error.
        subjects: whose permissions are compared.
    """

    kind: int
    name: str
    workspace: str
    apply: Callable[[Keystore], None]
    decides: bool | None = True
    vendors: str = "all"
    check: bool | None = None
    prove: bool | None = None
    why: str = ""
    subjects: tuple[str, ...] = SUBJECTS

    @property
    def id(self) -> str:
        return f"class{self.kind:02}-{self.name}".replace("/", ".").replace(" ", "_")

    def must(self, *, decides: bool) -> tuple[bool | None, bool | None]:
        """Return whether ``check`` and ``prove`` must find it, given whether it changes a decision."""
        if decides:
            return True, True if self.prove is None and not self.why else self.prove
        return self.check, False if self.prove is None and not self.why else self.prove
