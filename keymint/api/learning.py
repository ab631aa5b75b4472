# SPDX-License-Identifier: Apache-2.0
"""Learn a policy from documents in force: a build type reads their rules, and a policy type writes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Protocol, runtime_checkable

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.api.foreign_keystores import FoundEnclave, KeystoreFiles
from keymint.api.packages import DomainRange
from keymint.ir import SubjectRules


@dataclass(frozen=True, slots=True)
class GrantedRules:
    """What the signed document of an enclave grants, as rules in which DENY overrides ALLOW.

    Attributes:
        rules: the rules of the subject; their places are those of the document.
        document: the document, unsigned; its signature was verified.
        file: its file as the user would type it.
        offset: number of lines before it in that file.
        subject_name: distinguished name of the identity, in the order of RFC 2253.
        domains: the domains in which the document permits anything.
        diagnostics: what a policy does not keep because it has no effect, as warnings.
    """

    rules: SubjectRules
    document: bytes = field(repr=False)
    file: str
    offset: int
    subject_name: str
    domains: tuple[DomainRange, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


@runtime_checkable
class GrantReader(Protocol):
    """Optional capability of a build type: reads the rules of signed documents."""

    def granted(self, keystore: KeystoreFiles, enclave: FoundEnclave, distro: str) -> GrantedRules:
        """Return what the signed document of an enclave grants.

        Names of the application take the place of those of the transport where the latter say so.

        Args:
            keystore: the keystore.
            enclave: an enclave in it.
            distro: ROS 2 distribution whose name mapping applies.

        Raises:
            KeymintError: the signature does not verify, the document cannot be read, or no policy can say what it
                grants; with ``file:line``.
        """


@dataclass(frozen=True, slots=True)
class PolicyOfRules:
    """A policy that was written from rules, and read again.

    Attributes:
        document: the policy.
        subjects: the rules of each subject as the document gives them.
    """

    document: bytes = field(repr=False)
    subjects: tuple[SubjectRules, ...]


@runtime_checkable
class PolicyWriter(Protocol):
    """Optional capability of a policy type: writes rules as a policy."""

    def policy_of(self, subjects: Sequence[SubjectRules], name: str, note: str = "") -> PolicyOfRules:
        """Write a policy in which each subject has its rules, and read it again.

        Args:
            subjects: rules of kinds and permissions that policies have; of several of one kind, the fewest are written.
            name: path of the new policy, as the user would type it, for the places of its rules.
            note: a comment for its head; empty for none.

        Raises:
            KeymintError: the format cannot express a rule.
        """
