# SPDX-License-Identifier: Apache-2.0
"""Emits the permissions document of a subject by its kind.

It is renamed from that of another member, which the engine made, where that is proven to be the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

from comarmor.patterns.steps import step_limit
from keymint.api import BuildOptions, Claim, DomainRange, Grant, Package, Proof, Validity
from keymint.errors import KeymintError
from keymint.keymake.kinds import Arguments, Kind, kind_of
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.compiling.compile import vendor_notes
from keymint_ros2_dds.compiling.gathering import gathered
from keymint_ros2_dds.decision import VARIATIONS
from keymint_ros2_dds.documents import dds_xml, permissions_document
from keymint_ros2_dds.emission import Emitted, emit, proof_spec
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.kinds.structure import PLAIN_TEXT, Signature, Structure
from keymint_ros2_dds.kinds.template import Template
from keymint_ros2_dds.proving import proof_cache
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant
from keymint_ros2_dds.settings import validity_of
from keymint_ros2_dds.vendor_limits import TIGHT, signed_size

MOST = 1_000
"""Kinds that are remembered."""
FEW_STEPS = 5_000
"""Steps of the engine for a member that is renamed: a tenth of any limit, so that none decides about a document."""


@dataclass(frozen=True, slots=True)
class _Exemplar:
    """A member that the engine did.

    Attributes:
        minimal: template of the rules in its document.
        plain: template of the rules in plain form.
        claims: what is proven about its document, and about every renamed one.
    """

    minimal: Template
    plain: Template
    claims: tuple[Claim, ...]


@dataclass(slots=True)
class _Members:
    """The members of a kind.

    Attributes:
        structure: None if no member can be renamed; made for the second member, since many kinds have one only.
        first: the first member; None once it is among the exemplars.
        exemplars: a member for each signature.
    """

    first: tuple[Arguments, Emitted] | None
    structure: Structure | None = None
    exemplars: dict[Signature, _Exemplar] = field(default_factory=dict)

    def settle(self, kind: Kind, distro: str) -> None:
        """Make the structure, and an exemplar of the first member."""
        if self.first is not None:
            arguments, emitted = self.first
            self.first, self.structure = None, Structure.of(kind, distro)
            self.keep(arguments, emitted)

    def keep(self, arguments: Arguments, emitted: Emitted) -> None:
        """Keep a member that the engine did as an exemplar, unless its document cannot be a template."""
        if self.structure is None or emitted.compiled is None:
            return
        names = self.structure.names(arguments)
        if names is None:
            return
        minimal, plain = Template.of(emitted.rules, names), Template.of(emitted.compiled.plain, names)
        if minimal.renamed(names) == emitted.rules and minimal.has_no_names():
            self.exemplars[self.structure.signature(names)] = _Exemplar(minimal, plain, emitted.claims)


_known: dict[tuple[Kind, str, tuple[DomainRange, ...]], _Members] = {}


def emit_by_kind(package: Package, options: BuildOptions) -> Emitted:
    """Return the permissions document of a package, equal in every byte to that of the engine.

    Raises:
        KeymintError: see :func:`keymint_ros2_dds.emission.emit`.
    """
    if options != BuildOptions():
        return emit(package, options)
    kind, arguments = kind_of(package.grant.rules.rules)
    key = kind, package.distro, package.grant.domains
    members = _known.get(key)
    if members is not None:
        members.settle(kind, package.distro)
        renamed = _renamed(package, arguments, members)
        if renamed is not None:
            return renamed
    with step_limit(None) as counter:
        emitted = emit(package, options)
    if counter.spent <= FEW_STEPS and _is_usual(package, emitted):
        if members is not None:
            members.keep(arguments, emitted)
        else:
            if len(_known) >= MOST:
                _known.pop(next(iter(_known)))
            _known[key] = _Members((arguments, emitted))
    return emitted


def _is_usual(package: Package, emitted: Emitted) -> bool:
    """Tell whether a document of the engine is minimal, not gathered, proven, and nothing is reported but notes."""
    compiled = emitted.compiled
    return (
        compiled is not None
        and compiled.portable
        and len(compiled.forms) == 1
        and emitted.rules == compiled.forms[0]
        and all(claim.proof is Proof.PROVEN for claim in emitted.claims)
        and emitted.diagnostics == tuple(vendor_notes(emitted.rules, package.grant))
    )


def _renamed(package: Package, arguments: Arguments, members: _Members) -> Emitted | None:
    """Return the document of a package by renaming; None if a condition of the lemma does not hold."""
    grant, structure = package.grant, members.structure
    names = None if structure is None else structure.names(arguments)
    if structure is None or names is None or not _is_plain(grant):
        return None
    exemplar = members.exemplars.get(structure.signature(names))
    if exemplar is None:
        return None
    rules = exemplar.minimal.renamed(names)
    if gathered(rules) != rules:
        return None
    document = permissions_document.render(grant, rules)
    if signed_size(document) > TIGHT:
        return None
    dds_xml.know_valid(document, PERMISSIONS)
    proof_cache.remember(document, proof_spec(package), exemplar.claims)
    plain_size = len(permissions_document.render(grant, exemplar.plain.renamed(names)))
    return Emitted(document, rules, plain_size, None, exemplar.claims, tuple(vendor_notes(rules, grant)))


def _is_plain(grant: Grant) -> bool:
    """Tell whether every model reads the head of a document as it is meant: the grant's name, subject and validity."""
    try:
        text = subject_name_text.of(grant)
    except KeymintError:
        return False  # the engine says what is wrong first
    return bool(
        PLAIN_TEXT.fullmatch(grant.name)
        and PLAIN_TEXT.fullmatch(text)
        and all(each.semantics.selects(each.semantics.reads_text(text), text) for each in VARIATIONS.values())
        and _is_ever_in_force(validity_of(grant))
    )


@lru_cache(maxsize=1 << 10)
def _is_ever_in_force(validity: Validity) -> bool:
    dates = dds_xml.date(validity.not_before), dds_xml.date(validity.not_after)
    grant = DocumentGrant("", *dates, rules=(), allows=False, line=0)
    return all(each.semantics.period(grant) is not None for each in VARIATIONS.values())
