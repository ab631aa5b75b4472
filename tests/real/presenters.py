# SPDX-License-Identifier: Apache-2.0
"""Participants of each vendor that present a permissions document of their choice to their peers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from keymint_ros2_dds.vendors import probe_builds
from keymint_ros2_dds.vendors.participants import CycloneDDS

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import Vendor

_FOLDER = Path(__file__).parent
_CYCLONEDDS = replace(probe_builds.CYCLONEDDS_NONCONFORMING, source=str(_FOLDER / "cyclonedds_presenter.c"))
_FASTDDS = probe_builds.Probe(
    "Fast DDS", str(_FOLDER / "fastdds_presenter.cpp"), ("g++", "c++"), "fastdds/rtps/common/Token.h",
    ("-std=gnu++14", "-shared", "-fPIC", "-ldl"), probe_builds.FAST_PACKAGES,
)  # fmt: skip


def presenting(vendor: Vendor, cache: Path, permissions: Path) -> Vendor:
    """Return a vendor whose participants that do not conform present a document.

    They check their own documents as usual. Whatever they present, their identity is that of their enclave.

    Args:
        vendor: the vendor.
        cache: folder of built programs.
        permissions: the signed document.
    """
    probe = _CYCLONEDDS if isinstance(vendor, CycloneDDS) else _FASTDDS
    if vendor.version is not None:
        probe = vendor.version.built(probe)
    environment = {**vendor.environment, "KEYMINT_PRESENTED": str(permissions)}
    return replace(vendor, environment=environment, nonconforming=probe.build(cache, {}))
