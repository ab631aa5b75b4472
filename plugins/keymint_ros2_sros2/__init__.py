# SPDX-License-Identifier: Apache-2.0
"""Policy type ``keymint_ros2_sros2``: reads the policies of SROS2 (``policy.xml``), and translates them to ComArmor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from keymint.api import API_VERSION, PolicyType, lazy

__all__ = ["Sros2PolicyType", "policy_type"]

_BEGIN = 1 << 16
"""Bytes at the begin of a file that tell what it is."""


class Sros2PolicyType(PolicyType):
    """Reads SROS2 policies of the versions 0.1.0 and 0.2.0."""

    API = API_VERSION
    NOUN = "an SROS2 policy"
    TOOL = "SROS2"
    FORMAT = "sros2"
    BUILD_TYPE = "keymint_ros2_dds"

    fingerprint = lazy("keymint_comarmor:file_fingerprint")
    load = lazy("keymint_ros2_sros2.translate:load")
    exported = lazy("keymint_ros2_sros2.export:export_policy")
    translated = lazy("keymint_ros2_sros2.translate:translate_policy")

    def recognises(self, path: Path) -> bool:
        """Tell whether a file is an SROS2 policy, valid or not."""
        from lxml import etree  # noqa: PLC0415 - few verbs need it

        from comarmor.xml.sandboxed_paths import read_bounded  # noqa: PLC0415

        parser: Any = etree.XMLPullParser(("start",), resolve_entities=False, load_dtd=False, no_network=True)
        try:
            real = path.resolve(strict=True)
            parser.feed(read_bounded(real.parent, real, _BEGIN))
        except (OSError, RuntimeError, ValueError):
            return False
        except etree.XMLSyntaxError:
            pass  # what was read before is known
        root, *inner = [*(element for _, element in parser.read_events()), etree.Element("none")][:2]
        begins = root.get("version") is not None or any(each.tag == "enclaves" for each in inner)
        return root.tag == "policy" and begins


policy_type = Sros2PolicyType()
