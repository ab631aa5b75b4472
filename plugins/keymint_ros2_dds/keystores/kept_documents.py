# SPDX-License-Identifier: Apache-2.0
"""Go on with the documents that another tool signed (:attr:`keymint.api.Package.kept`).

A document is kept as it is, to the last byte, for as long as it means what the sources say: the same name, period and
domains, and proven to permit the same for all names as the standard reads it. Then nobody has to deploy anything.
"""

from __future__ import annotations

from functools import lru_cache

from comarmor.errors import Diagnostic
from keymint.api import BuildOptions, Package, Relation
from keymint.errors import KeymintError
from keymint_ros2_dds.compiling.grant_compiler import compile_rules
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.emit.emission import Emitted, comparison
from keymint_ros2_dds.enclave_layout import GOVERNANCE_XML, PERMISSIONS_XML
from keymint_ros2_dds.keystores.governance_as_source import is_same
from keymint_ros2_dds.proving.document_relation import compare_document
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant
from keymint_ros2_dds.settings import validity_of
from keymint_ros2_dds.subject_name_text import subject_name_of


def kept_permissions(package: Package) -> Emitted | None:
    """Return the permissions document that another tool signed, if it is kept.

    Raises:
        KeymintError: the rules of the package cannot be compiled.
    """
    document = package.kept.get(PERMISSIONS_XML)
    if document is None or not_kept(package, PERMISSIONS_XML, document):
        return None
    compiled = compile_rules(package.grant, package.distro, BuildOptions(allow_vendor_specific=True))
    notes = () if compiled.portable else (_vendors(package),)
    return Emitted(document, (), len(document), compiled, (), notes)


def governance(package: Package, built: bytes) -> bytes:
    """Return the governance document that another tool signed, if it has the rules of the one that was built."""
    kept = package.kept.get(GOVERNANCE_XML)
    return kept if kept is not None and _has_same_rules(kept, built) else built


def not_kept(package: Package, name: str, document: bytes) -> str:
    """Return why a document is not kept: see :meth:`keymint.api.KeptDocuments.not_kept`."""
    if name != PERMISSIONS_XML:
        return ""
    try:
        grants = signed_permissions.read(document, PERMISSIONS_XML).grants
    except KeymintError as error:
        return str(error)
    if len(grants) != 1:
        return f"it has {len(grants)} grants"
    return _other_header(package, grants[0]) or _difference(package, document)


def _other_header(package: Package, grant: DocumentGrant) -> str:
    """Return how the name, the period or the default of a grant differ from the sources; empty if they do not."""
    subject, period = subject_name_of(package.grant), validity_of(package.grant)
    if grant.subject_name != subject:
        return f"it is for {grant.subject_name!r}, and the sources are for {subject!r}"
    if STANDARD.period(grant) != (period.not_before, period.not_after):
        wanted = " to ".join(map(dds_xml.date, (period.not_before, period.not_after)))
        return f"it is valid from {grant.not_before} to {grant.not_after}, and the sources say {wanted}"
    return "it allows by default" if grant.allows else ""


def _difference(package: Package, document: bytes) -> str:
    """Return how the rights of a document differ from those of the sources; empty if they do not."""
    found = compare_document(comparison(package, document))
    if found.relation is Relation.EQUAL:
        return ""
    example = found.missing or found.excess
    if example is None:
        return f"it is not known whether it permits what the policy allows: {found.reason}"
    verb = "permits" if example.document.allowed else "does not permit"
    return f"it {verb} its subject to {example.endpoint.action} {example.endpoint.name!r}, other than the policy"


def _vendors(package: Package) -> Diagnostic:
    return Diagnostic.warning(
        "kept-vendors",
        "goes on with signed permissions that vendors of DDS may read differently from the standard",
        package.grant.origin,
        "'keymint prove' says what they do; '--allow-vendor-specific' accepts it",
        package.subject,
    )


@lru_cache(maxsize=64)
def _has_same_rules(kept: bytes, built: bytes) -> bool:
    try:
        return is_same(kept, built)
    except KeymintError:
        return False
