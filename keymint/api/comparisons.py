# SPDX-License-Identifier: Apache-2.0
"""Comparison of a document that is in force with the rules of a policy: which of them permits more, and where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from enum import StrEnum
from typing import Protocol, runtime_checkable

from comarmor.values import dataclass
from keymint.api.packages import DomainRange, Package
from keymint.api.proving import Counterexample
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


@dataclass(frozen=True, slots=True)
class ComparisonTask:
    """A document to compare with rules.

    Attributes:
        document: the document, unsigned; its signature was verified.
        file: its file, for places.
        offset: number of lines before it in that file, e.g. the header of a signed one.
        subject_name: distinguished name of the identity, in the order of RFC 2253, e.g. ``CN=/talker,OU=0f``.
        rules: the rules of the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the rules apply; elsewhere nothing is allowed.
        states: the most states that the search for one answer may visit.
        go_on: polled; the search ends when it returns False.
    """

    document: bytes = field(repr=False)
    file: str
    offset: int
    subject_name: str
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    states: int
    go_on: Callable[[], bool]


@dataclass(frozen=True, slots=True)
class DocumentComparison:
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


@runtime_checkable
class DocumentComparer(Protocol):
    """Optional capability of a build type: compares a document of an enclave with rules."""

    def compared(self, task: ComparisonTask) -> DocumentComparison:
        """Compare a document, as the transport's standard reads it, with the rules of a subject.

        Dates are not compared: each grant that is ever in force must permit what the rules allow.

        Raises:
            KeymintError: a rule cannot be mapped; with ``file:line``. A document that cannot be read is ``unknown``.
        """

    def compared_with(self, content: bytes, name: str, package: Package) -> DocumentComparison:
        """Compare a signed document, as the transport's standard reads it, with the rules of a package.

        Args:
            content: what is signed.
            name: distinguished name of the certificate that it is presented with; see :attr:`keymint.api.Holder.name`.
            package: the package.

        Raises:
            KeymintError: a rule cannot be mapped. A document that cannot be read is ``unknown``.
        """
