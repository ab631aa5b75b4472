# SPDX-License-Identifier: Apache-2.0
"""Emits the permissions document: the smallest form that is proven to mean what the policy's rules mean.

Every compiled form is rendered and compared with the rules over all names, so rewriting may be bold. If a form is
refuted or not decided, the plain form is emitted.
"""

from __future__ import annotations

from comarmor.patterns.steps import step_limit
from comarmor.values import Data
from keymint.api import BuildOptions, Claim, ComparisonTask, Grant, Package, Proof
from keymint.errors import Diagnostic, KeymintError
from keymint_ros2_dds.compiling.grant_compiler import Compiled, compile_rules, vendor_notes
from keymint_ros2_dds.decision.semantics import OMG, VARIATIONS, shipped_models
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.enclave_layout import PERMISSIONS, PERMISSIONS_XML
from keymint_ros2_dds.lowering.lowered_rules import GrantRule, Lowered
from keymint_ros2_dds.proving.claims import prove_content
from keymint_ros2_dds.subject_names import subject_name_of

STATES = 50_000
"""States that a proof may visit, so that a build always ends."""
STEPS = 8_000_000
"""Steps that all proofs about the forms of a document may take together (:mod:`comarmor.patterns.steps`)."""


class Emitted(Data):
    """A permissions document.

    Attributes:
        document: the unsigned document.
        rules: the rules that it is written from.
        plain_size: bytes of its plain form.
        compiled: the forms of the rules; None if another subject's were renamed (:mod:`keymint_ros2_dds.emit`).
        claims: what is proven about it, or not.
        diagnostics: warnings and notes.
        alike: what it has in common with the other documents that were renamed from the same one; else None.
    """

    document: bytes
    rules: tuple[GrantRule[str], ...]
    plain_size: int
    compiled: Compiled | None
    claims: tuple[Claim, ...]
    diagnostics: tuple[Diagnostic, ...]
    alike: object | None = None

    def is_usual(self, grant: Grant) -> bool:
        """Tell whether the document is proven, and nothing is reported but notes on what vendors do."""
        proven = all(claim.proof is Proof.PROVEN for claim in self.claims)
        return proven and self.diagnostics == tuple(vendor_notes(self.rules, grant))

    @property
    def lowered(self) -> Lowered | None:
        """The rules of the policy as DDS patterns, if they are known."""
        return None if self.compiled is None else self.compiled.lowered


def emit(package: Package, options: BuildOptions) -> Emitted:
    """Return the permissions document of a package; a pure function of its arguments.

    Raises:
        KeymintError: the rules cannot be expressed portably, or are invalid, with ``file:line``; or no form of the
            document means what the rules mean.
    """
    compiled = compile_rules(package.grant, package.distro, options)
    refusing = _refusing(package)
    if refusing and not options.allow_vendor_specific:
        name = subject_name_of(package.grant)
        message = f"{refusing} finds no permissions of {name!r}: an attribute is there twice"
        help_ = "write each attribute once, e.g. one CN and one OU, or build with --allow-vendor-specific"
        raise KeymintError(message, where=package.grant.origin, help=help_, code="portability-subject-name")
    # By the standard only, if the user accepted that vendors differ.
    models = None if compiled.portable and not refusing else (OMG.name,)
    with step_limit(STEPS):
        return _smallest_proven(package, options, compiled, models)


def _refusing(package: Package) -> str:
    """Return the models of what the distribution ships that find no permissions of this very name."""
    try:
        name = subject_name_of(package.grant)
    except KeymintError:
        return ""  # reported where the document is written
    names = {model: VARIATIONS[model].semantics for model in shipped_models(package.distro)}
    return ", ".join(model for model, each in names.items() if not each.selects(each.reads_text(name), name))


def _smallest_proven(
    package: Package, options: BuildOptions, compiled: Compiled, models: tuple[str, ...] | None
) -> Emitted:
    """Return the document in its first form that is proven, else in its plain form.

    Raises:
        KeymintError: the plain form is refuted although all vendors should read it in the same way.
    """
    diagnostics: list[Diagnostic] = []
    smaller = [form for form in compiled.forms if form != compiled.plain] if options.optimise else []
    for rules in (*smaller, compiled.plain):
        document = permissions_document.render(package.grant, rules)
        claims = prove_content(comparison(package, document), models=models, lowered=compiled.lowered)
        open_claims = [claim for claim in claims if claim.proof is not Proof.PROVEN]
        if not open_claims or rules is compiled.plain:
            break
        help_ = "the plain form is written; '--no-optimise' writes it without this warning"
        what = "the smaller form of the permissions is"
        diagnostics.append(_unproven(package, "rewriting-unproven", what, open_claims[0], help_))
    diagnostics += compiled.diagnostics
    for claim in open_claims[:1]:
        help_ = "'keymint prove' may decide it with more time"
        finding = _unproven(package, "compile-unproven", "the permissions are", claim, help_)
        if compiled.portable and claim.proof is Proof.COUNTEREXAMPLE:
            help_ = "this is a defect of Keymint: simplify the rules, and report it"
            raise KeymintError(finding.message, where=package.grant.origin, help=help_, code="compile-refuted")
        diagnostics.append(finding)
    diagnostics += vendor_notes(rules, package.grant)
    dds_xml.require_valid(document, PERMISSIONS, PERMISSIONS_XML)
    plain = document if rules == compiled.plain else permissions_document.render(package.grant, compiled.plain)
    return Emitted(document, rules, len(plain), compiled, claims, tuple(diagnostics))


def comparison(package: Package, document: bytes) -> ComparisonTask:
    """Return the comparison of a permissions document with what that of a package must permit."""
    grant, name = package.grant, subject_name_of(package.grant)
    return ComparisonTask(
        document, PERMISSIONS_XML, 0, name, grant.rules, package.distro, grant.domains, STATES, lambda: True
    )


def _unproven(package: Package, code: str, what: str, claim: Claim, help_: str) -> Diagnostic:
    reason = f"{claim.model}, {claim.action}: {claim.reason}"
    if example := claim.counterexample:
        verb = "permits" if example.document.allowed else "does not permit"
        reason = f"{claim.model} {verb} it to {claim.action} {example.endpoint.name!r}"
    message = f"{what} not proven to mean what the rules mean: {reason}"
    return Diagnostic.warning(code, message, package.grant.origin, help_, package.subject)
