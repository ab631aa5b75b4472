# SPDX-License-Identifier: Apache-2.0
"""Learn a policy from the signed documents of a keystore, and prove that both mean the same."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field, replace

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.values import dataclass
from keymint.adoption.keystore_policy import differences
from keymint.api import (
    ComparisonTask,
    FoundEnclave,
    FoundKeystore,
    GrantedRules,
    KeystoreFiles,
    KeystoreReader,
    Relation,
)
from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint.names import package_name
from keymint.stages.proof.proof_results import ProofEffort, costliest

_REFUSED = frozenset(("adopt-authorities", "adopt-doubled"))
"""Findings on a keystore because of which nobody can tell what its documents grant to a subject."""

_NOTE = "Learned from the signed documents of a keystore, and proven to mean the same for all names."


@dataclass(frozen=True, slots=True)
class LearnedKeystore:
    """A policy that means what the signed documents of a keystore do.

    Attributes:
        document: the policy.
        granted: what the document of each enclave grants.
        subjects: the rules of each subject, as the policy gives them.
        diagnostics: what was left out because it has no effect, and what is wrong with the keystore, as warnings.
    """

    document: bytes = field(repr=False)
    granted: tuple[GrantedRules, ...]
    subjects: tuple[SubjectRules, ...]
    diagnostics: tuple[Diagnostic, ...]


@dataclass(frozen=True, slots=True)
class Learning:
    """How a policy is learned.

    Attributes:
        reader: reads the keystore.
        policy_type: name of the policy type that writes the policy.
        distro: ROS 2 distribution whose name mapping applies.
        name: path of the new policy, as the user would type it.
        effort: the limits of the search for one answer, and of the comparison of an enclave's documents.
    """

    reader: KeystoreReader
    policy_type: str
    distro: str
    name: str
    effort: ProofEffort


def learned_from(plugins: Plugins, files: KeystoreFiles, found: FoundKeystore, learning: Learning) -> LearnedKeystore:
    """Return the policy of a keystore, proven to mean what its signed documents mean, for all names.

    Args:
        plugins: the plugins.
        files: the files of the keystore.
        found: what it has.
        learning: how the policy is learned.

    Raises:
        KeymintError: a signature does not verify, a document grants what no policy can say, or the proof fails; each
            with its place.
    """
    writer = plugins.policy_type(learning.policy_type)
    if refused := [each for each in found.diagnostics if each.code in _REFUSED]:
        raise KeymintError.of(refused)
    granted: list[GrantedRules] = []
    errors: list[Diagnostic] = []
    for enclave in found.enclaves:
        try:
            _check_name(files, enclave)
            granted.append(learning.reader.granted(files, enclave, learning.distro))
        except KeymintError as error:
            errors += (replace(each, subject=enclave.subject) for each in error.diagnostics)
    if errors:
        raise KeymintError.of(errors)
    policy = writer.policy_of([each.rules for each in granted], learning.name, _NOTE)
    if policy is None:
        raise KeymintError(f"the policy type {learning.policy_type!r} cannot write rules", code="learn-unsupported")
    document, subjects = policy
    if unproven := list(_unproven(granted, subjects, learning)):
        raise KeymintError.of(unproven)
    defects = (each for each in found.diagnostics if each.severity is Severity.ERROR)
    warnings = (replace(each, severity=Severity.WARNING) for each in defects)
    diagnostics = (*warnings, *(diagnostic for each in granted for diagnostic in each.diagnostics))
    return LearnedKeystore(document, tuple(granted), subjects, diagnostics)


def _check_name(files: KeystoreFiles, enclave: FoundEnclave) -> None:
    """Raise an error at the place of an enclave whose path no policy can name."""
    try:
        package_name(enclave.subject)
    except KeymintError as error:
        raise error.at(Origin(f"{files.folder}/{enclave.facts['place']}")) from None


def _unproven(
    granted: Sequence[GrantedRules], written: Sequence[SubjectRules], learning: Learning
) -> Iterator[Diagnostic]:
    """Yield an error for each document that is not proven to mean what its subject's rules in the policy mean."""
    for each, rules in zip(granted, written, strict=True):
        task = ComparisonTask(
            each.document, each.file, each.offset, each.subject_name, rules, learning.distro, each.domains,
            learning.effort.states, learning.effort.deadline(),
        )  # fmt: skip
        with learning.effort.limit(rules.rules):
            comparison = learning.reader.compared(task)
        if comparison.relation is not Relation.EQUAL:
            reason = comparison.reason + costliest(rules.rules) if comparison.reason else differences(comparison)
            message = f"{rules.subject}: the learned rules are not proven to mean what {each.file} means: {reason}"
            help_ = "simplify the document, or report a defect of Keymint if it is a simple one"
            yield Diagnostic.error("learn-unproven", message, None, help_, rules.subject)
