# SPDX-License-Identifier: Apache-2.0
"""Build types: build unsigned documents of a package, sign and install them, and check installed enclaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic
from keymint.api.packages import Package
from keymint.api.transports import Enclave
from keymint.graph import Edge


@dataclass(frozen=True, slots=True)
class Hint:
    """How often a subject uses an edge: a hint for the order of rules, which does not change their meaning."""

    edge: Edge
    times: int


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """Options of a build.

    Attributes:
        allow_vendor_specific: turn portability errors into warnings.
        optimise: rewrite documents into smaller equivalent ones, and order their rules by hints.
        hints: how often edges are used; rules of edges that are used more often come first.
    """

    allow_vendor_specific: bool = False
    optimise: bool = True
    hints: tuple[Hint, ...] = ()


@dataclass(frozen=True, slots=True)
class BuildResult:
    """The result of a build.

    Attributes:
        documents: unsigned documents by file name.
        diagnostics: findings on them.
        plain_sizes: size in bytes of each optimised document before optimisation.
    """

    documents: Mapping[str, bytes]
    diagnostics: tuple[Diagnostic, ...] = ()
    plain_sizes: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SigningAuthority:
    """An authority that signs: PEM of its certificate, PEM of its private key, and its password.

    ``repr`` contains none of the secrets.
    """

    name: str
    certificate: bytes
    key: bytes = field(repr=False)
    password: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True)
class EnclaveCredentials:
    """The keys and certificates of an enclave, all PEM.

    Attributes:
        certificate: the identity certificate.
        key: its private key.
        identity_ca: certificate of the authority that issued it, followed by the intermediates up to its root.
        permissions_ca: certificate of the authority that signs permissions and governance.
        signer: that authority, with its private key.
    """

    certificate: bytes
    key: bytes = field(repr=False)
    identity_ca: bytes
    permissions_ca: bytes
    signer: SigningAuthority


@dataclass(frozen=True, slots=True)
class Artifact:
    """A file to install: its bytes and whether it is secret (mode 0600) or public (0644)."""

    content: bytes = field(repr=False)
    secret: bool = False


@dataclass(frozen=True, slots=True)
class Inspection:
    """An installed enclave with the expected state that ``keymint check`` compares it with.

    Attributes:
        package: the package as its sources define it now.
        documents: the documents that the current sources build.
        files: the enclave's files by name.
        folder: the enclave's folder as the user would type it.
        identity_ca: trusted certificate(s) of the identity authority, PEM.
        permissions_ca: trusted certificate of the permissions authority, PEM.
        now: the clock, UTC.
        within_days: report certificates and documents that expire within this number of days.
    """

    package: Package
    documents: Mapping[str, bytes]
    files: Mapping[str, bytes] = field(repr=False)
    folder: str
    layout: str
    identity_ca: bytes
    permissions_ca: bytes
    now: datetime
    within_days: float


class BuildType(Protocol):
    """Builds a transport's documents from a package, and signs and checks them."""

    API: str

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        """Return the unsigned documents of a package; a pure function of its arguments.

        Raises:
            KeymintError: the transport cannot express a rule; with the rule's ``file:line``.
        """

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: EnclaveCredentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """Return the files of the enclave by name, with signed documents.

        Args:
            package: the package.
            documents: unsigned documents of the build space, which may have been edited by hand.
            credentials: keys and certificates.
            layout: ``sros2`` or ``flat``.
            installed: the enclave's current files; a signed file whose content and signer are unchanged is returned
                unchanged.

        Raises:
            KeymintError: a document violates its schema.
        """

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        """Return the files that all enclaves of a layout share, by path relative to the install space.

        Args:
            artifacts: artifacts by subject, then file name.
            layout: ``sros2`` or ``flat``.
        """

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """Return findings on one installed enclave; their codes are stable."""

    def check_all(self, inspections: Sequence[Inspection]) -> Sequence[Diagnostic]:
        """Return findings that involve several enclaves, e.g. names that a vendor confuses."""


@runtime_checkable
class NameMapping(Protocol):
    """Optional capability of a build type: maps edges on application names to endpoints of the transport.

    Rules on application names and rules on transport names both apply to an endpoint.
    """

    def endpoints(self, distro: str, edge: Edge) -> Sequence[Edge]:
        """Return the edges of kind ``topic`` that implement an edge; an edge of that kind implements itself.

        Raises:
            KeymintError: the distribution or the permission is not known.
        """

    def meanings(self, distro: str, endpoint: Edge) -> Sequence[Edge]:
        """Return the elementary edges of other kinds that this edge of kind ``topic`` implements."""

    def document_topics(self, enclave: Enclave) -> Sequence[tuple[str, Sequence[str]]]:
        """Return the topic expressions in the signed documents of an enclave, each with its partitions."""
