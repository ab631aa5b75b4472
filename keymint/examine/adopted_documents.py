# SPDX-License-Identifier: Apache-2.0
"""Judge the signed documents of a keystore that another tool made, by a policy and by whom they are for."""

from __future__ import annotations

from keymint.adoption.keystore_policy import Compared, differences
from keymint.api import FoundKeystore, Relation
from keymint.errors import Diagnostic, Origin


def policy_finding(compared: Compared) -> Diagnostic | None:
    """Return the finding on a document that is compared with the policy; None if both permit the same."""
    found = compared.comparison
    if found.relation is Relation.EQUAL:
        return None
    message = f"is {found.relation} in comparison with the policy: {differences(found) or found.reason}"
    if found.relation is Relation.UNKNOWN:
        message = f"cannot be compared with the policy: {found.reason}"
    help_ = "change the policy; or leave it out, so that a policy is made from what is signed"
    return Diagnostic.error("adopt-policy", message, Origin(compared.file), help_, compared.subject)


def unclear_rights(found: FoundKeystore) -> list[Diagnostic]:
    """Return the findings on a keystore because of which nobody can tell what its documents grant to a subject."""
    return [each for each in found.diagnostics if each.code in {"adopt-authorities", "adopt-doubled"}]
