# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_table``: the rows of a CSV file, or of a view of an SQLite database, are rules."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from comarmor.rules import Expectation
from keymint.api import API_VERSION
from keymint.api.lazy import lazy

__all__ = ["TablePolicyType", "policy_type"]


class TablePolicyType:
    """Reads tables with the columns subject, kind, permission, object, qualifier, audit and source.

    Implements :class:`keymint.api.PolicyType`, :class:`keymint.api.PolicyTypeWithTests` and
    :class:`keymint.api.RecognisedPolicy`.
    """

    API = API_VERSION
    NOUN = "a table of rules"

    load = lazy("keymint_ros2_table.policy:load")
    recognises = lazy("keymint_ros2_table.files:recognises")

    def fingerprint(self, path: Path) -> bytes:
        """Return a digest of a path that changes when a policy loaded from it may change; empty if it is unreadable."""
        try:
            return hashlib.sha256(path.read_bytes()).digest()
        except OSError:
            return b""

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the ``*.test.xml`` files beside a table, or in one such file."""
        from comarmor.language.policy_tests import expectations  # noqa: PLC0415 - only one verb needs it

        return expectations(path)


policy_type = TablePolicyType()
