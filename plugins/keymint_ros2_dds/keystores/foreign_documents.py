# SPDX-License-Identifier: Apache-2.0
"""Documents that another tool signed: compared with a policy, kept, or made a source.

A document is kept as it is, to the last byte, for as long as it means what the sources say
(:attr:`keymint.api.Package.kept`): the same name, period and domains, and proven to permit the same for all names as
the standard reads it. Then nobody has to deploy anything.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache

from lxml import etree

from comarmor.values import replace
from keymint.api import BuildOptions, Comparison, ComparisonTask, DocumentComparison, ImportedSubject, Package, Relation
from keymint.errors import Diagnostic, KeymintError
from keymint.pki import distinguished_names
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.compiling.grant_compiler import compile_rules
from keymint_ros2_dds.decision.semantics import OMG, STANDARD
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.emit.emission import Emitted, comparison
from keymint_ros2_dds.enclave_layout import GOVERNANCE_XML, PERMISSIONS_P7S, PERMISSIONS_XML
from keymint_ros2_dds.proving.claims import prove_content
from keymint_ros2_dds.proving.document_relation import compare_document
from keymint_ros2_dds.reading import signed_governance, signed_permissions
from keymint_ros2_dds.reading.signed_governance import ACCESS, JOIN, UNAUTHENTICATED, DocumentDomainRule
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, as_ranges
from keymint_ros2_dds.settings import STRICT_TOPIC, package_of, validity_of
from keymint_ros2_dds.subject_names import subject_name_of

_HEAD = (
    b'<?xml version="1.0" encoding="UTF-8"?>\n'
    b"<!-- Defaults of each domain rule of a package's governance.xml, as they were found in the keystore that was\n"
    b"     taken over. All participants of a domain need the same values. -->\n"
)


def compare(subject: ImportedSubject, distro: str, states: int, go_on: Callable[[], bool]) -> Comparison:
    """Return what is proven about both documents; see :meth:`keymint.api.KeystoreReader.compare`.

    Raises:
        KeymintError: the document cannot be read, or a rule cannot be mapped.
    """
    package = package_of(subject.rules, distro)
    grant = package.grant
    compiled = compile_rules(grant, distro, BuildOptions(allow_vendor_specific=True))
    ours = permissions_document.render(grant, compiled.plain)

    def task(document: bytes, name: str) -> ComparisonTask:
        file = f"{subject.rules.subject}/{PERMISSIONS_XML}".lstrip("/")
        return ComparisonTask(document, file, 0, name, subject.rules, distro, grant.domains, states, go_on)

    return Comparison(
        prove_content(task(subject.document, subject.subject_name), lowered=compiled.lowered),
        prove_content(task(ours, grant.subject_name), models=(OMG.name,), lowered=compiled.lowered),
        compiled.diagnostics,
    )


def compared_with(content: bytes, name: str, package: Package) -> DocumentComparison:
    """Compare a document with the rules of a package; see :meth:`keymint.api.Presentation.compared_with`.

    Raises:
        KeymintError: a rule cannot be mapped.
    """
    own = subject_names.of_any(distinguished_names.parse(name))
    return compare_document(replace(comparison(package, content), file=PERMISSIONS_P7S, subject_name=own))


# -- kept as they are ------------------------------------------------------------------------------------------------


def kept_permissions(package: Package) -> Emitted | None:
    """Return the permissions document that another tool signed, if it is kept.

    Raises:
        KeymintError: the rules of the package cannot be compiled.
    """
    document = package.kept.get(PERMISSIONS_XML)
    if document is None or not_kept(package, PERMISSIONS_XML, document):
        return None
    compiled = compile_rules(package.grant, package.distro, BuildOptions(allow_vendor_specific=True))
    message = "goes on with signed permissions that vendors of DDS may read differently from the standard"
    help_ = "'keymint prove' says what they do; '--allow-vendor-specific' accepts it"
    note = Diagnostic.warning("kept-vendors", message, package.grant.origin, help_, package.subject)
    return Emitted(document, (), len(document), compiled, (), () if compiled.portable else (note,))


def kept_governance(package: Package, built: bytes) -> bytes:
    """Return the governance document that another tool signed, if it has the rules of the one that was built."""
    kept = package.kept.get(GOVERNANCE_XML)
    with suppress(KeymintError):
        return kept if kept is not None and is_same(kept, built) else built
    return built


def not_kept(package: Package, name: str, document: bytes) -> str:
    """Return why a document is not kept: see :meth:`keymint.api.KeystoreReader.not_kept`."""
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


# -- governance as a source ------------------------------------------------------------------------------------------


def governance_source(document: bytes, signer: str) -> bytes | None:
    """Return the source of a governance document; None if it has several domain rules, which defaults cannot have.

    Args:
        document: the signed document.
        signer: name of the authority that signs it.
    """
    rules = signed_governance.read(document).domain_rules
    if len(rules) != 1:
        return None
    rule = rules[0]
    root = etree.Element("defaults")
    dds_xml.child(root, "issuer_name", signer)
    dds_xml.domains(root, as_ranges(rule.domains))
    dds_xml.settings(root, {UNAUTHENTICATED: rule.unauthenticated, JOIN: rule.join_controlled})
    dds_xml.settings(root, dict(zip(signed_governance.DOMAIN_PROTECTIONS, rule.protections, strict=True)))
    topics = dds_xml.child(root, "topic_access_rules")
    for topic in rule.topic_rules:
        own: dict[str, str | bool] = {tag: topic.controls(action) for action, tag in ACCESS.items()}
        own |= zip(signed_governance.TOPIC_PROTECTIONS, topic.protections, strict=True)
        dds_xml.topic_rule(topics, topic.expression, {name: own[name] for name in STRICT_TOPIC})
    etree.indent(root)
    return _HEAD + etree.tostring(root, encoding="unicode").encode() + b"\n"


@lru_cache(maxsize=64)
def is_same(one: bytes, other: bytes) -> bool:
    """Tell whether two governance documents have the same rules in the same order, however they are written."""
    first, second = ([_meaning(rule) for rule in signed_governance.read(each).domain_rules] for each in (one, other))
    return first == second


def _meaning(rule: DocumentDomainRule) -> tuple[object, ...]:
    topics = [
        (each.expression.strip(), each.read_controlled, each.write_controlled, *map(_value, each.protections))
        for each in rule.topic_rules
    ]
    return (rule.domains, rule.join_controlled, rule.unauthenticated, rule.protections, tuple(topics))


def _value(text: str) -> str:
    """Return a boolean of XML Schema in one form, and other text as it is."""
    return {"1": "true", "0": "false"}.get(text, text)
