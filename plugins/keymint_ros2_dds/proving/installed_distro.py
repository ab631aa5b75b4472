# SPDX-License-Identifier: Apache-2.0
"""Tell for which distribution signed documents were made."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress

from keymint.errors import KeymintError
from keymint.pki import smime
from keymint_ros2_dds.decision import read
from keymint_ros2_dds.enclave_layout import PERMISSIONS_P7S
from keymint_ros2_dds.lowering.dds_topics import DDS_TOPICS

_OF_ARDENT = frozenset(topic.prefix for topics in DDS_TOPICS.values() for topic in topics if topic.prefix)


def distro_of(paths: Iterable[str], content: Callable[[str], bytes | None]) -> str:
    """Return ``ardent`` if documents have its partitions; see :meth:`keymint.api.BuildType.distro_of`.

    Only Ardent maps the namespace of a name to a partition; see :mod:`keymint_ros2_dds.lowering.ardent_names`.
    """
    for path in paths:
        with suppress(KeymintError):
            found = content(path) if path.endswith(f"/{PERMISSIONS_P7S}") else None
            grants = read(smime.signed_content(found), PERMISSIONS_P7S).grants if found else ()
            criteria = (one for grant in grants for rule in grant.rules for one in rule.criteria)
            if any(name.partition("/")[0] in _OF_ARDENT for one in criteria for name in one.partitions or ()):
                return "ardent"
    return ""
