# SPDX-License-Identifier: Apache-2.0
"""Compare the simulated vendors with the real ones; print counts and disagreements, and exit with 1 if there are any.

usage: python benchmarks/agreement.py [--documents N] [--requests N] [--seed N] [cyclonedds] [fastdds] [zenoh]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import zenoh_agreement
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from documents import Writer
from floor import authority, builder_of, private_bytes

from keymint.api import Enclave, Environment, Tier
from keymint.graph import Edge
from keymint.pki import smime
from keymint.plugins import Plugins

PAIRS = {"cyclonedds": "cyclonedds-0.10", "fastdds": "fastdds-2.9"}
ZENOH = "zenoh"
DOCUMENTS_PER_ROUTER = 10
"""A router's configuration is compared on hundreds of requests of three sessions."""
CHUNK = 100
"""Documents on the disk at a time."""


class Enclaves:
    """Writes enclaves of one identity, with the documents of a writer."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        ca, ca_key = authority("identity_ca")
        self._notary, self._notary_key = authority("permissions_ca")
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name(
            [
                x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, "4f"),
                x509.NameAttribute(NameOID.COMMON_NAME, "/robot"),
            ]
        )
        usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH])
        builder = builder_of(subject, ca.subject, key.public_key()).add_extension(usages, critical=False)
        encoding = serialization.Encoding.PEM
        self.files = {
            "cert.pem": builder.sign(ca_key, hashes.SHA256()).public_bytes(encoding),
            "key.pem": private_bytes(key),
            "identity_ca.cert.pem": ca.public_bytes(encoding),
            "permissions_ca.cert.pem": self._notary.public_bytes(encoding),
        }

    def write(self, folder: Path, subject: str) -> Enclave:
        """Write an enclave with the next documents."""
        folder.mkdir()
        files = self.files | {
            "permissions.p7s": self.sign(self._writer.document()),
            "governance.p7s": self.sign(self._writer.governance()),
        }
        for name, content in files.items():
            (folder / name).write_bytes(content)
        return Enclave(subject, folder, "humble", folder.parent)

    def sign(self, content: bytes) -> bytes:
        """Sign a document with the permissions authority."""
        return smime.sign(content, self._notary, self._notary_key)


def disagreements(plugins: Plugins, vendor: str, documents: int, requests: int, seed: int) -> Iterator[tuple[int, str]]:
    """Yield for each request whether the vendor allows it, and how its model disagrees.

    The second part is empty if the model agrees, or does not know.
    """
    real, simulated = plugins.transport(vendor), plugins.transport(PAIRS[vendor])
    writer = Writer(seed, datetime.now(UTC))
    writer_of_enclaves = Enclaves(writer)
    subjects = iter(f"/document{number}" for number in range(documents))
    while chunk := list(islice(subjects, CHUNK)):
        with tempfile.TemporaryDirectory() as scratch:
            enclaves = [writer_of_enclaves.write(Path(scratch) / subject[1:], subject) for subject in chunk]
            edges = [edge for subject in chunk for edge in writer.requests(subject, requests)]
            pairs = zip(
                real.label(enclaves, edges, Tier.DECISION),
                simulated.label(enclaves, edges, Tier.DECISION),
                strict=True,
            )
            for (edge, decision), (_, modelled) in pairs:
                if decision.allowed == modelled.allowed or "is not modelled" in modelled.reason:
                    yield int(decision.allowed), ""
                else:
                    yield int(decision.allowed), _report(edge, decision.reason, modelled.reason, enclaves)


def _report(edge: Edge, real: str, modelled: str, enclaves: list[Enclave]) -> str:
    folder = next(enclave.folder for enclave in enclaves if enclave.subject == edge.subject)
    document = smime.signed_content((folder / "permissions.p7s").read_bytes()).decode()
    governance = smime.signed_content((folder / "governance.p7s").read_bytes()).decode()
    return f"{edge}\n  real: {real}\n  model: {modelled}\n{document}{governance}"


def main() -> int:
    """Compare, print, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vendors", nargs="*", default=[], help=f"of {', '.join([*PAIRS, ZENOH])}; all if none is given")
    parser.add_argument("--documents", type=int, default=400)
    parser.add_argument("--requests", type=int, default=40)
    parser.add_argument("--seed", type=int, default=2018)
    parser.add_argument("--show", type=int, default=10, help="number of disagreements to print in full")
    options = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as cache:
        plugins = Plugins(environment=Environment(datetime.now(UTC), Path(cache)))
        for vendor in options.vendors or [*PAIRS, ZENOH]:
            if vendor == ZENOH:
                wrong += zenoh_agreement.report(options.documents // DOCUMENTS_PER_ROUTER, options.seed)
                continue
            usable = plugins.transport(vendor).usable()
            if not usable.usable:
                print(f"{vendor}: not usable: {usable.reason} ({usable.help})")
                continue
            pairs = allowed = differing = 0
            for was_allowed, text in disagreements(plugins, vendor, options.documents, options.requests, options.seed):
                pairs, allowed, differing = pairs + 1, allowed + was_allowed, differing + bool(text)
                if text and differing <= options.show:
                    print(text)
            print(
                f"{vendor} {usable.version} and its model {PAIRS[vendor]}: {pairs} (document, request) pairs of "
                f"{options.documents} documents, {allowed} allowed, {differing} disagreements"
            )
            wrong += differing
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
