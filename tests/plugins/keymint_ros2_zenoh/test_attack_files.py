# SPDX-License-Identifier: Apache-2.0
"""Files that the workspace's authority signed although they are unsafe: no proof holds for them.

The texts are changed as an attacker would, not through the compiler's data.
"""

from __future__ import annotations

import pytest
from keymint_ros2_zenoh.enclave_layout import ROUTER, SESSION
from keymint_ros2_zenoh.proving.enclave_proof import prove
from keymint_ros2_zenoh.proving.shared_proof import prove_shared

from keymint.api import Claim, Proof
from tests.plugins.keymint_ros2_zenoh.proving.test_installed import (
    files_of,
    router_files,
    shared_task,
    signed,
    task,
)

LISTEN = '["tls/localhost:7447"]'
TIME = '"timestamping": {"enabled": true}'


def changed(content: bytes, old: str, new: str) -> bytes:
    text = content.decode()
    assert old in text
    return text.replace(old, new, 1).encode()


def not_proven(claims: tuple[Claim, ...]) -> dict[str, Proof]:
    return {claim.action: claim.proof for claim in claims if claim.proof is not Proof.PROVEN}


def of_router(old: str, new: str) -> dict[str, Proof]:
    files = signed(changed(router_files()[ROUTER], old, new))
    return not_proven(prove_shared(shared_task(shared=files)))


def of_session(old: str, new: str) -> dict[str, Proof]:
    files = dict(files_of("/talker"))
    return not_proven(prove(task(files={**files, SESSION: changed(files[SESSION], old, new)})))


@pytest.mark.parametrize(
    "endpoint",
    [
        "tls/localhost:7447#root_ca_certificate_file=/tmp/ca.pem",
        "tls/localhost:7447#enable_mtls=false",
        "tls/localhost:7447?prio=1-3",
    ],
)
def test_a_listener_that_overrides_the_settings_of_tls(endpoint: str) -> None:
    """The first one admits certificates of another authority, with any common name; the second one admits anyone."""
    assert of_router(LISTEN, f'["{endpoint}"]') == {"route": Proof.COUNTEREXAMPLE}


@pytest.mark.parametrize(
    "setting",
    [
        '"plugins": {"rest": {}}',
        '"plugins": {"storage_manager": null}',
        '"plugins": {"rest": {"http_port": 8000}}',
        '"plugins_loading": {"enabled": true}',
        '"adminspace": {"enabled": true, "permissions": {"read": true, "write": true}}',
        '"routing": {"router": {"peers_failover_brokering": true}}',
        '"downsampling": [{"messages": ["put"], "rules": [{"key_expr": "**", "freq": 1}]}]',
        '"namespace": "robot2"',
        '"access_control/enabled": false',
        '"__config__": "/tmp/other.json5"',
    ],
)
def test_a_setting_that_is_not_known_is_not_proven_to_be_harmless(setting: str) -> None:
    assert of_router(TIME, f"{TIME}, {setting}") == {"route": Proof.UNKNOWN}
    assert of_session(TIME, f"{TIME}, {setting}") == {"connect": Proof.UNKNOWN}


@pytest.mark.parametrize("setting", ['"shared_memory": {"enabled": false},', '"tx": {"keep_alive": 2, "lease": 60000}'])
def test_a_setting_that_is_left_out_has_another_value(setting: str) -> None:
    other = '"rx": {"buffer_size": 65535}' if setting.startswith('"tx"') else ""
    assert of_router(setting, other) == {"route": Proof.UNKNOWN}


def test_a_session_that_knows_its_router_on_one_interface_only() -> None:
    """On any other interface nothing is exchanged, also not what the policy allows."""
    found = of_session('["/zenoh_router"]', '["/zenoh_router"], "interfaces": ["eth9"]')
    assert set(found.values()) == {Proof.UNKNOWN}
    assert {"put in", "declare subscriber out", "reply in"} <= set(found)


@pytest.mark.parametrize(
    "doubled",
    [
        '"access_control": {"enabled": false}',
        '"acc\\u0065ss_control": {"enabled": false}',
        "'access_control': {'enabled': false}",
    ],
)
def test_a_second_access_control_is_refused(doubled: str) -> None:
    from keymint.errors import KeymintError

    with pytest.raises(KeymintError, match="the key 'access_control' occurs twice"):
        of_router(TIME, f"{TIME}, {doubled}")


def test_a_reply_that_a_topic_needs_is_named_as_one_about_the_topic() -> None:
    keys = '\n        "key_exprs": ["0/chatter/*/*", "0/public/*'
    files = signed(changed(router_files()[ROUTER], f'["put", "reply"],{keys}', f'["put"],{keys}'))
    [found] = [claim.counterexample for claim in prove(task(shared=files)) if claim.counterexample]
    assert found.meaning is not None
    assert found.meaning.permission == "ros_publish"
