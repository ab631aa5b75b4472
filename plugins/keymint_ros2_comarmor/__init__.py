# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_comarmor``: loads ComArmor policies, and learns them from graphs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import comarmor
import comarmor.language.source
from comarmor.rules import Expectation
from comarmor.xml.package_folders import PackageFolders
from keymint.api import API_VERSION, LearnedPolicy, LoadedPolicy, PolicyOfRules, PolicySource
from keymint.errors import KeymintError
from keymint.graph import Graph
from keymint.ir import SubjectRules

if TYPE_CHECKING:
    from keymint_comarmor.loaded import ComArmorPolicy

__all__ = ["ComArmorPolicyType", "policy_type"]


class ComArmorPolicyType:
    """Loads policies in the ComArmor language."""

    API = API_VERSION

    def load(
        self, sources: Sequence[PolicySource], library: Path | None, library_shown: Path | None = None
    ) -> ComArmorPolicy:
        """See :meth:`keymint.api.PolicyType.load`."""
        return self.load_with_packages(sources, library, library_shown, None)

    def load_with_packages(
        self,
        sources: Sequence[PolicySource],
        library: Path | None,
        library_shown: Path | None,
        packages: PackageFolders | None,
    ) -> ComArmorPolicy:
        """See :meth:`keymint.api.PackageIncludes.load_with_packages`; without packages none of their files is found."""
        for source in sources:
            if not source.path.exists():
                raise KeymintError(
                    f"the policy '{source.path}' does not exist",
                    where=source.origin,
                    help="name a ComArmor file, or a directory of *.xml files",
                    code="policy-missing",
                )
        from keymint_comarmor.loaded import ComArmorPolicy  # noqa: PLC0415 - a run without changes loads no policy

        paths = [source.path for source in sources]
        loaded = comarmor.load_all(paths, library=library, library_shown=library_shown, packages=packages)
        return ComArmorPolicy(loaded)

    def fingerprint(self, path: Path) -> bytes:
        """Return a digest of a path that changes when a policy loaded from it may change."""
        return comarmor.language.source.fingerprint(path)

    def expectations(self, path: Path) -> Mapping[Path, Sequence[Expectation]]:
        """Return the expectations in the ``*.test.xml`` files beside a policy, or in one such file."""
        from comarmor.language.policy_tests import expectations  # noqa: PLC0415 - only one verb needs it

        return expectations(path)

    def written_files(self, folder: Path) -> Sequence[Path]:
        """See :meth:`keymint.api.PolicyTypeWithForm.written_files`."""
        from comarmor.language.formatting import written_files  # noqa: PLC0415 - only one verb needs it

        return written_files(folder)

    def formatted(self, content: bytes, name: str) -> bytes | None:
        """See :meth:`keymint.api.PolicyTypeWithForm.formatted`."""
        from comarmor.language.formatting import formatted  # noqa: PLC0415 - only one verb needs it

        return formatted(content, name)

    def policy_of(self, subjects: Sequence[SubjectRules], name: str, note: str = "") -> PolicyOfRules:
        """See :func:`keymint_ros2_comarmor.policy_of_rules.policy_of`.

        Raises:
            KeymintError: an expression or the name of a subject cannot be written.
        """
        from keymint_ros2_comarmor.policy_of_rules import policy_of  # noqa: PLC0415 - few verbs need it

        return policy_of(subjects, name, note)

    def learn(self, graph: Graph, existing: LoadedPolicy | None, fragments: str) -> LearnedPolicy:
        """See :func:`keymint_ros2_comarmor.learn.learn`.

        Raises:
            KeymintError: the existing policy is not of this type.
        """
        from keymint_comarmor.loaded import ComArmorPolicy  # noqa: PLC0415 - as below

        from keymint_ros2_comarmor.learn import learn  # noqa: PLC0415 - only this verb needs it

        if existing is not None and not isinstance(existing, ComArmorPolicy):
            raise KeymintError("the existing policy is not a ComArmor policy", code="policy-type")
        return learn(graph, existing.policy if existing else None, fragments)


policy_type = ComArmorPolicyType()
