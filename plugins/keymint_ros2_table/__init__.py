# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_table``: the rows of a CSV file, or of a view of an SQLite database, are rules."""

from __future__ import annotations

from keymint.api import API_VERSION, PolicyType, lazy

__all__ = ["TablePolicyType", "policy_type"]


class TablePolicyType(PolicyType):
    """Reads tables with the columns subject, kind, permission, object, qualifier, audit and source."""

    API = API_VERSION
    NOUN = "a table of rules"

    load = lazy("keymint_ros2_table.policy:load")
    recognises = lazy("keymint_ros2_table.files:recognises")
    expectations = lazy("comarmor.language.loading:expectations")
    fingerprint = lazy("keymint_comarmor:file_fingerprint")


policy_type = TablePolicyType()
