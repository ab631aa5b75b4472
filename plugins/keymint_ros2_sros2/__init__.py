# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_sros2``: reads the policies of SROS2 (``policy.xml``), and translates them to ComArmor."""

from __future__ import annotations

from pathlib import Path

from keymint_comarmor import file_fingerprint

from keymint.api import API_VERSION
from keymint.api.lazy import lazy

__all__ = ["Sros2PolicyType", "policy_type"]

_MOST = 16 * 2**20
"""Bytes of a file that may be a policy."""


class Sros2PolicyType:
    """Reads SROS2 policies of the versions 0.1.0 and 0.2.0.

    Implements :class:`keymint.api.PolicyType`, :class:`keymint.api.RecognisedPolicy`,
    :class:`keymint.api.PolicyImporter` and :class:`keymint.api.PolicyExporter`.
    """

    API = API_VERSION
    NOUN = "an SROS2 policy"
    TOOL = "SROS2"
    FORMAT = "sros2"
    BUILD_TYPE = "keymint_ros2_dds"

    fingerprint = staticmethod(file_fingerprint)
    load = lazy("keymint_ros2_sros2.loaded:load")
    exported = lazy("keymint_ros2_sros2.export:exported")
    translated = lazy("keymint_ros2_sros2.translate:translated")

    def recognises(self, path: Path) -> bool:
        """Tell whether a file is an SROS2 policy, valid or not."""
        from comarmor.errors import ComArmorError  # noqa: PLC0415 - few verbs need it
        from comarmor.xml.reader import parse  # noqa: PLC0415
        from comarmor.xml.sandboxed_paths import read_bounded  # noqa: PLC0415

        try:
            real = path.resolve(strict=True)
            root = parse(read_bounded(real.parent, real, _MOST + 1), path.name)
        except (OSError, RuntimeError, ValueError, ComArmorError):
            return False
        return root.tag == "policy" and (root.get("version") is not None or root.find("enclaves") is not None)


policy_type = Sros2PolicyType()
