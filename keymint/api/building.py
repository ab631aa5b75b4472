# SPDX-License-Identifier: Apache-2.0
"""What build types get and return: documents, authorities and their keys, files, and installed enclaves to check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from comarmor.values import Data, field
from keymint.api.packages import Package
from keymint.errors import Diagnostic, Origin

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey

    from keymint.api.graph import Edge


class Hint(Data):
    """How often a subject uses an edge: a hint for the order of rules, which does not change their meaning."""

    edge: Edge
    times: int


class BuildOptions(Data):
    """Options of a build.

    Attributes:
        allow_vendor_specific: turn portability errors into warnings.
        optimise: rewrite documents into smaller equivalent ones, and order their rules by hints.
        hints: how often edges are used; rules of edges that are used more often come first.
    """

    allow_vendor_specific: bool = False
    optimise: bool = True
    hints: tuple[Hint, ...] = ()


class BuildResult(Data):
    """The result of a build.

    Attributes:
        documents: unsigned documents by file name.
        diagnostics: findings on them.
        plain_sizes: size in bytes of each optimised document before optimisation.
        alike: an object that the results for several packages have in common if their documents differ in names only,
            so that what is proven about one of them holds for all, whichever claims; else None. See ADR 0026.
    """

    documents: Mapping[str, bytes]
    diagnostics: tuple[Diagnostic, ...] = ()
    plain_sizes: Mapping[str, int] = field(default_factory=dict)
    alike: object | None = field(default=None, repr=False, compare=False)


class SigningAuthority(Data):
    """An authority that signs; ``repr`` contains none of the secrets.

    Attributes:
        name: its name in the profile.
        certificate: PEM of its certificate.
        key: PEM of its private key; empty if the key lies in a token.
        password: password of the PEM.
        token_key: the private key, if it lies in a token: it signs as ``cryptography``'s own keys do, and returns no
            secret.
    """

    name: str
    certificate: bytes
    key: bytes = field(repr=False)
    password: bytes | None = field(default=None, repr=False)
    token_key: EllipticCurvePrivateKey | RSAPrivateKey | None = field(default=None, repr=False)


class Layout(Data):
    """A layout of the install space.

    Attributes:
        enclaves: folder of the enclaves below the install space; empty if they lie at its top.
        reserved: names that the first segment of a subject must not have, in any case.
    """

    enclaves: str
    reserved: tuple[str, ...] = ()


class AuthorityRole(Data):
    """An authority that the enclave of a package rests on.

    Attributes:
        role: what it does, as the build type calls it, e.g. ``identity``.
        name: its name in the profile.
        origin: where the package names it.
        signs: its private key is needed to install the enclave.
    """

    role: str
    name: str
    origin: Origin
    signs: bool = False


class Credentials(Data):
    """The keys and certificates of an enclave, or the authorities of shared documents; all PEM.

    Attributes:
        chains: by role, the certificate of the authority, followed by those of the authorities above it. For shared
            documents: the chains that the packages have in this role, each once.
        signers: by role, the authorities that sign, with their private keys; access raises a KeymintError if a key is
            elsewhere, so ask only when something must be signed. For shared documents all packages have the same.
        certificate: the identity certificate; empty for shared documents.
        key: its private key; empty if it is elsewhere, and the enclave has no ``key.pem``.
        revocations: the revocation list of the certificate's issuer; empty if it never revoked anything.
    """

    chains: Mapping[str, bytes]
    signers: Mapping[str, SigningAuthority]
    certificate: bytes = b""
    key: bytes = field(default=b"", repr=False)
    revocations: bytes = b""


class Artifact(Data):
    """A file to install: its bytes and whether it is secret (mode 0600) or public (0644)."""

    content: bytes = field(repr=False)
    secret: bool = False


class EnvironmentVariable(Data):
    """An environment variable of a process that uses the keystore.

    Attributes:
        name: its name.
        value: its value; or a path relative to the install space, empty for the install space itself.
        is_path: the value is such a path. The variable has the absolute path.
    """

    name: str
    value: str
    is_path: bool = False


class Inspection(Data):
    """An installed enclave, or installed shared documents, and the state that ``keymint check`` expects.

    Attributes:
        packages: the package of the enclave, or all packages of the build type, as their sources define them now.
        documents: the documents that the build type builds from the current sources; shared ones by path relative to
            the install space.
        files: the enclave's files by name, those of :meth:`BuildType.files` only; or the installed shared documents and
            the files beside them that belong to them. A missing shared document is reported already.
        folder: the enclave's folder, or for shared documents the install space, as the user would type it.
        layout: name of the layout.
        chains: trusted certificate chains by role, PEM; empty bytes for an authority without a certificate. For shared
            documents as :class:`Credentials` has them.
        now: the clock, UTC.
        within_days: report certificates and documents that expire within this number of days.
        enclaves: for shared documents, files of each installed enclave by subject, those of :meth:`BuildType.files`
            only.
    """

    packages: Sequence[Package]
    documents: Mapping[str, bytes]
    files: Mapping[str, bytes] = field(repr=False)
    folder: str
    layout: str
    chains: Mapping[str, bytes]
    now: datetime
    within_days: float
    enclaves: Mapping[str, Mapping[str, bytes]] = field(default_factory=dict, repr=False)

    @property
    def package(self) -> Package:
        """The package of the enclave; not for shared documents."""
        [package] = self.packages
        return package


class Implementation(Data):
    """An implementation of a transport, as it was measured.

    Attributes:
        name: short name, lower case, for the command line.
        title: its name and version.
        bundles: the roles of authorities (:attr:`keymint.api.AuthorityRole.role`) in which subjects may trust two
            authorities at once, if these have key identifiers.
        reissues: the roles in which subjects that have the old certificate of a key, and subjects that have a new one,
            accept each other.
    """

    name: str
    title: str
    bundles: frozenset[str] = frozenset()
    reissues: frozenset[str] = frozenset()
