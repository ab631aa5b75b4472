# SPDX-License-Identifier: Apache-2.0
"""Translate an SROS2 policy to ComArmor, and give what SROS2 writes from it, so that both can be compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from comarmor.errors import Diagnostic, Severity
from comarmor.language.parse import parse as parse_comarmor
from comarmor.language.source import read_document
from keymint.api import ImportedPolicy, ImportedSubject, ImportRequest
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint_ros2_sros2 import comarmor_document, permissions
from keymint_ros2_sros2.deviations import ACCEPTABLE, deviations
from keymint_ros2_sros2.names import as_read
from keymint_ros2_sros2.parse import parse
from keymint_ros2_sros2.syntax import SourcePolicy, Sros2Enclave


def translate_policy(request: ImportRequest) -> ImportedPolicy:
    """Translate a policy; see :meth:`keymint.api.PolicyImporter.translated`.

    Raises:
        KeymintError: the policy is not valid, cannot be expressed, or SROS2 enforces something else than it reads and
            that is not accepted; every defect with its ``file:line``.
    """
    policy = parse(request.path)
    found = deviations(policy)
    if refused := [each for each in found if not (request.accept and each.code in ACCEPTABLE)]:
        raise KeymintError.of(refused)
    enclaves, graph = _by_path(policy), request.implicit and policy.has_graph
    document = comarmor_document.document(enclaves.values(), policy.closing, request.library, graph=graph)
    loaded = parse_comarmor(read_document(document, request.name, request.library, request.library_shown))
    deviating = {each.subject for each in found}
    subjects = tuple(
        ImportedSubject(
            SubjectRules(path, loaded.rules(path)),
            # Of an enclave that stands twice, generate_artifacts uses the last.
            permissions.document(group[-1], graph=graph),
            permissions.subject_name(group[-1]),
            path in deviating,
        )
        for path, group in enclaves.items()
    )
    help_ = "the new policy has it as it reads (--accept)"
    accepted = (replace(each, severity=Severity.WARNING, help=help_) for each in found)
    return ImportedPolicy(document, subjects, (*accepted, *_notes(policy)))


def _by_path(policy: SourcePolicy) -> Mapping[str, list[Sros2Enclave]]:
    found: dict[str, list[Sros2Enclave]] = {}
    for enclave in policy.enclaves:
        found.setdefault(enclave.path, []).append(enclave)
    return found


def _notes(policy: SourcePolicy) -> Iterator[Diagnostic]:
    """Yield a note for what is lost, for lists without meaning, and for logs that stay in a namespace."""
    yield from policy.lost
    for enclave in policy.enclaves:
        for node in enclave.nodes():
            for rules in node.lists:
                if not rules.effects:
                    message = f"<{rules.tag}> has no qualifier, so that it allows and denies nothing"
                    yield Diagnostic.note("sros2-no-qualifier", message, rules.where, "", enclave.path)
                for entry in rules.entries:
                    name = as_read(node, entry.text)
                    if rules.tag == "topics" and entry.text.strip() == "rosout" and name != "/rosout":
                        message = f"'rosout' is {name} here, but nodes publish their log to /rosout"
                        help_ = "allow /rosout as well"
                        yield Diagnostic.warning("sros2-rosout", message, entry.where, help_, enclave.path)
