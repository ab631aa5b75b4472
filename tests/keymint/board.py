# SPDX-License-Identifier: Apache-2.0
"""A second transport for tests: a board with the rights of all subjects decides, and no enclave's own document does.

The board hangs in an office that has an identity of its own, as infrastructure of the transport.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from comarmor.errors import Origin
from comarmor.patterns.expression import matches
from comarmor.rules import parts
from keymint.api import (
    API_VERSION,
    Artifact,
    Availability,
    BuildOptions,
    BuildResult,
    Endpoint,
    InstalledEnclave,
    Layout,
    Package,
    Tier,
    Transport,
    TransportType,
    Verdict,
    WorkspaceProfile,
)
from keymint.api.graph import Edge
from keymint.api.plugin_loader import PluginInfo
from tests.keymint.plain_build_type import PlainBuildType

NAME = "board"
BOARD = "board/rights.txt"
OFFICE = "office"


class BoardBuildType(PlainBuildType):
    TRANSPORT = "board"
    DOCUMENT = "rights.txt"
    COPIED = (DOCUMENT,)
    LAYOUTS: Mapping[str, Layout] = {"sros2": Layout("enclaves"), "flat": Layout("")}
    NOUN = "line of the board"
    INFRASTRUCTURE = True

    def packages(self, profile: WorkspaceProfile) -> Mapping[str, str]:
        del profile
        return {OFFICE: "the office"}

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        del options
        return BuildResult({"rights.txt": "".join(_lines(package)).encode()})

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        del layout
        texts = [files["rights.txt"].content for _, files in sorted(artifacts.items()) if "rights.txt" in files]
        return {BOARD: Artifact(b"".join(texts))} if texts else {}

    def actions(self, distro: str, edge: Edge) -> Sequence[Endpoint]:
        del distro
        return [
            Endpoint(edge.subject, action, edge.object.name + suffix, domain=edge.domain)
            for _, action, suffix in parts(edge.object.kind, edge.permission)
        ]


def _lines(package: Package) -> Iterator[str]:
    """Yield a line for each elementary right; raw topics have no place on the board."""
    for rule in package.grant.rules.rules:
        for permission in rule.permissions if rule.kind != "topic" else ():
            for _, action, suffix in parts(rule.kind, permission):
                for expression in rule.expressions:
                    yield f"{package.subject} {rule.effect} {action} {expression}{suffix}\n"


@dataclass(frozen=True)
class Board(Transport):
    """Decides by the board; a DENY overrides every ALLOW."""

    tiers: tuple[Tier, ...]
    reads_keys: bool

    def usable(self) -> Availability:
        return Availability(usable=True, version="1", tiers=self.tiers)

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        del tier
        folders = {enclave.subject: enclave for enclave in enclaves}
        for edge in edges:
            enclave = folders[edge.subject]
            office = enclave.install / "enclaves" / OFFICE
            assert (office / "cert.pem").exists()
            assert all((folder / "key.pem").exists() >= self.reads_keys for folder in (office, enclave.folder))
            verdicts = [
                self._decide(enclave.install / BOARD, edge.subject, action, edge.object.name + suffix)
                for _, action, suffix in parts(edge.object.kind, edge.permission)
            ]
            yield edge, next((each for each in verdicts if not each.allowed), verdicts[-1])

    def _decide(self, board: Path, subject: str, action: str, name: str) -> Verdict:
        decided = Verdict(False, f"no line names {name!r}", Origin(str(board)))
        for number, line in enumerate(board.read_text().splitlines(), 1):
            who, effect, what, expression = line.split(" ", 3)
            if (who, what) == (subject, action) and matches(expression, name):
                reason = f"the line {effect}s {action} of {name!r}"
                decided = Verdict(effect == "ALLOW", reason, Origin(str(board), number))
                if effect == "DENY":
                    break
        return decided


build_type = BoardBuildType()
simulated = TransportType(API_VERSION, NAME, lambda _: Board((Tier.DECISION,), reads_keys=False))
real = TransportType(API_VERSION, NAME, lambda _: Board((Tier.DECISION, Tier.ADMISSION), reads_keys=True))

ENTRIES = (
    PluginInfo("keymint.build_types", NAME, f"{__name__}:build_type"),
    PluginInfo("keymint.transports", "board-1", f"{__name__}:simulated"),
    PluginInfo("keymint.transports", "board", f"{__name__}:real"),
)
