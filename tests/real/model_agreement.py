# SPDX-License-Identifier: Apache-2.0
"""Compares the simulated vendors with the real ones on random documents and requests."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

from cryptography.x509 import NameOID

from keymint.api import InstalledEnclave, Tier, Transport
from keymint.api.graph import Edge
from keymint.pki import smime

from .handmade import Authorities
from .random_documents import Writer

RDNS = ((NameOID.ORGANIZATIONAL_UNIT_NAME, "4f"), (NameOID.COMMON_NAME, "/robot"))
"""The subject of all identities, to which the documents of a writer refer."""
CHUNK = 100
"""Documents on the disk at a time."""


def disagreements(
    real: Transport, simulated: Transport, documents: int, requests: int, seed: int
) -> Iterator[tuple[bool, str]]:
    """Yield for each request whether the vendor allows it, and how its model disagrees.

    The second part is empty if the model agrees, or does not know.
    """
    writer, authorities = Writer(seed, datetime.now(UTC)), Authorities.new()
    subjects = iter(f"/document{number}" for number in range(documents))
    while chunk := list(islice(subjects, CHUNK)):
        with tempfile.TemporaryDirectory() as scratch:
            enclaves = [_written(writer, authorities, Path(scratch), subject) for subject in chunk]
            edges = [edge for subject in chunk for edge in writer.requests(subject, requests)]
            pairs = zip(
                real.label(enclaves, edges, Tier.DECISION),
                simulated.label(enclaves, edges, Tier.DECISION),
                strict=True,
            )
            for (edge, decision), (_, modelled) in pairs:
                if decision.allowed == modelled.allowed or "is not modelled" in modelled.reason:
                    yield decision.allowed, ""
                else:
                    yield decision.allowed, _report(edge, decision.reason, modelled.reason, enclaves)


def _written(writer: Writer, authorities: Authorities, root: Path, subject: str) -> InstalledEnclave:
    """Write an enclave with the next documents."""
    permissions, governance = writer.document(), writer.governance()
    folder = authorities.enclave(root / subject[1:], rdns=RDNS, permissions=permissions, governance=governance)
    return InstalledEnclave(subject, folder, "humble", root)


def _report(edge: Edge, real: str, modelled: str, enclaves: list[InstalledEnclave]) -> str:
    folder = next(enclave.folder for enclave in enclaves if enclave.subject == edge.subject)
    document = smime.signed_content((folder / "permissions.p7s").read_bytes()).decode()
    governance = smime.signed_content((folder / "governance.p7s").read_bytes()).decode()
    return f"{edge}\n  real: {real}\n  model: {modelled}\n{document}{governance}"
