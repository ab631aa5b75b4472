# SPDX-License-Identifier: Apache-2.0
"""Find rules of the root enclave ``/`` that depend on its name: it has none, and its nodes have names of their own."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic
from keymint.analysis.findings import quoted_list
from keymint.analysis.subject_patterns import rules_of
from keymint.api import LoadedPolicy, PolicyStructure

ROOT_ENCLAVE = "/"
CODES = {"root-name": "A rule of the root enclave depends on the name of the subject."}
"""Diagnostic codes of this module with their descriptions."""


def root_names(policy: LoadedPolicy, written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield a warning for each rule of the root enclave that contains ``{name}`` or ``{namespace}``."""
    if ROOT_ENCLAVE not in policy.subjects():
        return
    depends = {each.rule.origin.spot for each in written.clauses if each.expand("/a/", "a") != each.expand("/b/", "b")}
    for rule in rules_of(policy, ROOT_ENCLAVE):
        if rule.origin.spot in depends:
            yield Diagnostic.warning(
                "root-name",
                f"the root enclave '/' has no name, so this {rule.effect} {rule.kind} rule is about "
                f"{quoted_list(rule.expressions)}, and about none of the nodes that use the enclave",
                rule.origin,
                "write the names of these nodes, with wildcards if they are not known, e.g. /*/get_parameters",
                ROOT_ENCLAVE,
            )
