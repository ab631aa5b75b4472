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

from comarmor.rules import Expectation
from keymint.api.building import (
    Artifact,
    BuildOptions,
    BuildType,
    Built,
    Credentials,
    Demand,
    Inspection,
    NameMapping,
    Signer,
)
from keymint.api.certificates import Authority, CertificateSpec, Extension, KeySpec, Validity
from keymint.api.graphs import Discovered, GraphSource, Learned, PolicyLearner
from keymint.api.packages import DomainRange, DomainRule, Governance, Package, Permissions, TopicProtection
from keymint.api.policies import (
    AppliedProfile,
    AttachedProfile,
    Clause,
    ExpectingPolicyType,
    LoadedPolicy,
    PolicyDecision,
    PolicyType,
    Structure,
    StructuredPolicy,
)
from keymint.api.profiles import (
    Bootstrap,
    PackageType,
    PolicySource,
    Profile,
    ProfileSettings,
    ProfileType,
    RulePlaces,
)
from keymint.api.proving import Anchor, Anchors, Claim, Counterexample, Obligation, Proof, Prover, Term
from keymint.api.transports import Enclave, Surroundings, Tier, Transport, TransportType, Usable, Verdict

API_VERSION = "1.0"

__all__ = [
    "API_VERSION",
    "Anchor",
    "Anchors",
    "AppliedProfile",
    "Artifact",
    "AttachedProfile",
    "Authority",
    "Bootstrap",
    "BuildOptions",
    "BuildType",
    "Built",
    "CertificateSpec",
    "Claim",
    "Clause",
    "Counterexample",
    "Credentials",
    "Demand",
    "Discovered",
    "DomainRange",
    "DomainRule",
    "Enclave",
    "Expectation",
    "ExpectingPolicyType",
    "Extension",
    "Governance",
    "GraphSource",
    "Inspection",
    "KeySpec",
    "Learned",
    "LoadedPolicy",
    "NameMapping",
    "Obligation",
    "Package",
    "PackageType",
    "Permissions",
    "PolicyDecision",
    "PolicyLearner",
    "PolicySource",
    "PolicyType",
    "Profile",
    "ProfileSettings",
    "ProfileType",
    "Proof",
    "Prover",
    "RulePlaces",
    "Signer",
    "Structure",
    "StructuredPolicy",
    "Surroundings",
    "Term",
    "Tier",
    "TopicProtection",
    "Transport",
    "TransportType",
    "Usable",
    "Validity",
    "Verdict",
]
