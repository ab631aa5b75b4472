# SPDX-License-Identifier: Apache-2.0
"""The policy of a keystore that is taken over, and how each signed document compares with it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from comarmor.errors import Diagnostic, Origin
from comarmor.values import dataclass
from keymint.api import (
    ComparisonTask,
    Counterexample,
    DocumentComparison,
    FoundEnclave,
    KeystoreReader,
    Relation,
)
from keymint.ir import SubjectRules
from keymint.stages.proof.proof_results import ProofEffort

_WORDS = {
    Relation.EQUAL: "equal to the policy",
    Relation.NARROWER: "narrower than the policy",
    Relation.WIDER: "WIDER than the policy",
    Relation.DIFFERENT: "DIFFERENT from the policy",
    Relation.UNKNOWN: "not known to be equal to the policy",
}


@dataclass(frozen=True, slots=True)
class AdoptedPolicy:
    """The policy of a keystore that is taken over.

    Attributes:
        path: its path as the profile names it: relative to the profile space, or absolute.
        files: files to write into the profile space, by path relative to it; none if the policy lies elsewhere.
        rules: the rules of each subject that it has any for.
        subjects: the subjects that it names.
        learned: it was made from the signed documents.
        diagnostics: what changes or is lost.
    """

    path: str
    files: Mapping[str, bytes]
    rules: Mapping[str, SubjectRules]
    subjects: tuple[str, ...]
    learned: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class Compared:
    """How the signed document of a subject compares with the policy.

    Attributes:
        subject: the subject.
        comparison: the result.
        file: the signed document, as the user would type it.
    """

    subject: str
    comparison: DocumentComparison
    file: str

    @property
    def words(self) -> str:
        """The relation in words."""
        return _WORDS[self.comparison.relation]

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON."""
        found = self.comparison
        return {
            "relation": str(found.relation),
            "missing": _example_json(found.missing),
            "excess": _example_json(found.excess),
            "reason": found.reason or None,
        }

    def finding(self) -> Diagnostic | None:
        """Return the finding; None if document and policy permit the same."""
        found = self.comparison
        if found.relation is Relation.EQUAL:
            return None
        message = f"is {found.relation} in comparison with the policy: {differences(found) or found.reason}"
        if found.relation is Relation.UNKNOWN:
            message = f"cannot be compared with the policy: {found.reason}"
        help_ = "change the policy; or leave it out, so that a policy is made from what is signed"
        return Diagnostic.error("adopt-policy", message, Origin(self.file), help_, self.subject)


def document_comparisons(
    reader: KeystoreReader,
    enclaves: Iterable[FoundEnclave],
    rules: Mapping[str, SubjectRules],
    distro: str,
    effort: ProofEffort,
) -> tuple[Compared, ...]:
    """Compare the signed documents of a keystore with a policy.

    Args:
        reader: reads the documents.
        enclaves: the enclaves; those without rights that verify have a finding already.
        rules: the rules of the policy, by subject; a subject without any may do nothing.
        distro: ROS 2 distribution whose name mapping applies.
        effort: the limits of the search for one answer, and of the comparison of all documents together.

    Raises:
        KeymintError: a rule cannot be mapped.
    """
    found: list[Compared] = []
    go_on = effort.deadline()
    for each in enclaves:
        if (grant := each.grant) is not None:
            of_subject = rules.get(each.subject, SubjectRules(each.subject, ()))
            task = ComparisonTask(
                grant.document, grant.file, grant.offset, grant.subject_name, of_subject, distro, each.domains,
                effort.states, go_on,
            )  # fmt: skip
            with effort.limit(of_subject.rules):
                found.append(Compared(each.subject, reader.compared(task), grant.file))
    return tuple(found)


def differences(found: DocumentComparison) -> str:
    """Return the shortest names on which a document and a policy differ, in words."""
    return "; ".join(_example(each) for each in (found.missing, found.excess) if each is not None)


def _example(example: Counterexample) -> str:
    permits = "permits" if example.document.allowed else "does not permit"
    allows = "allows" if example.policy.allowed else "does not allow"
    meaning = f" ({example.meaning.permission} {example.meaning.object.name})" if example.meaning else ""
    return f"it {permits} {example.endpoint.action} {example.endpoint.name!r}{meaning}, which the policy {allows}"


def _example_json(example: Counterexample | None) -> dict[str, Any] | None:
    if example is None:
        return None
    return {
        "action": example.endpoint.action,
        "name": example.endpoint.name,
        "document": example.document.allowed,
        "policy": example.policy.allowed,
    }
