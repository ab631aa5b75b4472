# SPDX-License-Identifier: Apache-2.0
"""Policies of other tools: policy types translate from and to them, and build types compare what is enforced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api.proving import Claim
from keymint.ir import SubjectRules


@dataclass(frozen=True, slots=True)
class ImportedSubject:
    """A subject of an imported policy.

    Attributes:
        rules: its rules, as the new policy gives them.
        document: what the other tool writes for it, unsigned.
        subject_name: its distinguished name in that document.
        deviates: the other tool enforces something else than its policy reads, as the diagnostics say.
    """

    rules: SubjectRules
    document: bytes = field(repr=False)
    subject_name: str
    deviates: bool = False


@dataclass(frozen=True, slots=True)
class ImportedPolicy:
    """A policy in the language of Keymint.

    Attributes:
        document: the new policy.
        subjects: its subjects, in the order of the policy.
        diagnostics: what changes, and what is lost, as warnings and notes with ``file:line``.
    """

    document: bytes = field(repr=False)
    subjects: tuple[ImportedSubject, ...]
    diagnostics: tuple[Diagnostic, ...]


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """A policy to import.

    Attributes:
        path: the file.
        name: path of the new policy, as the user would type it, for the places of its rules.
        library: folder of the policy library that the new policy may include.
        accept: take the policy as it reads where the other tool enforces something else.
        implicit: with the rules that the other tool adds by itself.
        library_shown: path of the library in the places of rules, if it will be copied there.
    """

    path: Path
    name: str
    library: Path
    accept: bool = False
    implicit: bool = True
    library_shown: Path | None = None


@runtime_checkable
class PolicyImporter(Protocol):
    """Optional capability of a policy type: translates its policies to the language of Keymint."""

    NOUN: str
    """What its files are called, with its article; see :class:`keymint.api.RecognisedPolicy`."""
    TOOL: str
    """The tool that the policies are written for."""
    BUILD_TYPE: str
    """The build type that reads what this tool writes."""

    def translated(self, request: ImportRequest) -> ImportedPolicy:
        """Translate a policy.

        Raises:
            KeymintError: the policy is not valid, cannot be expressed, or is not enforced as it reads and that is not
                accepted; every defect with its ``file:line``.
        """


@dataclass(frozen=True, slots=True)
class ExportedPolicy:
    """A policy in the language of another tool.

    Attributes:
        document: the policy.
        subjects: for each subject the rules that the document expresses, and what the other tool writes for it.
        diagnostics: what is left out, and what the other tool adds, as warnings with ``file:line``.
    """

    document: bytes = field(repr=False)
    subjects: tuple[ImportedSubject, ...]
    diagnostics: tuple[Diagnostic, ...]


@runtime_checkable
class PolicyExporter(Protocol):
    """Optional capability of a policy type: writes rules in its own format."""

    FORMAT: str
    """The name of the format."""
    TOOL: str
    """The tool that the policies are written for."""
    BUILD_TYPE: str
    """The build type that reads what this tool writes."""

    def exported(self, subjects: Sequence[SubjectRules], *, lossy: bool = False) -> ExportedPolicy:
        """Write rules in this format.

        Args:
            subjects: the rules of each subject.
            lossy: leave out what the format cannot express, where it only allows something.

        Raises:
            KeymintError: a rule cannot be expressed; each with its ``file:line``.
        """


@dataclass(frozen=True, slots=True)
class WrittenPolicy:
    """A policy in a format that Keymint writes but no build type reads.

    Attributes:
        document: the policy.
        diagnostics: what is left out, as warnings with ``file:line``.
    """

    document: bytes = field(repr=False)
    diagnostics: tuple[Diagnostic, ...] = ()


class PolicyFormat(Protocol):
    """Writes rules in a format of policies, under whose name it is registered.

    What a :class:`PolicyExporter` writes is also proven to mean the same.
    """

    API: str
    """Version of the plugin interface, :data:`keymint.api.API_VERSION`."""

    def written(self, subjects: Sequence[SubjectRules], *, lossy: bool = False) -> WrittenPolicy:
        """Write rules in this format.

        Args:
            subjects: the rules of each subject.
            lossy: leave out what the format cannot express, where it only allows something.

        Raises:
            KeymintError: a rule cannot be expressed; each with its ``file:line``.
        """


def standard_claims(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the claims by the first model, which is the standard."""
    return tuple(claim for claim in claims if claim.model == claims[0].model)
