# SPDX-License-Identifier: Apache-2.0
"""The plugin interface: base classes of plugins, and the data types that they exchange with Keymint.

A plugin is an object of a class below, with an attribute ``API = "3.0"``, that is registered under an entry-point
group. What it need not do has a default. Plugins are pure: their methods take and return bytes and data types. They
never write files and never read the clock or the environment. They read only files that a method's arguments name.

===========================  ======================================================
group                        class
===========================  ======================================================
``keymint.profile_types``    :class:`ProfileType`
``keymint.package_types``    :class:`PackageType`
``keymint.policy_types``     :class:`PolicyType`
``keymint.build_types``      :class:`BuildType`
``keymint.transports``       :class:`TransportType`
``keymint.graph_sources``    :class:`GraphSource`
``keymint.policy_formats``   :class:`PolicyFormat`
===========================  ======================================================
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from comarmor.rules import Expectation as Expectation
from keymint.api.build_types import BuildType as BuildType
from keymint.api.build_types import NameMapping as NameMapping
from keymint.api.building import Artifact as Artifact
from keymint.api.building import AuthorityRole as AuthorityRole
from keymint.api.building import BuildOptions as BuildOptions
from keymint.api.building import BuildResult as BuildResult
from keymint.api.building import Credentials as Credentials
from keymint.api.building import EnvironmentVariable as EnvironmentVariable
from keymint.api.building import Hint as Hint
from keymint.api.building import Implementation as Implementation
from keymint.api.building import Inspection as Inspection
from keymint.api.building import Layout as Layout
from keymint.api.building import SigningAuthority as SigningAuthority
from keymint.api.foreign_keystores import AdoptedSources as AdoptedSources
from keymint.api.foreign_keystores import FoundAuthority as FoundAuthority
from keymint.api.foreign_keystores import FoundEnclave as FoundEnclave
from keymint.api.foreign_keystores import FoundGrant as FoundGrant
from keymint.api.foreign_keystores import FoundKeystore as FoundKeystore
from keymint.api.foreign_keystores import GrantedRules as GrantedRules
from keymint.api.foreign_keystores import KeystoreFile as KeystoreFile
from keymint.api.foreign_keystores import KeystoreFiles as KeystoreFiles
from keymint.api.foreign_keystores import KeystoreReader as KeystoreReader
from keymint.api.package_types import PackageType as PackageType
from keymint.api.packages import Authority as Authority
from keymint.api.packages import AuthorityIssuance as AuthorityIssuance
from keymint.api.packages import CertificateSpec as CertificateSpec
from keymint.api.packages import DomainRange as DomainRange
from keymint.api.packages import Extension as Extension
from keymint.api.packages import Grant as Grant
from keymint.api.packages import Issuance as Issuance
from keymint.api.packages import KeySpec as KeySpec
from keymint.api.packages import Package as Package
from keymint.api.packages import PackageSettings as PackageSettings
from keymint.api.packages import PackageSources as PackageSources
from keymint.api.packages import Phase as Phase
from keymint.api.packages import Role as Role
from keymint.api.packages import Rollover as Rollover
from keymint.api.packages import SourcePart as SourcePart
from keymint.api.packages import Validity as Validity
from keymint.api.policies import AppliedProfile as AppliedProfile
from keymint.api.policies import ExportedPolicy as ExportedPolicy
from keymint.api.policies import ImportedPolicy as ImportedPolicy
from keymint.api.policies import ImportedSubject as ImportedSubject
from keymint.api.policies import ImportRequest as ImportRequest
from keymint.api.policies import LearnedPolicy as LearnedPolicy
from keymint.api.policies import LoadedPolicy as LoadedPolicy
from keymint.api.policies import PolicyDecision as PolicyDecision
from keymint.api.policies import PolicyFormat as PolicyFormat
from keymint.api.policies import PolicySource as PolicySource
from keymint.api.policies import PolicyStructure as PolicyStructure
from keymint.api.policies import PolicyType as PolicyType
from keymint.api.policies import WrittenProfile as WrittenProfile
from keymint.api.policies import WrittenRule as WrittenRule
from keymint.api.profiles import AcceptedPackage as AcceptedPackage
from keymint.api.profiles import Bootstrap as Bootstrap
from keymint.api.profiles import ProfileType as ProfileType
from keymint.api.profiles import WorkspaceProfile as WorkspaceProfile
from keymint.api.proving import Claim as Claim
from keymint.api.proving import Counterexample as Counterexample
from keymint.api.proving import EnclaveFiles as EnclaveFiles
from keymint.api.proving import InstalledRights as InstalledRights
from keymint.api.proving import Proof as Proof
from keymint.api.proving import ProofTask as ProofTask
from keymint.api.proving import Prover as Prover
from keymint.api.proving import SharedProofTask as SharedProofTask
from keymint.api.proving import TrustAnchor as TrustAnchor
from keymint.api.proving import TrustAnchors as TrustAnchors
from keymint.api.proving import ValidityTerm as ValidityTerm
from keymint.api.rights import Comparison as Comparison
from keymint.api.rights import ComparisonTask as ComparisonTask
from keymint.api.rights import DocumentComparison as DocumentComparison
from keymint.api.rights import ExcessRights as ExcessRights
from keymint.api.rights import Holder as Holder
from keymint.api.rights import PresentableDocument as PresentableDocument
from keymint.api.rights import Presentation as Presentation
from keymint.api.rights import PresentationTask as PresentationTask
from keymint.api.rights import Relation as Relation
from keymint.api.rights import standard_claims as standard_claims
from keymint.api.transports import Availability as Availability
from keymint.api.transports import DiscoveredGraph as DiscoveredGraph
from keymint.api.transports import Endpoint as Endpoint
from keymint.api.transports import Environment as Environment
from keymint.api.transports import GraphSource as GraphSource
from keymint.api.transports import InstalledEnclave as InstalledEnclave
from keymint.api.transports import Tier as Tier
from keymint.api.transports import Transport as Transport
from keymint.api.transports import TransportType as TransportType
from keymint.api.transports import Verdict as Verdict

API_VERSION = "3.0"
"""Version of the plugin interface; docs/migrating-plugins.md says what changed from one major version to the next."""
_module = cache(import_module)


def lazy(target: str) -> Any:
    """Return a static method that calls a function, so that listing plugins loads neither XML nor cryptography.

    Args:
        target: ``module:function``; the module is imported at the first call.
    """
    module, _, name = target.partition(":")

    def call(*arguments: Any, **options: Any) -> Any:
        return getattr(_module(module), name)(*arguments, **options)

    return staticmethod(call)
