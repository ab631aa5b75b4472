"""Building: from a package to unsigned documents, to signed artifacts, to findings on them."""

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
    """How often a subject asks for an edge: a hint for the order of rules, which changes nothing of what they mean."""

    edge: Edge
    times: int


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """Options of a build.

    Attributes:
        allow_vendor_specific: turn portability errors into warnings.
        optimise: rewrite documents into smaller ones that mean the same, and order them by demand.
        demand: what is asked for, with its number; what is asked for more often comes earlier.
    """

    allow_vendor_specific: bool = False
    optimise: bool = True
    demand: tuple[Hint, ...] = ()


@dataclass(frozen=True, slots=True)
class BuildResult:
    """What a build gives.

    Attributes:
        documents: unsigned documents by file name.
        diagnostics: what is to be said of them.
        plain_sizes: of the documents that may be rewritten, how many bytes they have when they are not.
    """

    documents: Mapping[str, bytes]
    diagnostics: tuple[Diagnostic, ...] = ()
    plain_sizes: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SigningAuthority:
    """An authority that signs: PEM of its certificate, PEM of its private key, and its password.

    None of the secrets is part of the representation.
    """

    name: str
    certificate: bytes
    key: bytes = field(repr=False)
    password: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True)
class EnclaveCredentials:
    """What the enclave of one subject is made of, beside its documents; all PEM.

    Attributes:
        certificate: the identity certificate.
        key: its private key.
        identity_ca: certificate of the authority that issued it, followed by the intermediates up to its root.
        permissions_ca: certificate of the authority that signs permissions and governance.
        signer: that authority, able to sign.
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
    """One installed enclave, as ``keymint check`` sees it.

    Attributes:
        package: the package as its sources say it now.
        documents: what the current sources build.
        files: the enclave's files by name.
        folder: the enclave's folder as the user would type it.
        identity_ca: trusted certificate(s) of the identity authority, PEM.
        permissions_ca: trusted certificate of the permissions authority, PEM.
        now: the clock, UTC.
        within_days: report what expires within so many days.
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
    """Turns a package into a transport's documents, and those into signed artifacts."""

    API: str

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        """Return the unsigned documents of a package; a pure function of its arguments.

        Raises:
            KeymintError: the policy says what the transport cannot express, with the rule's ``file:line``.
        """

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: EnclaveCredentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """Return the files of the enclave by name, signed.

        Args:
            package: the package.
            documents: unsigned documents as they lie in the build space (perhaps edited by hand).
            credentials: keys and certificates.
            layout: ``sros2`` or ``flat``.
            installed: the enclave's files as they are now; a signed file whose content and signer did not change
                is returned as it is.

        Raises:
            KeymintError: a document is not valid against its schema.
        """

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        """Return the files that a layout keeps once for all enclaves, by path relative to the install space.

        Args:
            artifacts: artifacts by subject, then file name.
            layout: ``sros2`` or ``flat``.
        """

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """Return findings on one installed enclave; every code is stable."""

    def check_all(self, inspections: Sequence[Inspection]) -> Sequence[Diagnostic]:
        """Return findings that concern several enclaves together, e.g. names that a vendor confuses."""


@runtime_checkable
class NameMapping(Protocol):
    """What a build type may offer beside :class:`BuildType`: the endpoints of a transport that an edge stands for.

    Rules on names of the application and rules on names of the transport meet on an endpoint: both count there.
    """

    def endpoints(self, distro: str, edge: Edge) -> Sequence[Edge]:
        """Return the edges of kind ``topic`` that a subject needs for an edge; an edge of that kind is its own.

        Raises:
            KeymintError: the distribution or the permission is not known.
        """

    def meanings(self, distro: str, endpoint: Edge) -> Sequence[Edge]:
        """Return the edges of other kinds that need this edge of kind ``topic`` and are not composite."""

    def mentioned(self, enclave: Enclave) -> Sequence[tuple[str, Sequence[str]]]:
        """Return what the signed documents of an enclave mention: expressions of topics, each with its partitions."""
