# SPDX-License-Identifier: Apache-2.0
"""Policies that come from another tool or go to one, those that are learned, and the formats that only write."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from comarmor.values import Data, field
from keymint.errors import Diagnostic
from keymint.ir import SubjectRules

if TYPE_CHECKING:
    from keymint.api.graph import Edge


class ImportedSubject(Data):
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


class ImportedPolicy(Data):
    """A policy in the language of Keymint.

    Attributes:
        document: the new policy.
        subjects: its subjects, in the order of the policy.
        diagnostics: what changes, and what is lost, as warnings and notes with ``file:line``.
    """

    document: bytes = field(repr=False)
    subjects: tuple[ImportedSubject, ...]
    diagnostics: tuple[Diagnostic, ...]


class ImportRequest(Data):
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


class ExportedPolicy(Data):
    """A policy in the language of another tool.

    Attributes:
        document: the policy.
        diagnostics: what is left out, and what the other tool adds, as warnings with ``file:line``.
        subjects: for each subject the rules that the document expresses, and what the other tool writes for it; none
            if no build type reads that.
    """

    document: bytes = field(repr=False)
    diagnostics: tuple[Diagnostic, ...] = ()
    subjects: tuple[ImportedSubject, ...] = ()


class LearnedPolicy(Data):
    """A policy learned from a graph.

    Attributes:
        document: the policy; empty if no rule is missing.
        fragments: files that it includes, by name in the requested folder.
        missing: edges of the graph that the document allows and the existing policy does not.
        conflicts: edges that a DENY rule of the existing policy denies, so that no new rule can allow them.
        unused: rules of the existing policy that no edge of the graph uses.
        notes: where an expression of the document stands for more than a name of the graph.
    """

    document: bytes
    fragments: Mapping[str, bytes]
    missing: tuple[Edge, ...]
    conflicts: tuple[Diagnostic, ...] = ()
    unused: tuple[Diagnostic, ...] = ()
    notes: tuple[Diagnostic, ...] = ()


class PolicyFormat(ABC):
    """Writes rules in a format of policies, under whose name it is registered.

    What a policy type writes (:meth:`PolicyType.exported`) is also proven to mean the same.
    """

    API: str
    """Version of the plugin interface, :data:`keymint.api.API_VERSION`."""
    TOOL: str = ""
    BUILD_TYPE: str = ""
    """The build type that reads what this tool writes from the policy, for a proof; empty if there is none."""

    @abstractmethod
    def exported(self, subjects: Sequence[SubjectRules], *, lossy: bool = False) -> ExportedPolicy:
        """Write rules in this format.

        Args:
            subjects: the rules of each subject.
            lossy: leave out what the format cannot express, where it only allows something.

        Raises:
            KeymintError: a rule cannot be expressed; each with its ``file:line``.
        """
