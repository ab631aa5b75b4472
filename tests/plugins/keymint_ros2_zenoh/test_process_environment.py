# SPDX-License-Identifier: Apache-2.0
"""The environment variables of rmw_zenoh."""

from __future__ import annotations

from pathlib import Path

from keymint_ros2_zenoh import build_type
from keymint_ros2_zenoh.enclave_layout import SESSION, enclave_variables, files, keystore_variables

from keymint.stages.environment_scripts import variable_values

ROUTER = {"ZENOH_ROUTER_CONFIG_URI": "/k/zenoh/router.json5"}


def test_all_processes_find_the_router() -> None:
    assert variable_values(keystore_variables("jazzy", "sros2"), Path("/k")) == ROUTER


def test_a_session_and_the_router() -> None:
    session = enclave_variables("jazzy", "sros2", "/r/talker", files("sros2"))
    assert variable_values(session, Path("/k")) == {"ZENOH_SESSION_CONFIG_URI": "/k/enclaves/r/talker/session.json5"}
    router = enclave_variables("jazzy", "sros2", "/zenoh_router", files("sros2") - {SESSION})
    assert variable_values(router, Path("/k")) == ROUTER


def test_the_build_type_has_them() -> None:
    assert build_type.keystore_variables("jazzy", "sros2") == keystore_variables("jazzy", "sros2")
