# SPDX-License-Identifier: Apache-2.0
"""Rights in signed documents: how they compare with the rules of a policy, and who may present them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from enum import StrEnum

from comarmor.values import Data, field
from keymint.api.packages import DomainRange
from keymint.api.proving import Claim, Counterexample
from keymint.errors import Diagnostic, Origin
from keymint.ir import SubjectRules


class Relation(StrEnum):
    """How what a document permits is related to what rules allow, over all names.

    ``narrower``: it permits less, and nothing else; ``wider``: it permits all of it, and more; ``different``: each has
    something that the other lacks; ``unknown``: the document cannot be read, or the comparison was given up.
    """

    EQUAL = "equal"
    NARROWER = "narrower"
    WIDER = "wider"
    DIFFERENT = "different"
    UNKNOWN = "unknown"


class DocumentComparison(Data):
    """What a comparison found.

    Attributes:
        relation: the relation of the document to the rules.
        missing: a shortest name for which the rules allow something that the document does not permit, or None.
        excess: a shortest name for which the document permits something that the rules do not allow, or None.
        reason: why the relation is unknown; else empty.
    """

    relation: Relation
    missing: Counterexample | None = None
    excess: Counterexample | None = None
    reason: str = ""


class Comparison(Data):
    """What two documents mean, by the same rules.

    Attributes:
        theirs: the claims that the document of another tool permits what the rules allow; those of the standard first.
        ours: the same claims by the standard about the document that the build type compiles from the rules.
        diagnostics: warnings about rules, e.g. those that cannot be expressed for every vendor.
    """

    theirs: tuple[Claim, ...]
    ours: tuple[Claim, ...]
    diagnostics: tuple[Diagnostic, ...]


def standard_claims(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the claims by the first model, which is the standard."""
    return tuple(claim for claim in claims if claim.model == claims[0].model)


# -- documents in force, and who may present them -------------------------------------------------------------------


class Holder(Data):
    """A certificate in force. Whoever has its key may present any document that is signed for its name.

    Attributes:
        subject: the subject that it is for; empty if no package has this name.
        name: its distinguished name in certificate order, as :func:`keymint.pki.distinguished_names.parse` reads it.
        until: its end, UTC.
        rules: the policy's rules for the subject; none if no profile names it.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the rules apply.
    """

    subject: str
    name: str
    until: datetime
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]


class PresentableDocument(Data):
    """A document that an authority of the workspace signed, so that a holder may present it.

    Attributes:
        content: what is signed.
        where: its file, as the user would type it.
        lines_before: number of lines before the content in that file.
        proven_for: name of the certificate beside it, whose rights are proven apart; empty if there is none.
    """

    content: bytes = field(repr=False)
    where: Origin
    lines_before: int = 0
    proven_for: str = ""


class PresentationTask(Data):
    """The question which holders are permitted something beyond the policy by a document that they may present.

    Attributes:
        holders: all certificates in force.
        documents: all signed documents; of two with the same content the first one counts.
        now: the time from which on documents count, UTC.
        states: the most states that the search for one answer may visit.
        go_on: polled; the search ends when it returns False.
        distro: ROS 2 distribution for whose vendors each enclave is proven apart; empty: that of the holder.
    """

    holders: Sequence[Holder]
    documents: Sequence[PresentableDocument]
    now: datetime
    states: int
    go_on: Callable[[], bool]
    distro: str = ""


class ExcessRights(Data):
    """A holder is permitted something beyond the policy, or may be, by a document that it may present.

    Attributes:
        holder: the holder.
        document: the document.
        claims: the claims that fail, by model.
        until: the end of the document or of the certificate, UTC.
    """

    holder: Holder
    document: PresentableDocument
    claims: tuple[Claim, ...]
    until: datetime
