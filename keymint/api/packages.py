# SPDX-License-Identifier: Apache-2.0
"""Keys, certificates and authorities, and source packages: identity and rights of one subject, for its build types."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from enum import StrEnum

from comarmor.values import Data, field
from keymint.errors import Origin
from keymint.ir import SubjectRules


class Validity(Data):
    """A period of validity, in UTC, both ends included (RFC 5280, 4.1.2.5).

    Attributes:
        origin: where its end is written, or None.
    """

    not_before: datetime
    not_after: datetime
    origin: Origin | None = field(default=None, compare=False)


class KeySpec(Data):
    """An asymmetric key to mint, or one in a PKCS #11 token.

    Attributes:
        algorithm: ``"ec"`` or ``"rsa"``.
        curve: for EC, upper case SEC name, e.g. ``SECP256R1``; else empty.
        size: for RSA, bits; else 0.
        password_env: name of the environment variable that holds the password the stored key is encrypted with;
            empty for an unencrypted key (mode 0600).
        uri: URI of the private key in its token (RFC 7512); empty for a key in a file.
        pin_env: name of the environment variable that holds the PIN of the token; empty for the usual one.
    """

    algorithm: str
    curve: str = ""
    size: int = 0
    password_env: str = ""
    uri: str = ""
    pin_env: str = ""


class Extension(Data):
    """An X.509 v3 extension in the notation of OpenSSL's ``x509v3_config``.

    Attributes:
        name: short name (``basicConstraints``, ``keyUsage``, ``extendedKeyUsage``, ``subjectAltName``, …).
        value: e.g. ``CA:TRUE, pathlen:0`` or ``digitalSignature, keyCertSign``.
        critical: marks the extension critical.
        origin: where it is written.
    """

    name: str
    value: str
    critical: bool
    origin: Origin


class CertificateSpec(Data):
    """A certificate to issue.

    Attributes:
        subject_name: distinguished name as text (RFC 4514 or OpenSSL's one-line form), placeholders expanded, in
            certificate order: ``CN=/talker,OU=2f…``.
        validity: the requested period; it is clamped to the issuer's when the certificate is issued.
        serial: serial number, or None for a random one.
        issuer: name of the issuing authority; empty for a self-signed certificate.
        hash_algorithm: ``SHA256``, ``SHA384`` or ``SHA512``.
        key: the key pair.
        extensions: extensions that add to or replace the defaults of its role (authority or identity).
        origin: where it is requested.
        adopted: PEM of the certificate itself, if somebody else issued it: it is used as it is. Else empty.
    """

    subject_name: str
    validity: Validity
    serial: int | None
    issuer: str
    hash_algorithm: str
    key: KeySpec
    extensions: tuple[Extension, ...]
    origin: Origin
    adopted: bytes = b""


class Phase(StrEnum):
    """How far the replacement of an authority's key has come."""

    DISTRIBUTE = "distribute"
    """All enclaves trust the next authority beside the present one, which still issues."""
    REISSUE = "reissue"
    """The next authority issues, and all enclaves still trust the former one beside it."""
    STAGE = "stage"
    """A second keystore, by the next authority, lies beside the one in force."""
    END = "end"
    """There is one authority again, the next one; nothing records this phase."""


class Rollover(Data):
    """The replacement of an authority's key, under way.

    Attributes:
        phase: how far it has come.
        certificate: PEM of the authority's other certificate: the next one, in :attr:`Phase.REISSUE` the former one.
    """

    phase: Phase
    certificate: bytes


class AuthorityIssuance(Data):
    """What was decided about the certificate of an authority, beyond the documents of its owner.

    Attributes:
        renewed: when it was renewed, UTC: it ends as long after that as these documents say for its begin, which stays.
            None if it was never renewed.
        adopted: PEM of a certificate that somebody else issued, or that was issued after such a one; else empty.
        rollover: the replacement of its key, or None if none is under way.
        exposed: as :attr:`Issuance.exposed`.
    """

    renewed: datetime | None = None
    adopted: bytes = b""
    rollover: Rollover | None = None
    exposed: str = ""


class Authority(Data):
    """A certificate authority of the workspace.

    Attributes:
        name: its name in the profile.
        certificate: its certificate, with the validity that it has since it was renewed.
        issuance: what was decided about it beyond the documents of its owner.
    """

    name: str
    certificate: CertificateSpec
    issuance: AuthorityIssuance = AuthorityIssuance()


# -- packages --------------------------------------------------------------------------------------------------------


class DomainRange(Data, order=True):
    """Domain ids from ``first`` to ``last``, both included."""

    first: int
    last: int


class Role(StrEnum):
    """Why a workspace has a package."""

    SUBJECT = "subject"
    """It is for a subject of the policy."""
    INFRASTRUCTURE = "infrastructure"
    """A transport needs its identity, and the policy grants it nothing."""


class Grant(Data):
    """The grant of a subject: its rules, domains and validity.

    Attributes:
        issuer: name of the authority that signs the rights.
        name: the grant's name attribute.
        subject_name: distinguished name as text; must equal that of the identity. Empty if the sources give none.
        validity: None if the sources give none.
        domains: domains in which the grant is valid.
        domains_origin: where these are written, if not at ``origin``.
        defaults_origin: the document of the values that the grant leaves out.
        edited: the rules were edited by hand and differ from the policy.
    """

    issuer: str
    name: str
    subject_name: str
    validity: Validity | None
    domains: tuple[DomainRange, ...]
    rules: SubjectRules
    origin: Origin
    domains_origin: Origin | None = None
    defaults_origin: Origin | None = None
    edited: bool = False


class SourcePart(Data):
    """A document of a package that only its build type reads, and its defaults.

    Attributes:
        name: name of the part, by which the build type asks for it (:attr:`BuildType.PARTS`).
        file: path of the document as the user would type it.
        content: the document, or None if the package has none.
        defaults_file: path of the defaults as the user would type it.
        defaults: the defaults, from the package or else from the profile; None if there are none.
        issuer: name of the authority that the manifest names for the part; empty if it names none.
        where: place of the part in the manifest.
    """

    name: str
    file: str
    content: bytes | None = field(repr=False)
    defaults_file: str
    defaults: bytes | None = field(repr=False)
    issuer: str
    where: Origin


class PackageSources(Data):
    """The sources of a package, as a build type needs them to read its parts.

    Attributes:
        name: package name.
        subject: ``"/" + name``.
        role: why the package exists.
        distro: ROS 2 distribution whose name mapping applies.
        parts: the parts that the build types of the package read, by name.
        authorities: names of the profile's authorities.
        accepts: weakenings of the policy that the profile accepts.
        install_space: absolute path of the install space on this machine.
        identity: the subject's certificate; None if its document has defects, which are reported in any case.
        grant: the subject's rights; None in the same case.
    """

    name: str
    subject: str
    role: Role
    distro: str
    parts: Mapping[str, SourcePart]
    authorities: tuple[str, ...]
    accepts: frozenset[str]
    install_space: str
    identity: CertificateSpec | None
    grant: Grant | None


class PackageSettings(Data):
    """What a build type read from the sources of a package.

    Attributes:
        value: data that only the build type itself reads; frozen and comparable.
        extensions: X.509 extensions that the identity gets, unless its sources give an extension of that name.
    """

    value: object
    extensions: tuple[Extension, ...] = ()


class Issuance(Data):
    """What an authority decided about the certificate and the grant of a package, beyond the documents of its owner.

    The certificate and the grant are of one generation, which their subject names show, and change together.

    Attributes:
        generation: rises whenever the certificate is revoked, and never falls.
        renewed: begin of validity of the certificate and of the grant, UTC, if it is later than their own documents
            say; the length of each stays. None if they were never renewed.
        public_key: the subject's public key (SubjectPublicKeyInfo in PEM), if the private key is not in the workspace:
            the subject's machine made it, and it never left that. Empty if the workspace has the key.
        certificate: PEM of a certificate that another tool issued. It is used as it is for as long as the sources ask
            for its subject name, validity and issuer, and it is for the subject's key. Empty if there is none.
        exposed: fingerprint (SHA-256 of the public key, hexadecimal) of a private key that others could read before it
            was taken over; empty if there is none.
    """

    generation: int = 0
    renewed: datetime | None = None
    public_key: bytes = b""
    certificate: bytes = b""
    exposed: str = ""


class Package(Data):
    """A loaded source package: the input of build types for one subject.

    Attributes:
        name: package name, e.g. ``robot1/arm/driver`` (its folder under the source space).
        subject: ``"/" + name``.
        distro: ROS 2 distribution whose name mapping applies.
        identity: the subject's certificate.
        grant: the subject's rights.
        build_types: names of the plugins that build it, at least one.
        settings: what each build type read from the sources, by its name (:attr:`PackageSettings.value`).
        issuers: the chain of authorities from the identity's issuer up to the root.
        role: why the package exists.
        infrastructure: the packages of that role in the workspace that have a build type in common with this one.
        issuance: what an authority decided about the certificate and the grant, which have it in their names and
            periods already.
        kept: documents that another tool signed, by the names of the unsigned ones. A build type goes on with such a
            document for as long as it means what the sources say.
    """

    name: str
    subject: str
    distro: str
    identity: CertificateSpec
    grant: Grant
    build_types: tuple[str, ...]
    settings: Mapping[str, object]
    issuers: tuple[Authority, ...] = ()
    role: Role = Role.SUBJECT
    infrastructure: tuple[Package, ...] = ()
    issuance: Issuance = Issuance()
    kept: Mapping[str, bytes] = field(default_factory=dict, repr=False)
