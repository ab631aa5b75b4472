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
from typing import TYPE_CHECKING, Any

from comarmor.rules import Expectation as Expectation
from keymint.api.build_types import BuildType as BuildType, NameMapping as NameMapping, Presentation as Presentation
from keymint.api.building import (
    Artifact as Artifact,
    AuthorityRole as AuthorityRole,
    BuildOptions as BuildOptions,
    BuildResult as BuildResult,
    Credentials as Credentials,
    EnvironmentVariable as EnvironmentVariable,
    Hint as Hint,
    Implementation as Implementation,
    Inspection as Inspection,
    Layout as Layout,
    SigningAuthority as SigningAuthority,
)
from keymint.api.package_types import PackageType as PackageType
from keymint.api.packages import (
    Authority as Authority,
    AuthorityIssuance as AuthorityIssuance,
    CertificateSpec as CertificateSpec,
    DomainRange as DomainRange,
    Extension as Extension,
    Grant as Grant,
    Issuance as Issuance,
    KeySpec as KeySpec,
    Package as Package,
    PackageSettings as PackageSettings,
    PackageSources as PackageSources,
    Phase as Phase,
    Role as Role,
    Rollover as Rollover,
    SourcePart as SourcePart,
    Validity as Validity,
)
from keymint.api.policies import (
    AppliedProfile as AppliedProfile,
    LoadedPolicy as LoadedPolicy,
    PolicyDecision as PolicyDecision,
    PolicySource as PolicySource,
    PolicyStructure as PolicyStructure,
    PolicyType as PolicyType,
    WrittenProfile as WrittenProfile,
    WrittenRule as WrittenRule,
)
from keymint.api.profiles import (
    AcceptedPackage as AcceptedPackage,
    Bootstrap as Bootstrap,
    ProfileType as ProfileType,
    WorkspaceProfile as WorkspaceProfile,
)
from keymint.api.proving import (
    Claim as Claim,
    ComparisonTask as ComparisonTask,
    Counterexample as Counterexample,
    EnclaveFiles as EnclaveFiles,
    InstalledRights as InstalledRights,
    Proof as Proof,
    ProofTask as ProofTask,
    Prover as Prover,
    SharedProofTask as SharedProofTask,
    TrustAnchor as TrustAnchor,
    TrustAnchors as TrustAnchors,
    ValidityTerm as ValidityTerm,
)

if TYPE_CHECKING:
    from keymint.api.exchange import (
        ExportedPolicy as ExportedPolicy,
        ImportedPolicy as ImportedPolicy,
        ImportedSubject as ImportedSubject,
        ImportRequest as ImportRequest,
        LearnedPolicy as LearnedPolicy,
        PolicyFormat as PolicyFormat,
    )
    from keymint.api.foreign_keystores import (
        AdoptedSources as AdoptedSources,
        FoundAuthority as FoundAuthority,
        FoundEnclave as FoundEnclave,
        FoundGrant as FoundGrant,
        FoundKeystore as FoundKeystore,
        GrantedRules as GrantedRules,
        KeystoreFile as KeystoreFile,
        KeystoreFiles as KeystoreFiles,
        KeystoreReader as KeystoreReader,
    )
    from keymint.api.graph import Edge as Edge, Graph as Graph, Object as Object
    from keymint.api.rights import (
        Comparison as Comparison,
        DocumentComparison as DocumentComparison,
        ExcessRights as ExcessRights,
        Holder as Holder,
        PresentableDocument as PresentableDocument,
        PresentationTask as PresentationTask,
        Relation as Relation,
        standard_claims as standard_claims,
    )
    from keymint.api.transports import (
        Availability as Availability,
        DiscoveredGraph as DiscoveredGraph,
        Endpoint as Endpoint,
        Environment as Environment,
        GraphSource as GraphSource,
        InstalledEnclave as InstalledEnclave,
        Tier as Tier,
        Transport as Transport,
        TransportType as TransportType,
        Verdict as Verdict,
    )

API_VERSION = "3.0"
"""Version of the plugin interface; docs/migrating-plugins.md says what changed from one major version to the next."""
_LATER = {
    "exchange": "ExportedPolicy ImportRequest ImportedPolicy ImportedSubject LearnedPolicy PolicyFormat",
    "foreign_keystores": "AdoptedSources FoundAuthority FoundEnclave FoundGrant FoundKeystore GrantedRules KeystoreFile"
    " KeystoreFiles KeystoreReader",
    "graph": "Edge Graph Object",
    "rights": "Comparison DocumentComparison ExcessRights Holder PresentableDocument PresentationTask Relation"
    " standard_claims",
    "transports": "Availability DiscoveredGraph Endpoint Environment GraphSource InstalledEnclave Tier Transport"
    " TransportType Verdict",
}
"""What loads at first use, by module: most runs ask for no single edge, nor other tools, keystores or transports."""
_MODULE_OF = {name: f"keymint.api.{module}" for module, names in _LATER.items() for name in names.split()}
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


if not TYPE_CHECKING:  # a name that does not exist is an error of types

    def __getattr__(name: str) -> Any:
        """Load a name from the module that defines it (PEP 562)."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(_module(_MODULE_OF[name]), name)

    def __dir__() -> list[str]:
        return [*globals(), *_MODULE_OF]
