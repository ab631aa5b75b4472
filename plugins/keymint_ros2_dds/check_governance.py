"""``keymint check``: what an installed governance leaves open, or protects less than the sources say."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.decision_lists import SearchBudget, Universe
from comarmor.patterns.tokens import PatternError
from keymint.api import Inspection
from keymint.errors import KeymintError
from keymint.pki import smime
from keymint_ros2_dds import governance_warnings
from keymint_ros2_dds.decision.access import DomainAccess
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.layout import GOVERNANCE_P7S
from keymint_ros2_dds.proving import octets
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance, cuts
from keymint_ros2_dds.proving.protection import STRICT, Weaker, weaker

_NAMES = Universe(octets.ALPHABET, last_nonempty=True)


def findings(inspection: Inspection) -> Iterator[Diagnostic]:
    """Yield what the sources leave open, and what the signed document does beyond that.

    Args:
        inspection: the enclave; its governance document is signed, and valid.

    Raises:
        KeymintError: the sources say what no document can.
    """
    package = inspection.package
    for found in governance_warnings.findings(package):
        if found.severity is Severity.WARNING and found.code != governance_warnings.UNPROTECTED:
            yield found
    file = f"{inspection.folder}/{GOVERNANCE_P7S}"
    try:
        signed = smime.read(inspection.files[GOVERNANCE_P7S], inspection.permissions_ca, where=Origin(file))
    except KeymintError:
        return  # said by whoever judges the signature
    place = (file, signed.lines_before)
    governing = EnclaveGovernance.of(signed.content, place, package.governance, package.subject, package.distro)
    if governing.differs:
        yield from dict.fromkeys(_drifted(inspection, governing))


def _drifted(inspection: Inspection, governing: EnclaveGovernance) -> Iterator[Diagnostic]:
    subject, document = inspection.package.subject, governing.document
    again = f"'keymint install {inspection.package.name}' signs what the sources build"
    for domains in cuts(document, governing.sources):
        rule = DomainAccess.of(document, domains.first, STANDARD).rule
        if rule is None:
            continue
        own = governing.source_rule(domains.first) or STRICT
        try:
            all_found = list(weaker(rule, own, STANDARD, _NAMES, SearchBudget(governance_warnings.STATES), access=True))
        except PatternError as error:
            yield Diagnostic("governance-unread", Severity.ERROR, str(error), document.place(rule.line), again, subject)
            continue
        for found in all_found:
            if isinstance(found, Weaker):
                about = f" for {found.topic!r}" if found.topic else ""
                message = f"{found.tag} is {found.text}{about}, but the sources say {found.said}"
                where = document.place(found.line)
                yield Diagnostic("governance-weaker", Severity.ERROR, message, where, again, subject)
            else:
                message = f"whether it protects what the sources protect is not known: {found.reason}"
                yield Diagnostic(
                    "governance-unknown", Severity.ERROR, message, document.place(rule.line), again, subject
                )
