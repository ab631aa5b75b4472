# SPDX-License-Identifier: Apache-2.0
"""Keystores that another tool made: what a build type reads from them, so that Keymint can take them over."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from comarmor.values import Data, field
from keymint.api.exchange import ImportedSubject
from keymint.api.packages import DomainRange, KeySpec, Package, Validity
from keymint.api.proving import ComparisonTask
from keymint.api.rights import Comparison, DocumentComparison
from keymint.errors import Diagnostic
from keymint.ir import SubjectRules


class KeystoreFile(Data):
    """A file of a keystore.

    Attributes:
        content: its bytes; of a link those of the file that it leads to.
        mode: its permission bits, of a link those of that file.
        link: the text of a symbolic link that stays within the keystore; empty for a regular file.
    """

    content: bytes = field(repr=False)
    mode: int
    link: str = ""


class KeystoreFiles(Data):
    """The files of a keystore, read once.

    Attributes:
        folder: its folder as the user would type it.
        files: by path relative to the folder, sorted.
        now: the clock, UTC.
    """

    folder: str
    files: Mapping[str, KeystoreFile] = field(repr=False)
    now: datetime


class FoundAuthority(Data):
    """An authority of a keystore.

    Attributes:
        name: the name that it gets in a workspace.
        roles: what enclaves trust it for, as the build type calls it (:attr:`AuthorityRole.role`).
        certificate: PEM, as it stands in the file.
        file: path of the certificate.
        key: its private key in PEM; empty if it is elsewhere.
        key_files: paths of all files with the private key; the first one is the one that is used.
        facts: what a report says about it; values are those of JSON.
        exposed: others could read its private key.
    """

    name: str
    roles: tuple[str, ...]
    certificate: bytes
    file: str
    key: bytes = field(repr=False)
    key_files: tuple[str, ...]
    facts: Mapping[str, Any]
    exposed: bool = False


class FoundGrant(Data):
    """The signed rights of an enclave.

    Attributes:
        document: the unsigned document; its signature was verified.
        file: the signed file as the user would type it.
        offset: number of lines before the document in that file.
        subject_name: whom it grants rights to, in the order of RFC 2253.
    """

    document: bytes = field(repr=False)
    file: str
    offset: int
    subject_name: str


class FoundEnclave(Data):
    """An enclave of a keystore.

    Attributes:
        subject: the subject, ``/`` and a path.
        files: its files by the names that the layout gives them, each with its path in the keystore.
        certificate: PEM, as it stands in the file; empty if it is missing or damaged.
        key: PEM of the private key; empty if it is elsewhere.
        key_spec: the kind of the key; None if the certificate is missing or damaged.
        subject_name: distinguished name of the certificate as text, in certificate order.
        validity: validity of the certificate.
        grant_validity: validity of the grant, if there is one grant with two dates.
        domains: domains of the grant, if its rules have the same.
        documents: the signed documents, by the names of the unsigned ones (:attr:`BuildResult.documents`); only those
            whose signature verifies.
        grant: its rights, if they verify and there is one grant.
        facts: what a report says about it; values are those of JSON.
        exposed: others could read its private key.
    """

    subject: str
    files: Mapping[str, str]
    certificate: bytes
    key: bytes = field(repr=False)
    key_spec: KeySpec | None
    subject_name: str
    validity: Validity | None
    grant_validity: Validity | None
    domains: tuple[DomainRange, ...]
    documents: Mapping[str, bytes]
    grant: FoundGrant | None
    facts: Mapping[str, Any]
    exposed: bool = False


class FoundKeystore(Data):
    """What a build type found in a keystore.

    Attributes:
        form: the form of the keystore in words, e.g. its tool.
        layout: the layout of its files (:attr:`BuildType.LAYOUTS`); empty if they lie in another way.
        subject_format: form that all subject names have, as the profile type calls it; empty if there is none.
        authorities: the authorities that its enclaves trust.
        enclaves: by subject, sorted.
        kept: paths of the files that a workspace's install space has at the same place.
        defaults: defaults of the parts that the build type reads from a package, by name (:attr:`BuildType.PARTS`).
        diagnostics: findings. An error is a reason why the keystore cannot be taken over as it is.
        revocation_lists: the revocation list in force of an authority, PEM, by the authority's name.
    """

    form: str
    layout: str
    subject_format: str
    authorities: tuple[FoundAuthority, ...]
    enclaves: tuple[FoundEnclave, ...]
    kept: tuple[str, ...]
    defaults: Mapping[str, bytes]
    diagnostics: tuple[Diagnostic, ...]
    revocation_lists: Mapping[str, bytes] = field(default_factory=dict, repr=False)


class AdoptedSources(Data):
    """What the sources of a package must say so that they describe an enclave that another tool made.

    Attributes:
        rules: the rules of the subject.
        subject_name: distinguished name, in certificate order; empty for that of the profile.
        validity: validity of the certificate.
        grant_validity: validity of the grant.
        domains: domains of the grant; empty for those of the profile.
        key: the kind of the key.
        documents: the signed documents, by the names of the unsigned ones.
    """

    rules: SubjectRules
    subject_name: str
    validity: Validity
    grant_validity: Validity
    domains: tuple[DomainRange, ...]
    key: KeySpec
    documents: Mapping[str, bytes] = field(repr=False)


# -- learn a policy from documents in force: a build type reads their rules, and a policy type writes them ------------


class GrantedRules(Data):
    """What the signed document of an enclave grants, as rules in which DENY overrides ALLOW.

    Attributes:
        rules: the rules of the subject; their places are those of the document.
        document: the document, unsigned; its signature was verified.
        file: its file as the user would type it.
        offset: number of lines before it in that file.
        subject_name: distinguished name of the identity, in the order of RFC 2253.
        domains: the domains in which the document permits anything.
        diagnostics: what a policy does not keep because it has no effect, as warnings.
    """

    rules: SubjectRules
    document: bytes = field(repr=False)
    file: str
    offset: int
    subject_name: str
    domains: tuple[DomainRange, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


class KeystoreReader(ABC):
    """Reads keystores and documents that other tools made."""

    @abstractmethod
    def found(self, keystore: KeystoreFiles) -> FoundKeystore:
        """Return what a keystore has: its authorities, enclaves and documents, examined.

        Raises:
            KeymintError: it has no enclave that the build type knows.
        """

    @abstractmethod
    def not_kept(self, package: Package, name: str, document: bytes) -> str:
        """Return why a document is not one that the sources of a package could build; empty if it is.

        Args:
            package: the package.
            name: name of the unsigned document (:attr:`BuildResult.documents`).
            document: its content.
        """

    @abstractmethod
    def granted(self, keystore: KeystoreFiles, enclave: FoundEnclave, distro: str) -> GrantedRules:
        """Return what the signed document of an enclave grants.

        Names of the application take the place of those of the transport where the latter say so.

        Args:
            keystore: the keystore.
            enclave: an enclave in it.
            distro: ROS 2 distribution whose name mapping applies.

        Raises:
            KeymintError: the signature does not verify, the document cannot be read, or no policy can say what it
                grants; with ``file:line``.
        """

    @abstractmethod
    def compared(self, task: ComparisonTask) -> DocumentComparison:
        """Compare a document, as the transport's standard reads it, with the rules of a subject.

        Dates are not compared: each grant that is ever in force must permit what the rules allow.

        Raises:
            KeymintError: a rule cannot be mapped; with ``file:line``. A document that cannot be read is ``unknown``.
        """

    @abstractmethod
    def compare(self, subject: ImportedSubject, distro: str, states: int, go_on: Callable[[], bool]) -> Comparison:
        """Compare a document of another tool, and the one that is compiled here, with the rules of a subject.

        Args:
            subject: the subject.
            distro: ROS 2 distribution.
            states: the most states that the search for one claim may visit.
            go_on: polled; a search ends when it returns False.

        Raises:
            KeymintError: the document cannot be read, or a rule cannot be mapped.
        """
