# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: findings on an installed governance that opens topics or protects less than its sources."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.decision_lists import SearchBudget
from comarmor.patterns.tokens import PatternError
from keymint.api import Inspection
from keymint.errors import KeymintError
from keymint.pki import smime
from keymint_ros2_dds import authority_roles as roles
from keymint_ros2_dds import governance_warnings
from keymint_ros2_dds.decision.semantics import STANDARD
from keymint_ros2_dds.enclave_layout import GOVERNANCE_P7S
from keymint_ros2_dds.proving.enclave_governance import EnclaveGovernance, cuts
from keymint_ros2_dds.proving.protection import STRICT, Weaker, weaker


def findings(inspection: Inspection) -> Iterator[Diagnostic]:
    """Yield findings on what the sources leave open, and on what the signed document protects less.

    Args:
        inspection: the enclave; its governance document is signed and valid.

    Raises:
        KeymintError: the sources cannot be compiled.
    """
    package = inspection.package
    for finding in governance_warnings.findings(package):
        if finding.severity is Severity.WARNING and finding.code != governance_warnings.UNPROTECTED:
            yield finding
    file = f"{inspection.folder}/{GOVERNANCE_P7S}"
    try:
        signed = smime.read(inspection.files[GOVERNANCE_P7S], inspection.chains[roles.PERMISSIONS], where=Origin(file))
    except KeymintError:
        return  # the check of signatures reports it
    place = (file, signed.lines_before)
    governing = EnclaveGovernance(signed.content, place, package)
    if governing.differs:
        yield from dict.fromkeys(_weaker_protection(inspection, governing))


def _weaker_protection(inspection: Inspection, governing: EnclaveGovernance) -> Iterator[Diagnostic]:
    subject, document = inspection.package.subject, governing.document
    help_ = f"'keymint install {inspection.package.name}' signs what the sources build"

    def finding(code: str, message: str, line: int) -> Diagnostic:
        return Diagnostic.error(code, message, document.place(line), help_, subject)

    for domains in cuts(governing.domains()):
        rule = document.rule(domains.first)
        if rule is None:
            continue
        expected = governing.source_rule(domains.first) or STRICT
        try:
            results = list(weaker(rule, expected, STANDARD, SearchBudget(governance_warnings.STATES), access=True))
        except PatternError as error:
            yield finding("governance-unread", str(error), rule.line)
            continue
        for result in results:
            if isinstance(result, Weaker):
                scope = f" for {result.topic!r}" if result.topic else ""
                message = f"{result.tag} is {result.text}{scope}, but the sources require {result.required}"
                yield finding("governance-weaker", message, result.line)
            else:
                message = f"whether it protects as much as the sources is unknown: {result.reason}"
                yield finding("governance-unknown", message, rule.line)
