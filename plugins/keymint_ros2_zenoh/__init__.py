# SPDX-License-Identifier: Apache-2.0
"""Build type for Zenoh: rules to the access control of one router and the configurations of its sessions."""

from __future__ import annotations

from comarmor.rules import PERMISSIONS
from keymint.api import API_VERSION, BuildType, Prover, lazy
from keymint_ros2_zenoh.enclave_layout import LAYOUTS, READS

__all__ = ["Zenoh", "build_type"]


class ZenohProver(Prover):
    """Proofs about the router's access control and the configurations of sessions."""

    differences = lazy("keymint_ros2_zenoh.examine.enclaves:differences")
    terms = lazy("keymint_ros2_zenoh.examine.enclaves:terms")
    assumptions = lazy("keymint_ros2_zenoh.proving.enclave_proof:assumptions")
    prove = lazy("keymint_ros2_zenoh.proving.enclave_proof:prove")
    rights = lazy("keymint_ros2_zenoh.proving.granted_rights:rights")


class Zenoh(BuildType):
    """The build type for Zenoh's access control, as rmw_zenoh uses Zenoh."""

    API = API_VERSION
    NOUN = "key expression"
    KNOWS_COMMON_NAMES_ONLY = True

    TRANSPORT = "zenoh"
    PARTS = ("zenoh",)
    SHARES = True
    INFRASTRUCTURE = True
    LAYOUTS = LAYOUTS
    READS = READS
    KINDS = tuple(kind for kind in PERMISSIONS if kind != "topic")  # no key expression stands for a raw topic
    prover = ZenohProver()

    files = lazy("keymint_ros2_zenoh.enclave_layout:files")
    packages = lazy("keymint_ros2_zenoh.zenoh_source:packages")
    settings = lazy("keymint_ros2_zenoh.zenoh_source:settings")
    authorities = lazy("keymint_ros2_zenoh.settings:authorities")
    implementations = lazy("keymint_ros2_zenoh.settings:implementations")
    build = lazy("keymint_ros2_zenoh.build:build")
    install = lazy("keymint_ros2_zenoh.install:install")
    keystore_variables = lazy("keymint_ros2_zenoh.enclave_layout:keystore_variables")
    enclave_variables = lazy("keymint_ros2_zenoh.enclave_layout:enclave_variables")
    check = lazy("keymint_ros2_zenoh.examine.enclaves:check")
    build_shared = lazy("keymint_ros2_zenoh.build:build_shared")
    install_shared = lazy("keymint_ros2_zenoh.install:install_shared")
    check_shared = lazy("keymint_ros2_zenoh.examine.enclaves:check_shared")
    actions = lazy("keymint_ros2_zenoh.lowering.permissions:actions")
    installed_names = lazy("keymint_ros2_zenoh.transports.enclave_model:installed_names")
    check_rules = lazy("keymint_ros2_zenoh.lowering.key_rules:check_rules")
    prove_shared = lazy("keymint_ros2_zenoh.proving.shared_proof:prove_shared")


build_type = Zenoh()
