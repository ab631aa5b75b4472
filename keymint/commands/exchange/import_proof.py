# SPDX-License-Identifier: Apache-2.0
"""What is proven about an imported policy, and how its diagnostics say it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api import Claim, Comparison, Counterexample, Proof, standard_claims


@dataclass(frozen=True, slots=True)
class SubjectProof:
    """What is proven about a subject.

    Attributes:
        subject: the subject.
        deviates: the other tool is known to enforce something else than its policy reads, which was accepted.
        comparison: the claims.
    """

    subject: str
    deviates: bool
    comparison: Comparison

    @property
    def is_same(self) -> bool:
        """Whether both documents permit the same for all names, as the standard reads them."""
        claims = (*standard_claims(self.comparison.theirs), *self.comparison.ours)
        return all(claim.proof is Proof.PROVEN for claim in claims)


def unproven(proofs: Iterable[SubjectProof], tool: str) -> list[Diagnostic]:
    """Return an error for each subject whose documents are not proven to mean the same, unless that was accepted."""
    found = []
    for proof in proofs:
        claims = (*proof.comparison.ours, *(() if proof.deviates else standard_claims(proof.comparison.theirs)))
        claim = next((each for each in claims if each.proof is not Proof.PROVEN), None)
        if claim is not None:
            message = f"{proof.subject}: not proven to permit what {tool}'s document permits: {_reason(claim, tool)}"
            help_ = "this is a defect of Keymint: report it" if claim.counterexample else "simplify the policy"
            found.append(Diagnostic.error("import-unproven", message, None, help_, proof.subject))
    return found


def diagnostics_of(proofs: Iterable[SubjectProof], tool: str) -> Iterator[Diagnostic]:
    """Yield what changes for a subject, what vendors read otherwise, and rules that not every vendor supports."""
    for proof in proofs:
        yield from proof.comparison.diagnostics
        standard = standard_claims(proof.comparison.theirs)
        for claim in standard:
            if claim.counterexample is not None:
                message = f"{proof.subject}: what is enforced changes: {_difference(claim.counterexample, tool)}"
                where = claim.counterexample.policy.where
                yield Diagnostic.warning("import-changes", message, where, "", proof.subject)
        if proof.is_same:
            yield from _vendors(proof, standard[0].model, tool)


def _vendors(proof: SubjectProof, standard: str, tool: str) -> Iterator[Diagnostic]:
    """Yield a note for each vendor that reads the other tool's document differently from the standard."""
    seen = {standard}
    for claim in proof.comparison.theirs:
        if claim.counterexample is not None and claim.model not in seen:
            seen.add(claim.model)
            message = f"{proof.subject}: {claim.model} reads {tool}'s document differently from the standard"
            difference = f"{message}: {_difference(claim.counterexample, tool)}"
            where = claim.counterexample.policy.where
            yield Diagnostic.note("import-vendor", difference, where, "", proof.subject)


def _difference(example: Counterexample, tool: str) -> str:
    """Return a shortest name on which both differ, in words."""
    permits = "permits" if example.document.allowed else "does not permit"
    allows = "allows" if example.policy.allowed else "does not allow"
    ros = f" ({example.meaning.permission} {example.meaning.object.name})" if example.meaning else ""
    name = f"{example.endpoint.action} {example.endpoint.name!r}{ros}"
    return f"{tool}'s document {permits} it to {name}, and the policy in ComArmor {allows} it"


def _reason(claim: Claim, tool: str) -> str:
    if claim.counterexample is not None:
        return _difference(claim.counterexample, tool)
    return f"{claim.model}, {claim.action}: {claim.reason}"
