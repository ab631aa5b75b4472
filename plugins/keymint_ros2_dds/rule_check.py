# SPDX-License-Identifier: Apache-2.0
"""Check the rules of a subject alone: what cannot be compiled portably for all vendors, or compiles to nothing."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from keymint.api import BuildOptions
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from keymint_ros2_dds.build import build
from keymint_ros2_dds.rule_packages import package_of

_RELAYS = ("relay", "ros_relay")


def check_rules(rules: SubjectRules, distro: str) -> tuple[Diagnostic, ...]:
    """Return findings on the rules of a subject: see :meth:`keymint.api.BuildType.check_rules`."""
    try:
        built = build(package_of(rules, distro), BuildOptions()).diagnostics
    except KeymintError as error:
        built = error.diagnostics
    places = {rule.origin.spot for rule in rules.rules}
    of_rules = (each for each in built if each.where is not None and each.where.spot in places)
    return (*_relay_only(rules), *of_rules)


def _relay_only(rules: SubjectRules) -> Iterator[Diagnostic]:
    for rule in rules.rules:
        if rule.permissions and all(permission in _RELAYS for permission in rule.permissions):
            message = f"this {rule.effect} {rule.kind} rule only concerns relaying, which no DDS vendor enforces"
            help_ = "control who may publish and subscribe instead"
            yield Diagnostic.warning("portability-relay", message, rule.origin, help_, rules.subject)
