# SPDX-License-Identifier: Apache-2.0
"""The policy of a keystore: how signed documents compare with it, or one that is learned from them and proven."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from comarmor.values import Data, replace
from keymint import api
from keymint.api.plugin_loader import Plugins
from keymint.errors import Diagnostic, KeymintError, Origin, Severity, require_none
from keymint.ir import SubjectRules
from keymint.names import package_name
from keymint.stages.proof_results import ProofEffort, costliest, in_words

_WORDS = {
    api.Relation.EQUAL: "equal to the policy",
    api.Relation.NARROWER: "narrower than the policy",
    api.Relation.WIDER: "WIDER than the policy",
    api.Relation.DIFFERENT: "DIFFERENT from the policy",
    api.Relation.UNKNOWN: "not known to be equal to the policy",
}
_NOTE = "Learned from the signed documents of a keystore, and proven to mean the same for all names."


class AdoptedPolicy(Data):
    """The policy of a keystore that is taken over.

    Attributes:
        path: its path as the profile names it: relative to the profile space, or absolute.
        files: files to write into the profile space, by path relative to it; none if the policy lies elsewhere.
        rules: the rules of each subject that it has any for.
        subjects: the subjects that it names.
        diagnostics: what changes or is lost.
    """

    path: str
    files: Mapping[str, bytes]
    rules: Mapping[str, SubjectRules]
    subjects: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


class Compared(Data):
    """How the signed document of a subject compares with the policy.

    Attributes:
        subject: the subject.
        comparison: the result.
        file: the signed document, as the user would type it.
    """

    subject: str
    comparison: api.DocumentComparison
    file: str

    @property
    def words(self) -> str:
        """The relation in words."""
        return _WORDS[self.comparison.relation]

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON."""
        found = self.comparison
        examples = {
            key: None
            if example is None
            else {
                "action": example.endpoint.action,
                "name": example.endpoint.name,
                "document": example.document.allowed,
                "policy": example.policy.allowed,
            }
            for key, example in (("missing", found.missing), ("excess", found.excess))
        }
        return {"relation": str(found.relation), **examples, "reason": found.reason or None}


def document_comparisons(
    reader: api.KeystoreReader,
    keystore: api.FoundKeystore,
    rules: Mapping[str, SubjectRules],
    distro: str,
    effort: ProofEffort,
) -> tuple[Compared, ...]:
    """Compare the signed documents of a keystore with a policy.

    Args:
        reader: reads the documents.
        keystore: what it has; enclaves without rights that verify have a finding already.
        rules: the rules of the policy, by subject; a subject without any may do nothing.
        distro: ROS 2 distribution whose name mapping applies.
        effort: the limits of the search for one answer, and of the comparison of all documents together.

    Raises:
        KeymintError: a rule cannot be mapped.
    """
    found: list[Compared] = []
    go_on = effort.deadline()
    for each in keystore.enclaves:
        if (grant := each.grant) is not None:
            of_subject = rules.get(each.subject, SubjectRules(each.subject, ()))
            task = api.ComparisonTask(
                grant.document, grant.file, grant.offset, grant.subject_name, of_subject, distro, each.domains,
                effort.states, go_on,
            )  # fmt: skip
            with effort.limit(of_subject.rules):
                found.append(Compared(each.subject, reader.compared(task), grant.file))
    return tuple(found)


def differences(found: api.DocumentComparison) -> str:
    """Return the shortest names on which a document and a policy differ, in words."""
    words = (in_words(each) for each in (found.missing, found.excess) if each is not None)
    return "; ".join(f"it {permits} {name}, which the policy {allows}" for permits, name, allows in words)


# -- learn a policy from the signed documents of a keystore -----------------------------------------------------------


class Learning(Data):
    """How a policy is learned.

    Attributes:
        reader: reads the keystore.
        policy_type: name of the policy type that writes the policy.
        distro: ROS 2 distribution whose name mapping applies.
        name: path of the new policy, as the user would type it.
        effort: the limits of the search for one answer, and of the comparison of an enclave's documents.
    """

    reader: api.KeystoreReader
    policy_type: str
    distro: str
    name: str
    effort: ProofEffort


def learned_from(
    plugins: Plugins,
    files: api.KeystoreFiles,
    found: api.FoundKeystore,
    learning: Learning,
    unclear: Sequence[Diagnostic],
) -> tuple[bytes, list[api.GrantedRules], tuple[Diagnostic, ...]]:
    """Return the policy of a keystore, proven to mean what its signed documents mean, for all names.

    Args:
        plugins: the plugins.
        files: the files of the keystore.
        found: what it has.
        learning: how the policy is learned.
        unclear: the findings because of which nobody can tell what its documents grant to a subject.

    Returns:
        The policy; what the document of each enclave grants, with the rules as the policy gives them; and as warnings
        what was left out because it has no effect, and what is wrong with the keystore.

    Raises:
        KeymintError: a signature does not verify, a document grants what no policy can say, or the proof fails; each
            with its place.
    """
    writer = plugins.policy_type(learning.policy_type)
    require_none(unclear)
    granted: list[api.GrantedRules] = []
    errors: list[Diagnostic] = []
    for enclave in found.enclaves:
        try:
            try:
                package_name(enclave.subject)
            except KeymintError as error:  # no policy can name its path
                raise error.at(Origin(f"{files.folder}/{enclave.facts['place']}")) from None
            granted.append(learning.reader.granted(files, enclave, learning.distro))
        except KeymintError as error:
            errors += (replace(each, subject=enclave.subject) for each in error.diagnostics)
    require_none(errors)
    policy = writer.policy_of([each.rules for each in granted], learning.name, _NOTE)
    if policy is None:
        raise KeymintError(f"the policy type {learning.policy_type!r} cannot write rules", code="learn-unsupported")
    document, subjects = policy
    granted = [replace(each, rules=rules) for each, rules in zip(granted, subjects, strict=True)]
    require_none(_unproven(granted, learning))
    defects = (each for each in found.diagnostics if each.severity is Severity.ERROR)
    warnings = (replace(each, severity=Severity.WARNING) for each in defects)
    diagnostics = (*warnings, *(diagnostic for each in granted for diagnostic in each.diagnostics))
    return document, granted, diagnostics


def _unproven(granted: Iterable[api.GrantedRules], learning: Learning) -> Iterator[Diagnostic]:
    """Yield an error for each document that is not proven to mean what its subject's rules in the policy mean."""
    for each in granted:
        rules = each.rules
        task = api.ComparisonTask(
            each.document, each.file, each.offset, each.subject_name, rules, learning.distro, each.domains,
            learning.effort.states, learning.effort.deadline(),
        )  # fmt: skip
        with learning.effort.limit(rules.rules):
            comparison = learning.reader.compared(task)
        if comparison.relation is not api.Relation.EQUAL:
            reason = comparison.reason + costliest(rules.rules) if comparison.reason else differences(comparison)
            message = f"{rules.subject}: the learned rules are not proven to mean what {each.file} means: {reason}"
            help_ = "simplify the document, or report a defect of Keymint if it is a simple one"
            yield Diagnostic.error("learn-unproven", message, None, help_, rules.subject)
