# SPDX-License-Identifier: Apache-2.0
"""Build type for DDS Security: rules to permissions and governance documents, signed, installed and checked."""

from __future__ import annotations

from functools import cached_property
from importlib import import_module
from typing import Any

from comarmor.rules import PERMISSIONS
from keymint.api import API_VERSION, BuildType, NameMapping, Presentation, Prover, lazy
from keymint_ros2_dds.enclave_layout import COPIED, LAYOUTS, PERMISSIONS_P7S, READS

__all__ = ["DdsSecurity", "build_type"]


class DdsProver(Prover):
    """Proofs about installed governance and permissions."""

    assumptions = lazy("keymint_ros2_dds.proving.claims:assumptions")
    differences = lazy("keymint_ros2_dds.examine.enclave_rules:differences")
    prove = lazy("keymint_ros2_dds.enclave_proof:prove")
    terms = lazy("keymint_ros2_dds.enclave_proof:terms")
    rights = lazy("keymint_ros2_dds.keystores.grants_as_rules:installed_rights")


class SignedPermissions(Presentation):
    """Participants present their signed permissions."""

    FILE = PERMISSIONS_P7S

    presented_until = lazy("keymint_ros2_dds.proving.presented:presented_until")
    choosers = lazy("keymint_ros2_dds.proving.presented:choosers")
    trusting_any_signer = lazy("keymint_ros2_dds.proving.presented:trusting_any_signer")
    excess = lazy("keymint_ros2_dds.proving.presented:excess")
    compared_with = lazy("keymint_ros2_dds.keystores.foreign_documents:compared_with")


class DdsNames(NameMapping):
    """Topics of DDS for the names of ROS."""

    endpoints = lazy("keymint_ros2_dds.lowering.endpoints:endpoints")
    meanings = lazy("keymint_ros2_dds.lowering.endpoints:meanings")
    document_topics = lazy("keymint_ros2_dds.transports.enclave_files:document_topics")


class DdsSecurity(BuildType):
    """The build type for DDS Security 1.1 as Cyclone DDS and Fast DDS implement it."""

    API = API_VERSION
    NOUN = "DDS topic"

    TRANSPORT = "dds"
    LAYOUTS = LAYOUTS
    READS = READS
    PARTS = ("governance",)
    COPIED = COPIED
    KINDS = tuple(PERMISSIONS)
    VENDORS = ("cyclonedds", "fastdds")
    prover = DdsProver()
    presentation = SignedPermissions()
    names = DdsNames()
    keystores: Any = cached_property(lambda _: import_module("keymint_ros2_dds.keystores").DdsKeystores())
    """Loads when it is asked for."""

    files = lazy("keymint_ros2_dds.enclave_layout:files")
    authorities = lazy("keymint_ros2_dds.enclave_layout:authorities")
    implementations = lazy("keymint_ros2_dds.enclave_layout:implementations")
    settings = lazy("keymint_ros2_dds.settings:settings")
    build = lazy("keymint_ros2_dds.build:build")
    install = lazy("keymint_ros2_dds.install:install")
    shared = lazy("keymint_ros2_dds.install:shared_files")
    revocation_files = lazy("keymint_ros2_dds.install:revocation_files")
    keystore_variables = lazy("keymint_ros2_dds.enclave_layout:keystore_variables")
    enclave_variables = lazy("keymint_ros2_dds.enclave_layout:enclave_variables")
    check = lazy("keymint_ros2_dds.examine.check:check")
    check_all = lazy("keymint_ros2_dds.examine.check:check_all")
    check_rules = lazy("keymint_ros2_dds.rule_check:check_rules")
    check_node = lazy("keymint_ros2_dds.rule_check:check_node")
    actions = lazy("keymint_ros2_dds.lowering.endpoints:actions")
    models = lazy("keymint_ros2_dds.proving.claims:models")
    installed_vendors = lazy("keymint_ros2_dds.vendors.advisories:installed_vendors")
    advisories = lazy("keymint_ros2_dds.vendors.advisories:advisories")
    distro_of = lazy("keymint_ros2_dds.transports.enclave_files:distro_of")


build_type = DdsSecurity()
