# SPDX-License-Identifier: Apache-2.0
"""All faults of all classes."""

from __future__ import annotations

from . import (
    faults_of_bundles,
    faults_of_keystores,
    faults_of_lists,
    faults_of_names,
    faults_of_permissions,
    faults_of_rollovers,
    faults_of_signers,
    faults_of_sources,
    faults_of_zenoh,
)
from .fault import Fault

TABLE: tuple[Fault, ...] = (
    *faults_of_names.FAULTS,
    *faults_of_permissions.FAULTS,
    *faults_of_signers.FAULTS,
    *faults_of_sources.FAULTS,
    *faults_of_lists.FAULTS,
    *faults_of_rollovers.FAULTS,
    *faults_of_keystores.FAULTS,
    *faults_of_bundles.FAULTS,
    *faults_of_zenoh.FAULTS,
)
