# SPDX-License-Identifier: Apache-2.0
"""SROS2 policies as loaded policies, so that every verb that reads a policy can read them: an enclave is a profile."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

from keymint_comarmor.loaded import ComArmorPolicy

import comarmor
from comarmor.errors import ComArmorError
from comarmor.language.syntax import Attachment, Profile, ProfileRule
from keymint.api import PolicySource
from keymint.errors import KeymintError
from keymint_ros2_sros2.deviations import deviations
from keymint_ros2_sros2.parse import parse
from keymint_ros2_sros2.rules import rules_of
from keymint_ros2_sros2.syntax import Sros2Enclave


def load(
    sources: Sequence[PolicySource], library: Path | None = None, library_shown: Path | None = None
) -> ComArmorPolicy:
    """Load policies as one; see :meth:`keymint.api.PolicyType.load`.

    Raises:
        KeymintError: a policy is not valid, or SROS2 enforces something else than it reads; with ``file:line``.
    """
    del library, library_shown  # includes are in the policy's own folder
    seen: dict[Path, bytes] = {}
    profiles: dict[str, Profile] = {}
    for source in sources:
        policy = parse(source.path)
        if found := deviations(policy):
            raise KeymintError.of(found)
        seen |= policy.seen
        for enclave in policy.enclaves:
            if enclave.path in profiles:
                raise ComArmorError(
                    f"the enclave {enclave.path} is also at {profiles[enclave.path].where}", where=enclave.where,
                    help="write one <enclave>", code="sros2-path-twice",
                )  # fmt: skip
            profiles[enclave.path] = _profile(enclave, graph=policy.has_graph)
    return ComArmorPolicy(comarmor.Policy(tuple(profiles.values()), seen=MappingProxyType(seen)))


def _profile(enclave: Sros2Enclave, *, graph: bool) -> Profile:
    rules = (
        ProfileRule(
            rule.effect, rule.kind, rule.permissions,
            tuple(Attachment(expression, rule.origin) for expression in rule.expressions),
            rule.partitions, rule.audit, rule.origin,
        )
        for rule in rules_of([enclave], graph=graph)
    )  # fmt: skip
    where = enclave.where
    return Profile(enclave.path, False, (Attachment(enclave.path, where),), (), tuple(rules), where)
