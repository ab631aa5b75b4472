"""The permissions document that a build emits: the smallest that is proven to mean what the rules say.

The compiler may rewrite as boldly as it likes, since every result is held against the rules over all names; where that
is refuted, or not found out, the plain form is emitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from lxml import etree

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns.steps import step_limit
from keymint.api import BuildOptions, Claim, Package, Proof
from keymint.errors import KeymintError
from keymint.pki import names
from keymint_ros2_dds.compiling.compile import Compiled, compile_rules, remarks
from keymint_ros2_dds.compiling.criteria import Criteria
from keymint_ros2_dds.decision import OMG
from keymint_ros2_dds.documents import dds_xml as documents
from keymint_ros2_dds.documents.permissions_document import render, rendered_size
from keymint_ros2_dds.layout import PERMISSIONS, PERMISSIONS_XML
from keymint_ros2_dds.lowering.lower import Lowered
from keymint_ros2_dds.lowering.mapping import Action
from keymint_ros2_dds.proving import ASSUMPTIONS, ProofSpec, prove_content

STATES = 50_000
"""States that a question may visit, so that a build never hangs."""
STEPS = 8_000_000
"""Steps that all questions about the forms of a document may take together (:mod:`comarmor.patterns.steps`)."""


@dataclass(frozen=True, slots=True)
class Emitted:
    """A permissions document.

    Attributes:
        document: the document, not signed.
        plain_size: bytes of its plain form.
        lowered: what it is to mean.
        diagnostics: what is to be said of it.
    """

    document: bytes
    plain_size: int
    lowered: Lowered
    diagnostics: tuple[Diagnostic, ...]


def emit(package: Package, options: BuildOptions) -> Emitted:
    """Return the permissions document of a package; a pure function of its arguments.

    Raises:
        KeymintError: vendors would not read the rules alike, or what cannot be is asked for, with ``file:line``; or no
            form of the document means what the rules say.
    """
    compiled = compile_rules(package.permissions, package.distro, options)
    with step_limit(STEPS):
        return _smallest(package, options, compiled)


def _smallest(package: Package, options: BuildOptions, compiled: Compiled) -> Emitted:
    """Return the document in the first of its forms that is proven, or else in its plain form."""
    said: list[Diagnostic] = []
    for rules in _forms(compiled, optimise=options.optimise):
        document = render(package.permissions, rules)
        open_ = _not_proven(package, compiled.lowered, document, _models(compiled))
        if not open_ or rules is compiled.plain:
            said += [*compiled.diagnostics, *_unproven(package, compiled, open_), *remarks(rules, package.permissions)]
            break
        said += _given_up(package, open_)
    plain = len(document) if rules == compiled.plain else rendered_size(package.permissions, compiled.plain)
    return Emitted(document, plain, compiled.lowered, tuple(said))


def _forms(compiled: Compiled, *, optimise: bool) -> Iterator[tuple[Criteria, ...]]:
    """Yield the forms of the rules, the one that is liked best first."""
    if optimise:
        yield from (form for form in compiled.forms if form != compiled.plain)
    yield compiled.plain


def means_the_same(package: Package, document: bytes) -> bool:
    """Tell whether a permissions document is one of the forms in which a package's rules can be written.

    It is proven to mean what the rules say; what it says of relaying cannot be proven, and is to be what a form says.

    Raises:
        KeymintError: the document cannot be read, or the rules cannot be compiled.
    """
    compiled = compile_rules(package.permissions, package.distro, BuildOptions(allow_vendor_specific=True))
    forms = [render(package.permissions, rules) for rules in (*compiled.forms, compiled.plain)]
    if document in forms:
        return True
    if _relays(document) not in map(_relays, forms):
        return False
    return not _not_proven(package, compiled.lowered, document, _models(compiled))


def _relays(document: bytes) -> list[bytes]:
    """Return the rules that say something of relaying, as they are written."""
    root = documents.read(document, PERMISSIONS, PERMISSIONS_XML)
    return [etree.tostring(found, method="c14n") for found in root.iterfind(f".//{Action.RELAY}/..")]


def _models(compiled: Compiled) -> tuple[str, ...]:
    """Where vendors differ anyway, and that was accepted, the standard's reading is the one that counts."""
    return tuple(ASSUMPTIONS) if compiled.alike else (OMG.name,)


def _not_proven(package: Package, lowered: Lowered, document: bytes, models: Sequence[str]) -> list[Claim]:
    """Return the claims that are not proven."""
    held = ProofSpec(
        names.render(names.parse(package.permissions.subject_name, package.permissions.origin)),
        package.permissions.rules,
        package.distro,
        package.permissions.domains,
        STATES,
        lambda: True,
    )
    claims = prove_content(document, (PERMISSIONS_XML, 0), held, models=models, lowered=lowered)
    return [claim for claim in claims if claim.proof is not Proof.PROVEN]


def _given_up(package: Package, open_: Sequence[Claim]) -> Iterator[Diagnostic]:
    yield Diagnostic(
        "rewriting-unproven",
        Severity.WARNING,
        f"the smaller form of the permissions is not proven to mean what the rules say: {_why(open_[0])}",
        package.permissions.origin,
        "the plain form is written; '--no-optimise' asks for nothing else",
        package.subject,
    )


def _unproven(package: Package, compiled: Compiled, open_: Sequence[Claim]) -> Iterator[Diagnostic]:
    """Yield a warning for a document that is not proven.

    Raises:
        KeymintError: it is refuted although vendors should read it alike.
    """
    for claim in open_[:1]:
        message = f"the permissions are not proven to mean what the rules say: {_why(claim)}"
        if compiled.alike and claim.proof is Proof.COUNTEREXAMPLE:
            raise KeymintError(
                message, where=package.permissions.origin, code="compile-refuted",
                help="this is a defect of Keymint; say the rules in a simpler way, and report it",
            )  # fmt: skip
        help_ = "'keymint prove' may find it out with more time"
        yield Diagnostic(
            "compile-unproven", Severity.WARNING, message, package.permissions.origin, help_, package.subject
        )


def _why(claim: Claim) -> str:
    found = claim.counterexample
    if found is None:
        return f"{claim.model}, {claim.action}: {claim.reason}"
    may = "permits" if found.document.allowed else "does not permit"
    return f"{claim.model} {may} it to {claim.action} {found.endpoint.object.name!r}"
