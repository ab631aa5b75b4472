# SPDX-License-Identifier: Apache-2.0
"""The build stage: turns a package into unsigned documents."""

from __future__ import annotations

from collections.abc import Iterator

from keymint.api import BuildOptions, BuildResult, Package, lazy
from keymint.errors import Defects, Diagnostic, KeymintError, Severity
from keymint.pki import distinguished_names
from keymint_ros2_dds import governance_warnings, vendor_limits
from keymint_ros2_dds.documents import governance_document
from keymint_ros2_dds.domains import in_words, uncovered_domains
from keymint_ros2_dds.emit.kind_members import emit_by_kind
from keymint_ros2_dds.enclave_layout import GOVERNANCE, GOVERNANCE_XML, PERMISSIONS, PERMISSIONS_XML
from keymint_ros2_dds.proving import enclave_governance
from keymint_ros2_dds.settings import settings_of, validity_of

# Only packages that were adopted keep documents.
_kept_permissions = lazy("keymint_ros2_dds.keystores.foreign_documents:kept_permissions")
_kept_governance = lazy("keymint_ros2_dds.keystores.foreign_documents:kept_governance")


def build(package: Package, options: BuildOptions) -> BuildResult:
    """Return the unsigned permissions and governance documents of a package; a pure function of its arguments.

    Raises:
        KeymintError: the package is invalid or cannot be expressed portably; every defect with its ``file:line``.
    """
    lenient = options.allow_vendor_specific
    checks = [*_check(package), *vendor_limits.check_key(package, allow_vendor_specific=lenient)]
    checks += vendor_limits.check_token_key(package, allow_vendor_specific=lenient)
    checks += vendor_limits.check_root_name(package, allow_vendor_specific=lenient)
    checks += vendor_limits.check_issuers(package)
    defects, notes = Defects(), list[Diagnostic]()
    emitted, governance = None, b""
    with defects:
        emitted = (_kept_permissions(package) if package.kept else None) or emit_by_kind(package, options)
        notes += emitted.diagnostics
    with defects:
        governance, remarks = governance_document.build(package, allow_vendor_specific=lenient)
        governance = _kept_governance(package, governance) if package.kept else governance
        notes += (*remarks, *governance_warnings.findings(package, emitted.lowered if emitted else None))
    defects.found += [item for item in checks if item.severity is Severity.ERROR]
    if defects.found or emitted is None:
        raise KeymintError.of(defects.found)
    notes += checks
    size = vendor_limits.signed_size(emitted.document)
    notes += vendor_limits.check_size(size, PERMISSIONS, package, emitted.lowered)
    notes += vendor_limits.check_size(vendor_limits.signed_size(governance), GOVERNANCE, package)
    documents = {PERMISSIONS_XML: emitted.document, GOVERNANCE_XML: governance}
    # Claims hold for all if the governance leaves it to the permissions alone, and is no other than what was proven.
    is_alike = emitted.alike and not package.kept and enclave_governance.transparent(governance, package.grant.domains)
    alike = emitted.alike if is_alike else None
    return BuildResult(documents, tuple(notes), {PERMISSIONS_XML: emitted.plain_size}, alike)


def _check(package: Package) -> Iterator[Diagnostic]:
    """Yield the contradictions in a package."""
    granted = package.grant
    governance = settings_of(package)
    validity = validity_of(granted)
    identity = package.identity
    names = {granted.subject_name: granted.origin, identity.subject_name: identity.origin}
    parsed = (distinguished_names.parse(*each) for each in names.items())
    if len(names) > 1 and len(set(map(distinguished_names.to_text, parsed))) > 1:
        message = f"the permissions are for {granted.subject_name!r}, but the identity is {identity.subject_name!r}"
        help_ = "give both the same subject_name"
        yield Diagnostic.error("subject-mismatch", message, granted.origin, help_, package.subject)
    if validity.not_after <= validity.not_before:
        message, help_ = "the permissions end before they begin", "set not_after to a date after not_before"
        yield Diagnostic.error("validity-empty", message, granted.origin, help_, package.subject)
    where = granted.domains_origin or granted.origin
    for item in uncovered_domains(granted.domains, (each for rule in governance.domain_rules for each in rule.domains)):
        message = f"the permissions are for {in_words([item])}, which the governance does not cover"
        help_ = "add the domain to a domain rule of the governance, or remove it from these domains"
        yield Diagnostic.error("domain-uncovered", message, where, help_, package.subject)
