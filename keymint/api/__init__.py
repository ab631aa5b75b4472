"""The plugin interface: protocols that plugins implement, and the data types that they exchange with Keymint.

A plugin is an object with an attribute ``API = "1.0"`` that is registered under one of the entry-point groups
below. Plugins are pure: their methods take and return bytes and data types. They never write files and never read the
clock or the environment. They read only files that a method's arguments name.

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

from comarmor.rules import Expectation
from keymint.api.building import (
    Artifact,
    BuildOptions,
    BuildResult,
    BuildType,
    EnclaveCredentials,
    Hint,
    Inspection,
    NameMapping,
    SigningAuthority,
)
from keymint.api.certificates import Authority, CertificateSpec, Extension, KeySpec, Validity
from keymint.api.graphs import DiscoveredGraph, GraphSource, LearnedPolicy, PolicyLearner
from keymint.api.packages import DomainRange, DomainRule, Governance, Package, Permissions, TopicProtection
from keymint.api.policies import (
    AppliedProfile,
    LoadedPolicy,
    PolicyDecision,
    PolicyStructure,
    PolicyType,
    PolicyTypeWithTests,
    StructuredPolicy,
    WrittenProfile,
    WrittenRule,
)
from keymint.api.profiles import (
    Bootstrap,
    PackageType,
    PolicySource,
    ProfileSettings,
    ProfileType,
    RuleLocator,
    WorkspaceProfile,
)
from keymint.api.proving import (
    Claim,
    Counterexample,
    Proof,
    ProofTask,
    Prover,
    TrustAnchor,
    TrustAnchors,
    ValidityTerm,
)
from keymint.api.transports import Availability, Enclave, Environment, Tier, Transport, TransportType, Verdict

API_VERSION = "1.0"

__all__ = [
    "API_VERSION",
    "AppliedProfile",
    "Artifact",
    "Authority",
    "Availability",
    "Bootstrap",
    "BuildOptions",
    "BuildResult",
    "BuildType",
    "CertificateSpec",
    "Claim",
    "Counterexample",
    "DiscoveredGraph",
    "DomainRange",
    "DomainRule",
    "Enclave",
    "EnclaveCredentials",
    "Environment",
    "Expectation",
    "Extension",
    "Governance",
    "GraphSource",
    "Hint",
    "Inspection",
    "KeySpec",
    "LearnedPolicy",
    "LoadedPolicy",
    "NameMapping",
    "Package",
    "PackageType",
    "Permissions",
    "PolicyDecision",
    "PolicyLearner",
    "PolicySource",
    "PolicyStructure",
    "PolicyType",
    "PolicyTypeWithTests",
    "ProfileSettings",
    "ProfileType",
    "Proof",
    "ProofTask",
    "Prover",
    "RuleLocator",
    "SigningAuthority",
    "StructuredPolicy",
    "Tier",
    "TopicProtection",
    "Transport",
    "TransportType",
    "TrustAnchor",
    "TrustAnchors",
    "Validity",
    "ValidityTerm",
    "Verdict",
    "WorkspaceProfile",
    "WrittenProfile",
    "WrittenRule",
]
