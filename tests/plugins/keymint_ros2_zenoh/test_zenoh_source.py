# SPDX-License-Identifier: Apache-2.0
"""``zenoh.xml``: the router and the keystore, from a package's document and its defaults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from keymint_ros2_zenoh.settings import ZenohSettings
from keymint_ros2_zenoh.zenoh_source import packages, settings

from comarmor.errors import Origin
from keymint.api import PackageSources, Role, SourcePart, WorkspaceProfile
from keymint.errors import KeymintError

MANIFEST = Origin("src/talker/keymint_package.xml", 4)
OWN, DEFAULTS = "src/talker/zenoh.xml", "profile/package.defaults/zenoh.xml"
USUAL = """<zenoh>
  <router>
    <name>zenoh_router</name>
    <host>localhost</host>
    <port>7447</port>
  </router>
</zenoh>"""


def sources(defaults: str | None = USUAL, own: str | None = None, name: str = "talker") -> PackageSources:
    contents = [None if text is None else text.encode() for text in (own, defaults)]
    part = SourcePart("zenoh", OWN, contents[0], DEFAULTS, contents[1], "", MANIFEST)
    role = Role.INFRASTRUCTURE if name == "zenoh_router" else Role.SUBJECT
    return PackageSources(
        name, f"/{name}", role, "jazzy", {"zenoh": part}, ("ca",), frozenset(), "/ws/install", None, None
    )


def read(**fields: str | None) -> ZenohSettings:
    value = settings(sources(**fields)).value  # type: ignore[arg-type]
    assert isinstance(value, ZenohSettings)
    return value


def refused(given: PackageSources) -> list[tuple[str, str]]:
    with pytest.raises(KeymintError) as caught:
        settings(given)
    assert all(each.help or each.code == "schema" for each in caught.value.diagnostics)
    return [(each.code, str(each.where)) for each in caught.value.diagnostics]


def extensions(given: PackageSources) -> dict[str, str]:
    return {each.name: each.value for each in settings(given).extensions}


def test_defaults() -> None:
    found = read()
    assert (found.router.name, found.router.host, found.router.port) == ("zenoh_router", "localhost", 7447)
    assert found.router.origin == Origin(DEFAULTS, 4)
    assert found.keystore == "/ws/install"


def test_the_package_has_the_last_word() -> None:
    own = "<zenoh>\n<keystore>/opt/robot/</keystore><router>\n<host>robot1.local</host></router></zenoh>"
    found = read(own=own)
    assert (found.router.name, found.router.host, found.router.port) == ("zenoh_router", "robot1.local", 7447)
    assert found.router.origin == Origin(OWN, 3)
    assert found.keystore == "/opt/robot"


def test_certificates_of_nodes_are_for_clients_and_that_of_the_router_for_servers() -> None:
    assert extensions(sources()) == {"extendedKeyUsage": "clientAuth"}
    router = sources(name="zenoh_router")
    assert extensions(router) == {"extendedKeyUsage": "serverAuth", "subjectAltName": "DNS:localhost"}
    for host in ("10.0.0.7", "::1"):
        address = sources(USUAL.replace("localhost", host), name="zenoh_router")
        assert extensions(address)["subjectAltName"] == f"IP:{host}"


@pytest.mark.parametrize("host", ["a", "robot-1.local", "10.0.0.7", "fe80::1", "a" * 63, "1a.b"])
def test_hosts(host: str) -> None:
    assert read(defaults=USUAL.replace("localhost", host)).router.host == host


@pytest.mark.parametrize(
    "host",
    ["-a", "a-", "a..b", "a_b", "http://a", "a:7447", "a b", "10.0.0", "1.2.3.4.5", "a/b", "ü.de", "a" * 64, "[::1]",
     "0.0.0.0", "::", "224.0.0.1", "ff02::1", "fe80::1%eth0"],
)  # fmt: skip
def test_no_hosts(host: str) -> None:
    assert refused(sources(USUAL.replace("localhost", host))) == [("zenoh-host", f"{DEFAULTS}:4")]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("7447", "0"),
        ("7447", "65536"),
        ("7447", "x"),
        ("zenoh_router", "zenoh router"),
        ("zenoh_router", "/zenoh_router"),
        ("localhost", ""),
        ("<port>", "<door>7</door><port>"),
        ("</zenoh>", "<keystore>/a</keystore><keystore>/b</keystore></zenoh>"),
    ],
)
def test_the_schema(old: str, new: str) -> None:
    [(code, where), *_] = refused(sources(USUAL.replace(old, new)))
    assert code == "schema"
    assert where.startswith(f"{DEFAULTS}:")


@pytest.mark.parametrize("path", ["relative", "", "~/a", "/a/../b", "/a//b"])
def test_keystores(path: str) -> None:
    own = f"<zenoh><keystore>{path}</keystore></zenoh>"
    assert refused(sources(own=own)) == [("zenoh-keystore", f"{OWN}:1")]


def test_everything_that_is_missing_is_reported() -> None:
    assert refused(sources("<zenoh/>")) == [("zenoh-incomplete", f"{DEFAULTS}:1")] * 3
    assert refused(sources(None)) == [("file-missing", str(MANIFEST))]


@pytest.mark.parametrize("distro", ["ardent", "foxy", "galactic", "nonsense"])
def test_distributions_without_rmw_zenoh(distro: str) -> None:
    assert refused(replace(sources(), distro=distro)) == [("zenoh-distro", str(MANIFEST))]


@pytest.mark.parametrize("distro", ["humble", "jazzy", "rolling"])
def test_distributions_with_rmw_zenoh(distro: str) -> None:
    assert settings(replace(sources(), distro=distro))


def test_the_router_is_no_subject_of_the_policy() -> None:
    subject = replace(sources(name="zenoh_router"), role=Role.SUBJECT)
    assert refused(subject) == [("zenoh-router-name", f"{DEFAULTS}:3")]
    other = replace(sources(), role=Role.INFRASTRUCTURE)
    assert refused(other) == [("zenoh-router-name", f"{DEFAULTS}:3")]


def profile(distro: str = "jazzy", content: str | None = USUAL) -> WorkspaceProfile:
    files = {} if content is None else {"package.defaults/zenoh.xml": content.encode()}
    library = Path("ws/profile/comarmor.d")
    return WorkspaceProfile("p", "t", "t", "t", (), library, (), ("keymint_ros2_zenoh",), "sros2", distro, files)


def test_a_workspace_needs_a_package_of_the_router() -> None:
    assert packages(profile()) == {"zenoh_router": "the Zenoh router"}


@pytest.mark.parametrize(
    ("changed", "code", "where"),
    [
        (profile("foxy"), "zenoh-distro", "None"),
        (profile(content=None), "file-missing", "ws/profile/package.defaults/zenoh.xml"),
        (profile(content="<zenoh/>"), "zenoh-incomplete", "ws/profile/package.defaults/zenoh.xml:1"),
        (profile(content="<zeno/>"), "schema", "ws/profile/package.defaults/zenoh.xml:1"),
    ],
)
def test_profiles_without_a_router(changed: WorkspaceProfile, code: str, where: str) -> None:
    with pytest.raises(KeymintError) as caught:
        packages(changed)
    assert [(each.code, str(each.where)) for each in caught.value.diagnostics] == [(code, where)]
