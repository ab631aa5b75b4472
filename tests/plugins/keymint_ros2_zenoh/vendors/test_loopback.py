# SPDX-License-Identifier: Apache-2.0
"""What is changed of installed configurations to run them on loopback."""

from __future__ import annotations

from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.vendors import loopback


def test_a_router_listens_on_another_port_of_loopback_by_the_same_protocol() -> None:
    changes = loopback.router_changes(["tls/[::]:7447", "quic/0.0.0.0:7448#x=1"], {"7447": "1", "7448": "2"})
    assert changes == {"listen/endpoints": ["tls/127.0.0.1:1", "quic/127.0.0.1:2#x=1"]}


def test_a_session_keeps_a_host_that_is_this_machine_and_the_check_of_its_name() -> None:
    assert loopback.session_changes(["tls/localhost:7447"], {"7447": "1"}) == {"connect/endpoints": ["tls/localhost:1"]}


def test_a_session_connects_to_another_host_here_without_the_check_of_the_name() -> None:
    assert loopback.session_changes(["tls/robot.local:7447"], {"7447": "1"}) == {
        "connect/endpoints": ["tls/localhost:1"],
        "transport/link/tls/verify_name_on_connect": False,
    }


def test_a_port_that_the_router_does_not_have_stays() -> None:
    assert loopback.session_changes(["tls/localhost:9"], {"7447": "1"}) == {"connect/endpoints": ["tls/localhost:9"]}


def test_only_paths_that_are_set_and_found_here_change() -> None:
    settings = Configuration(connect_certificate="/robot/cert.pem", root_ca="/gone").settings()
    changes = loopback.path_changes(settings, {"/robot/cert.pem": "/here/cert.pem"}.get)
    assert changes == {"transport/link/tls/connect_certificate": "/here/cert.pem"}


def test_hosts_and_ports_of_endpoints() -> None:
    endpoints = ["tls/[::1]:7447", "tcp/host:1#a=b:2", "tls/host", "nonsense"]
    assert [loopback.host(each) for each in endpoints] == ["::1", "host", "host", ""]
    assert [loopback.port(each) for each in endpoints] == ["7447", "1", "", ""]
