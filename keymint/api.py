"""What plugins implement, and the data that passes between them and the stages.

A plugin is an object with an attribute ``API = "1.0"`` that is registered under one of the entry-point groups
below. Plugins are pure: they get bytes and data types, and return bytes and data types. They never write files,
never read the clock or the environment; reading is confined to what a method's arguments name.

===========================  ======================================================
group                        protocol
===========================  ======================================================
``keymint.profile_types``    :class:`ProfileType`
``keymint.package_types``    :class:`PackageType`
``keymint.policy_types``     :class:`PolicyType`
``keymint.build_types``      :class:`BuildType`
``keymint.transports``       :class:`TransportType`
``keymint.graph_sources``    :class:`GraphSource`
===========================  ======================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from keymint.errors import Diagnostic, Origin
from keymint.graph import Edge, Graph
from keymint.ir import Rule, SubjectRules

API_VERSION = "1.0"

# ---------------------------------------------------------------------------------------------------------------
# Certificates, as a profile or a package asks for them
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Validity:
    """A period of validity, in UTC, both ends included (RFC 5280, 4.1.2.5)."""

    not_before: datetime
    not_after: datetime


@dataclass(frozen=True, slots=True)
class KeySpec:
    """An asymmetric key to mint.

    Attributes:
        algorithm: ``"ec"`` or ``"rsa"``.
        curve: for EC, upper case SEC name, e.g. ``SECP256R1``; else empty.
        size: for RSA, bits; else 0.
        password_env: name of the environment variable that holds the password the stored key is encrypted with;
            empty for a key stored unencrypted (mode 0600).
    """

    algorithm: str
    curve: str = ""
    size: int = 0
    password_env: str = ""


@dataclass(frozen=True, slots=True)
class Extension:
    """An X.509 v3 extension in the notation of OpenSSL's ``x509v3_config``.

    Attributes:
        name: short name (``basicConstraints``, ``keyUsage``, ``extendedKeyUsage``, ``subjectAltName``, …).
        value: e.g. ``CA:TRUE, pathlen:0`` or ``digitalSignature, keyCertSign``.
        critical: marks the extension critical.
        origin: where a person wrote it.
    """

    name: str
    value: str
    critical: bool
    origin: Origin


@dataclass(frozen=True, slots=True)
class CertificateSpec:
    """A certificate to issue.

    Attributes:
        subject_name: distinguished name as text (RFC 4514 or OpenSSL's one-line form), placeholders expanded, in
            certificate order: ``CN=/talker,OU=2f…``.
        validity: what is asked for; it is clamped to the issuer's when issued.
        serial: serial number, or None for a random one.
        issuer: name of the issuing authority; empty for a self-signed certificate.
        hash_algorithm: ``SHA256``, ``SHA384`` or ``SHA512``.
        key: the key pair.
        extensions: extensions beside, or in place of, the defaults of its role (authority or identity).
        origin: where a person asked for it.
    """

    subject_name: str
    validity: Validity
    serial: int | None
    issuer: str
    hash_algorithm: str
    key: KeySpec
    extensions: tuple[Extension, ...]
    origin: Origin


@dataclass(frozen=True, slots=True)
class Authority:
    """A certificate authority of the workspace: its name in the profile, and its certificate."""

    name: str
    certificate: CertificateSpec


# ---------------------------------------------------------------------------------------------------------------
# What a package asks of its transport
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, order=True)
class DomainRange:
    """DDS domain ids from ``first`` to ``last``, both included."""

    first: int
    last: int


@dataclass(frozen=True, slots=True)
class TopicProtection:
    """A rule of a governance document for the topics that match (DDS Security 1.1, 9.4.1.2.5).

    Attributes:
        kind: ``topic`` for a raw DDS topic expression, or ``ros_topic``, ``ros_service``, ``ros_action``,
            ``ros_parameter`` for an expression over ROS names.
        expression: POSIX ``fnmatch`` expression.
        metadata_protection_kind: NONE, SIGN, ENCRYPT, SIGN_WITH_ORIGIN_AUTHENTICATION, ENCRYPT_WITH_….
        data_protection_kind: NONE, SIGN or ENCRYPT.
    """

    kind: str
    expression: str
    enable_discovery_protection: bool
    enable_liveliness_protection: bool
    enable_read_access_control: bool
    enable_write_access_control: bool
    metadata_protection_kind: str
    data_protection_kind: str
    origin: Origin


@dataclass(frozen=True, slots=True)
class DomainRule:
    """A domain rule of a governance document (DDS Security 1.1, 9.4.1.2.4)."""

    domains: tuple[DomainRange, ...]
    allow_unauthenticated_participants: bool
    enable_join_access_control: bool
    discovery_protection_kind: str
    liveliness_protection_kind: str
    rtps_protection_kind: str
    topic_rules: tuple[TopicProtection, ...]
    origin: Origin


@dataclass(frozen=True, slots=True)
class Governance:
    """Protection of domains and topics, signed by ``issuer``, an authority's name."""

    issuer: str
    domain_rules: tuple[DomainRule, ...]


@dataclass(frozen=True, slots=True)
class Permissions:
    """The grant of a subject: what it may do, where and how long, signed by ``issuer``, an authority's name.

    Attributes:
        grant_name: the grant's name attribute.
        subject_name: distinguished name as text; must be that of the identity.
        domains: domains in which the grant holds.
    """

    issuer: str
    grant_name: str
    subject_name: str
    validity: Validity
    domains: tuple[DomainRange, ...]
    rules: SubjectRules
    origin: Origin


@dataclass(frozen=True, slots=True)
class Package:
    """A source package, loaded: everything that a build type needs to know of one subject.

    Attributes:
        name: package name, e.g. ``robot1/arm/driver`` (its folder under the source space).
        subject: ``"/" + name``.
        build_type: name of the plugin that builds it.
        distro: ROS 2 distribution whose name mapping applies.
        identity: the certificate of the subject.
        issuers: the authorities above the identity, from its issuer up to the root.
    """

    name: str
    subject: str
    build_type: str
    distro: str
    identity: CertificateSpec
    permissions: Permissions
    governance: Governance
    issuers: tuple[Authority, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()


# ---------------------------------------------------------------------------------------------------------------
# Profiles
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PolicySource:
    """A policy that the profile names: a file or a directory, and where else its includes may be found."""

    name: str
    path: Path
    origin: Origin


@dataclass(frozen=True, slots=True)
class Profile:
    """A workspace profile, loaded.

    Attributes:
        name: the profile's name.
        profile_type: the plugin that loaded it.
        policy_type: the plugin that acquires policy.
        package_type: the plugin that creates packages.
        policies: the policies in the order of the profile.
        library: a folder in which includes are looked up that the including file's own folder lacks.
        authorities: in the order of the profile; an issuer stands anywhere.
        layout: ``sros2`` or ``flat``: the layout of the install space.
        distro: ROS 2 distribution.
        files: files of the profile by path relative to the profile space (for plugins of the same format).
    """

    name: str
    profile_type: str
    policy_type: str
    package_type: str
    policies: tuple[PolicySource, ...]
    library: Path | None
    authorities: tuple[Authority, ...]
    layout: str
    distro: str
    files: Mapping[str, bytes] = field(repr=False)


@dataclass(frozen=True, slots=True)
class Bootstrap:
    """What ``keymint init`` was asked for.

    Attributes:
        name: name of the new profile.
        policy: path to write into ``policies.xml``, as text, relative to the profile space or absolute; empty for
            the example policy that the profile type brings along.
        distro: ROS 2 distribution.
        domain: DDS domain id.
        layout: ``sros2`` or ``flat``; empty for what the distro takes.
        subject_format: ``unique`` (a second RDN that no other subject has) or ``sros2`` (the bare CN).
        now: the clock, UTC.
    """

    name: str
    policy: str
    distro: str
    domain: int
    layout: str
    subject_format: str
    now: datetime


class ProfileType(Protocol):
    """Bootstraps and loads the profile space of a workspace."""

    API: str

    def bootstrap(self, request: Bootstrap) -> Mapping[str, bytes]:
        """Return the files of a new profile by path relative to the profile space.

        Raises:
            KeymintError: the request names a distro or layout that is not known.
        """

    def library(self, distro: str) -> Path:
        """Return the folder of shipped policy fragments of a distro (what ``bootstrap`` copies into the profile)."""

    def recognises(self, files: Mapping[str, bytes]) -> bool:
        """Tell whether these files of a profile space are of this type."""

    def load(self, root: Path, files: Mapping[str, bytes]) -> Profile:
        """Load a profile from its files.

        Args:
            root: the profile space; only to resolve the policy's path and to name places in messages.
            files: XML files of the profile space by relative path.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def with_policy(self, files: Mapping[str, bytes], policy: str) -> Mapping[str, bytes]:
        """Return the files that change when the profile is bound to another policy path.

        Raises:
            KeymintError: the profile's list of policies was edited by hand, so that it is not ours to change.
        """


class PackageType(Protocol):
    """Creates and loads source packages."""

    API: str
    MARKER: str
    """Name of the file that makes a folder a package, e.g. ``keymint_package.xml``."""

    def create(
        self, profile: Profile, rules: SubjectRules, existing: Mapping[str, bytes], *, force: bool
    ) -> Mapping[str, bytes]:
        """Return the files to write for a package, by name relative to its folder.

        Files that exist and belong to the user are left out. The document of the rules is returned when it is
        missing or its content differs from what the policy says now.

        Raises:
            KeymintError: the document of the rules was edited by hand, the policy changed as well, and ``force``
                is not given.
        """

    def load(self, profile: Profile, name: str, folder: str, files: Mapping[str, bytes]) -> Package:
        """Load a package from its files; what it leaves out is taken from the profile's defaults.

        Args:
            profile: the profile of the workspace.
            name: package name, from its place under the source space.
            folder: its folder as the user would type it, for messages.
            files: the package's files by name.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


class RulePlaces(Protocol):
    """What a package type may offer beside :class:`PackageType`: where the rules of a package stand in its files."""

    def rule_places(self, name: str, folder: str, files: Mapping[str, bytes]) -> Sequence[Origin]:
        """Return the place in the package's own document of each of its rules, in their order.

        Args:
            name: package name.
            folder: its folder as the user would type it.
            files: the package's files by name.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


# ---------------------------------------------------------------------------------------------------------------
# Policies
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PolicyDecision:
    """What a policy says about an edge.

    Attributes:
        allowed: the decision.
        where: the rule that decided; None when no rule matches, which denies.
        reason: one line.
        audit: the rule that decided is to be watched.
    """

    allowed: bool
    where: Origin | None
    reason: str
    audit: bool = False


@dataclass(frozen=True, slots=True)
class AppliedProfile:
    """A profile of a policy that applies to a subject: its label, its place, and whether it is to be watched."""

    name: str
    where: Origin
    audit: bool = False


class LoadedPolicy(Protocol):
    """A policy, loaded once per command."""

    @property
    def seen(self) -> Mapping[Path, bytes]:
        """Every path that was looked at, also those that were not there, with its fingerprint.

        As long as :meth:`PolicyType.fingerprint` gives the same for all of them, so is the policy.
        """

    def subjects(self) -> tuple[str, ...]:
        """Return, sorted, the subjects that the policy names exactly."""

    def rules(self, subject: str) -> SubjectRules | None:
        """Return the rules of a subject, or None when no profile applies to it."""

    def profiles(self, subject: str) -> Sequence[AppliedProfile]:
        """Return the profiles that apply to a subject, outer ones first."""

    def decide(self, edge: Edge) -> PolicyDecision:
        """Return what the policy says about an edge; its domain is no matter of policy.

        Raises:
            KeymintError: the kind or the permission is not known.
        """


@dataclass(frozen=True, slots=True)
class AttachedProfile:
    """A profile as it is written.

    Attributes:
        name: its label.
        where: where it is written.
        around: expressions of the profiles around it, outermost first: a subject must match one of each.
        attachments: its own expressions, each with its place.
    """

    name: str
    where: Origin
    around: tuple[tuple[str, ...], ...]
    attachments: tuple[tuple[str, Origin], ...]


@dataclass(frozen=True, slots=True)
class Clause:
    """A rule as it is written, before it is expanded for a subject.

    Attributes:
        profiles: expressions of the profiles that it stands in, outermost first: a subject must match one of each.
        rule: the rule; its expressions may hold ``{name}`` and ``{namespace}``.
        expand: returns its expressions for expressions of a namespace (with its last ``/``) and of a name.
    """

    profiles: tuple[tuple[str, ...], ...]
    rule: Rule
    expand: Callable[[str, str], tuple[str, ...]] = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Structure:
    """A policy as it is written.

    Attributes:
        profiles: its profiles, outer ones first.
        clauses: its rules, in the order of the policy.
        unused: name and place of the variables that nothing uses.
    """

    profiles: tuple[AttachedProfile, ...]
    clauses: tuple[Clause, ...]
    unused: tuple[tuple[str, Origin], ...] = ()


class StructuredPolicy(Protocol):
    """What a policy may offer beside :class:`LoadedPolicy`: itself as it is written, for subjects it does not name."""

    def structure(self) -> Structure:
        """Return the policy as it is written."""


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a unit test of a policy expects.

    Attributes:
        test: name of the test.
        allowed: every request that matches is allowed; else none is.
        subject: ``fnmatch`` expression of subjects.
        permission: a permission; ``ros_`` may be missing.
        object: ``fnmatch`` expression of objects.
        partition: DDS partition; empty for the default one.
        where: where it is written.
    """

    test: str
    allowed: bool
    subject: str
    permission: str
    object: str
    partition: str
    where: Origin


class ExpectingPolicyType(Protocol):
    """What a policy type may offer beside :class:`PolicyType`: reading of a policy's own unit tests."""

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the test files beside a policy, by file.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """


class PolicyType(Protocol):
    """Acquires policy: sources to IR."""

    API: str

    def load(self, sources: Sequence[PolicySource], library: Path | None) -> LoadedPolicy:
        """Load policies as one: the union of their profiles.

        Raises:
            KeymintError: with ``file:line`` of each defect.
        """

    def fingerprint(self, path: Path) -> bytes:
        """Return what tells whether a path is still what it was when a policy was loaded from it."""


# ---------------------------------------------------------------------------------------------------------------
# Building
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """Options of a build. ``allow_vendor_specific`` turns portability errors into warnings."""

    allow_vendor_specific: bool = False


@dataclass(frozen=True, slots=True)
class Built:
    """Unsigned documents by file name, and what is to be said of them."""

    documents: Mapping[str, bytes]
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class Signer:
    """An authority that signs: PEM of its certificate, PEM of its private key, and its password.

    None of the secrets is part of the representation.
    """

    name: str
    certificate: bytes
    key: bytes = field(repr=False)
    password: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True, slots=True)
class Credentials:
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
    signer: Signer


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

    def build(self, package: Package, options: BuildOptions) -> Built:
        """Return the unsigned documents of a package; a pure function of its arguments.

        Raises:
            KeymintError: the policy says what the transport cannot express, with the rule's ``file:line``.
        """

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: Credentials,
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


# ---------------------------------------------------------------------------------------------------------------
# Proving
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Obligation:
    """What is to be proven: the documents of an enclave permit exactly what a policy says, over all names.

    Attributes:
        rules: what the policy says of the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the policy holds.
        files: the enclave's files by name, as they are installed.
        folder: the enclave's folder as the user would type it.
        states: how many states a question may visit.
        go_on: asked again and again; a question is given up when it returns False.
    """

    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    files: Mapping[str, bytes] = field(repr=False)
    folder: str
    states: int
    go_on: Callable[[], bool]


class Proof(StrEnum):
    """How a claim stands; one that is unknown is not proven."""

    PROVEN = "proven"
    COUNTEREXAMPLE = "counterexample"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Counterexample:
    """A name about which policy and document differ; none is shorter.

    Attributes:
        endpoint: the edge of kind ``topic``, with its partition if that matters.
        meaning: the edge on a ROS name that needs it, or None.
        policy: what the policy says, and by which rule.
        document: what the document says, and in which of its lines.
    """

    endpoint: Edge
    meaning: Edge | None
    policy: PolicyDecision
    document: Verdict


@dataclass(frozen=True, slots=True)
class Claim:
    """That a document, as a model reads it, permits an action exactly where the policy does.

    Attributes:
        model: whose reading: the standard's, or a vendor's.
        action: ``publish`` or ``subscribe``.
        domains: the DDS domains it is about.
        universe: the names it is about, in words.
        proof: how it stands.
        reason: why it is unknown, in one line.
        counterexample: if there is one.
    """

    model: str
    action: str
    domains: tuple[DomainRange, ...]
    universe: str
    proof: Proof
    reason: str = ""
    counterexample: Counterexample | None = None


class Prover(Protocol):
    """What a build type may offer beside :class:`BuildType`: proofs about what it installs."""

    def assumptions(self) -> Mapping[str, Sequence[str]]:
        """Return what every claim takes for granted, one line each, by model."""

    def prove(self, obligation: Obligation) -> Sequence[Claim]:
        """Return a claim for each model, action and group of domains.

        Raises:
            KeymintError: the enclave has no document that can be read.
        """


# ---------------------------------------------------------------------------------------------------------------
# Transports
# ---------------------------------------------------------------------------------------------------------------


class Tier(StrEnum):
    """How deep a transport is asked.

    ``decision``: its access-control code decides. ``admission``: a participant per enclave, endpoints are created.
    ``exchange``: two processes, data is delivered or not.
    """

    DECISION = "decision"
    ADMISSION = "admission"
    EXCHANGE = "exchange"


@dataclass(frozen=True, slots=True)
class Usable:
    """Whether a transport can be used here: what it is, and how to install what it lacks.

    Attributes:
        usable: it can.
        version: of what it is, or is a model of.
        reason: why it cannot be used, or not wholly.
        help: how to install what is missing.
        tiers: how deep it can be asked.
        by_default: it is asked where none is named; False for one that is known not to follow the policy.
    """

    usable: bool
    version: str = ""
    reason: str = ""
    help: str = ""
    tiers: tuple[Tier, ...] = ()
    by_default: bool = True


@dataclass(frozen=True, slots=True)
class Enclave:
    """An installed enclave.

    Attributes:
        subject: its subject.
        folder: absolute path of its folder.
        distro: ROS 2 distribution whose name mapping applies.
    """

    subject: str
    folder: Path
    distro: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a transport decides about an edge.

    Attributes:
        allowed: the decision.
        reason: one line: the rule of the document (``permissions.xml:12``), or what the transport said.
        line: line of the rule in the signed document that decided, or 0.
        deviation: the row of the table of vendors' deviations that explains a difference from the standard, or empty.
    """

    allowed: bool
    reason: str = ""
    line: int = 0
    deviation: str = ""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a transport needs to know of where it runs, since plugins do not look for themselves.

    Attributes:
        now: the clock, UTC: simulated transports go by it, real ones by the clock of the machine.
        cache: a folder of this user in which real transports keep programs that they built; made when needed.
        environment: environment variables, for the processes that real transports start.
    """

    now: datetime
    cache: Path
    environment: Mapping[str, str] = field(default_factory=dict, repr=False)


class Transport(Protocol):
    """Tells what a transport, simulated or real, decides when it is given installed enclaves."""

    def usable(self) -> Usable:
        """Tell whether it can be used on this machine; never raises."""

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """Yield what is decided about each edge, in the order of the edges.

        Args:
            enclaves: the enclaves of all subjects of the edges.
            edges: edges to decide, grouped by subject; consumed as they come, so that memory stays flat.
            tier: one of those that :meth:`usable` names.

        Raises:
            KeymintError: an enclave is refused as a whole (code ``enclave-refused``), or the transport does not work.
        """


class TransportType(Protocol):
    """What is registered as a transport: opens it, without side effect."""

    API: str

    def open(self, surroundings: Surroundings) -> Transport:
        """Return the transport, which is then asked whether it is usable; never raises."""


# ---------------------------------------------------------------------------------------------------------------
# Graphs from the world, and policies from graphs
# ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Discovered:
    """A graph that was seen, and what is to be said of it (how subjects came by their names, say)."""

    graph: Graph
    diagnostics: tuple[Diagnostic, ...] = ()


class GraphSource(Protocol):
    """Finds semantic access graphs: in a running system, and in captures of one."""

    API: str

    def usable(self) -> Usable:
        """Tell whether a running system can be observed on this machine; never raises."""

    def observe(self, domain: int, go_on: Callable[[], bool], names: Mapping[str, str]) -> Discovered:
        """Return what happens in a domain, in the transport's own terms (objects of kind ``topic``).

        Args:
            domain: DDS domain id.
            go_on: asked again and again; the observation ends when it returns False.
            names: subjects by GUID (hexadecimal, or the beginning of one), where the user knows better.

        Raises:
            KeymintError: what it takes is not installed, or does not work.
        """

    def recognises(self, content: bytes) -> bool:
        """Tell whether a file is a capture that :meth:`read` reads."""

    def read(self, content: bytes, name: str, names: Mapping[str, str]) -> Discovered:
        """Return what a capture holds, in the transport's own terms.

        Args:
            content: the file.
            name: its path as the user would type it, for messages.
            names: as for :meth:`observe`.

        Raises:
            KeymintError: with ``file:line`` of the defect.
        """

    def interpret(self, graph: Graph, *, fold: bool) -> Graph:
        """Return a graph in the application's terms; what is in these already stays, what fits none stays as it is.

        Args:
            graph: objects of any kind.
            fold: put the parts of composite kinds together where all of them are there; else take these apart.
        """


@dataclass(frozen=True, slots=True)
class Learned:
    """A policy that was learned from a graph.

    Attributes:
        document: the policy; empty when there is nothing to say.
        fragments: files that it includes, by name in the folder that was asked for.
        missing: edges of the graph that the document allows (and the existing policy does not).
        conflicts: edges that a rule of the existing policy denies, so that no addition allows them.
        unused: what the existing policy allows and no edge of the graph needs.
    """

    document: bytes
    fragments: Mapping[str, bytes]
    missing: tuple[Edge, ...]
    conflicts: tuple[Diagnostic, ...] = ()
    unused: tuple[Diagnostic, ...] = ()


class PolicyLearner(Protocol):
    """What a policy type may offer beside :class:`PolicyType`: the policy that a graph needs."""

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> Learned:
        """Return the smallest policy that, with the existing one, allows every edge of a graph.

        Args:
            graph: what subjects do.
            existing: a policy of the same type that stays in force.
            fragments: folder beside the policy for the files that it may include; empty for one document.

        Raises:
            KeymintError: the policy format cannot express an edge.
        """
