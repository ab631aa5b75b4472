# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_comarmor``: loads ComArmor policies, and learns them from graphs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from keymint_comarmor import require_policies

import comarmor
from comarmor.xml.package_folders import PackageFolders
from keymint.api import API_VERSION, PolicySource, PolicyType, lazy

if TYPE_CHECKING:
    from keymint_comarmor.loaded import ComArmorPolicy

__all__ = ["ComArmorPolicyType", "policy_type"]


class ComArmorPolicyType(PolicyType):
    """Loads policies in the ComArmor language."""

    API = API_VERSION

    def load(
        self,
        sources: Sequence[PolicySource],
        library: Path | None,
        library_shown: Path | None = None,
        packages: PackageFolders | None = None,
    ) -> ComArmorPolicy:
        """See :meth:`keymint.api.PolicyType.load`."""
        require_policies(sources, "a ComArmor file, or a directory of *.xml files")
        from keymint_comarmor.loaded import ComArmorPolicy  # noqa: PLC0415 - a run without changes loads no policy

        paths = [source.path for source in sources]
        loaded = comarmor.load(*paths, library=library, library_shown=library_shown, packages=packages)
        return ComArmorPolicy(loaded)

    fingerprint = lazy("comarmor.language.source:fingerprint")
    expectations = lazy("comarmor.language.loading:expectations")
    written_files = lazy("comarmor.language.formatting:written_files")
    formatted = lazy("comarmor.language.formatting:canonical_form")
    policy_of = lazy("keymint_ros2_comarmor.policy_documents:policy_of")
    learn = lazy("keymint_ros2_comarmor.policy_documents:learn")


policy_type = ComArmorPolicyType()
