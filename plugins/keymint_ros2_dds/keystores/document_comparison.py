# SPDX-License-Identifier: Apache-2.0
"""Compare permissions documents of other tools with the rules of a policy, and with what is compiled from them."""

from __future__ import annotations

from collections.abc import Callable

from keymint.api import BuildOptions, Comparison, ComparisonTask, ImportedSubject
from keymint_ros2_dds.compiling.grant_compiler import compile_rules
from keymint_ros2_dds.decision import OMG
from keymint_ros2_dds.documents import permissions_document
from keymint_ros2_dds.enclave_layout import PERMISSIONS_XML
from keymint_ros2_dds.proving import prove_content
from keymint_ros2_dds.rule_packages import package_of


def compare(subject: ImportedSubject, distro: str, states: int, go_on: Callable[[], bool]) -> Comparison:
    """Return what is proven about both documents; see :meth:`keymint.api.ForeignDocuments.compare`.

    Raises:
        KeymintError: the document cannot be read, or a rule cannot be mapped.
    """
    package = package_of(subject.rules, distro)
    grant = package.grant
    compiled = compile_rules(grant, distro, BuildOptions(allow_vendor_specific=True))
    ours = permissions_document.render(grant, compiled.plain)

    def task(document: bytes, name: str) -> ComparisonTask:
        file = f"{subject.rules.subject}/{PERMISSIONS_XML}".lstrip("/")
        return ComparisonTask(document, file, 0, name, subject.rules, distro, grant.domains, states, go_on)

    return Comparison(
        prove_content(task(subject.document, subject.subject_name), lowered=compiled.lowered),
        prove_content(task(ours, grant.subject_name), models=(OMG.name,), lowered=compiled.lowered),
        compiled.diagnostics,
    )
