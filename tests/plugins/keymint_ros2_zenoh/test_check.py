# SPDX-License-Identifier: Apache-2.0
"""Findings on installed enclaves and on the router's file: each fault is found, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_zenoh import build_type
from keymint_ros2_zenoh.examine.enclaves import router_differences

from comarmor.errors import Severity
from keymint.api import Extension, Package, TrustAnchor
from keymint.pki import cms
from tests.effort import tries
from tests.plugins.examined import examined

from .enclaves import authority, inspection, installed, pem, shared, shared_inspection
from .workspaces import HOST_ORIGIN, LISTENER, TALKER, VALIDITY, package, workspace

PACKAGES = workspace(TALKER, LISTENER)
OWN_LISTENER, OWN_TALKER, OWN_ROUTER = PACKAGES
ROUTER, SIGNATURE = "zenoh/router.json5", "zenoh/router.json5.p7s"


@pytest.fixture(scope="module")
def talker() -> dict[str, bytes]:
    return installed(OWN_TALKER)


@pytest.fixture(scope="module")
def router() -> dict[str, bytes]:
    return shared(PACKAGES)


def codes(files: Mapping[str, bytes], own: Package = OWN_TALKER, **fields: Any) -> list[str]:
    return sorted(found.code for found in examined(build_type, inspection(own, files, **fields)))


def edited(files: Mapping[str, bytes], *changes: tuple[str, str]) -> dict[str, bytes]:
    """Return an enclave with another session file."""
    return {**files, "session.json5": _changed(files["session.json5"], *changes)}


def _changed(content: bytes, *changes: tuple[str, str]) -> bytes:
    text = content.decode()
    for old, new in changes:
        assert text.count(old) == 1, (old, text)
        text = text.replace(old, new)
    return text.encode()


@pytest.mark.parametrize("own", PACKAGES, ids=lambda each: each.name)
def test_what_was_just_installed_is_clean(own: Package) -> None:
    assert examined(build_type, inspection(own, installed(own))) == ()


def test_the_router_file_that_was_just_installed_is_clean(router: dict[str, bytes]) -> None:
    enclaves = {each.subject: installed(each) for each in PACKAGES}
    assert build_type.check_shared(shared_inspection(PACKAGES, router, enclaves=enclaves)) == ()


@pytest.mark.parametrize("name", ["cert.pem", "key.pem", "identity_ca.cert.pem", "session.json5"])
def test_missing_files(talker: dict[str, bytes], name: str) -> None:
    files = {file: content for file, content in talker.items() if file != name}
    assert "file-missing" in codes(files)


def test_a_missing_file_hides_nothing_about_the_others(talker: dict[str, bytes]) -> None:
    foreign = {**talker, "identity_ca.cert.pem": pem("permissions_ca")}
    del foreign["key.pem"]
    assert {"authority-differs", "file-missing"} <= set(codes(foreign))


def test_files_that_do_not_belong_together(talker: dict[str, bytes]) -> None:
    other = installed(OWN_LISTENER)
    assert codes({**talker, "key.pem": other["key.pem"]}) == ["key-mismatch"]
    assert codes({**talker, "cert.pem": other["cert.pem"]}) == ["certificate-subject", "key-mismatch"]
    foreign = installed(OWN_TALKER, chains={"identity": b"x", "access": b"x"})
    assert "authority-differs" in codes(foreign)
    extra = {**installed(OWN_ROUTER), "session.json5": talker["session.json5"]}
    assert codes(extra, OWN_ROUTER) == ["file-unexpected"]


def test_certificates_expire(talker: dict[str, bytes]) -> None:
    end = VALIDITY.not_after
    assert codes(talker, now=end - timedelta(days=3), within_days=7) == ["certificate-expires"]
    assert codes(talker, now=end + timedelta(days=3)) == ["certificate-expired"]
    assert codes(talker, now=VALIDITY.not_before - timedelta(days=1)) == ["certificate-not-yet-valid"]


@pytest.mark.parametrize(
    ("subject", "usage", "code", "severity"),
    [
        ("/talker", "serverAuth", "zenoh-key-usage", Severity.ERROR),
        ("/talker", "serverAuth, clientAuth", "zenoh-key-usage", Severity.WARNING),
        ("/zenoh_router", "clientAuth", "zenoh-key-usage", Severity.ERROR),
    ],
)
def test_usage_of_certificates(subject: str, usage: str, code: str, severity: Severity) -> None:
    own = {"/talker": OWN_TALKER, "/zenoh_router": OWN_ROUTER}[subject]
    others = tuple(each for each in own.identity.extensions if each.name != "extendedKeyUsage")
    odd = replace(own.identity, extensions=(Extension("extendedKeyUsage", usage, False, HOST_ORIGIN), *others))
    wrong = _files_of(replace(own, identity=odd), own)
    found = examined(build_type, inspection(own, wrong))
    assert [(each.code, each.severity) for each in found if each.severity is severity] == [(code, severity)]


def _files_of(holder: Package, own: Package) -> dict[str, bytes]:
    """Return the enclave of a package with the certificate of another specification."""
    from .enclaves import credentials

    secrets = credentials(holder)
    files = installed(own)
    return {**files, "cert.pem": secrets.certificate, "key.pem": secrets.key}


def test_the_certificate_of_the_router_names_its_host() -> None:
    usage = Extension("extendedKeyUsage", "serverAuth", False, HOST_ORIGIN)
    for names in ((), (Extension("subjectAltName", "DNS:other.local", False, HOST_ORIGIN),)):
        own = replace(OWN_ROUTER, identity=replace(OWN_ROUTER.identity, extensions=(usage, *names)))
        assert codes(_files_of(own, OWN_ROUTER), OWN_ROUTER) == ["zenoh-host-name"]


SESSION_FAULTS = [
    (('"mode": "client"', '"mode": "peer"'), "zenoh-mode"),
    (('{"endpoints": ["tls/localhost:7447"]}', '{"endpoints": ["tls/evil:7447"]}'), "zenoh-endpoint"),
    (("tls/localhost:7447", "tls/localhost:7447#verify_name_on_connect=false"), "zenoh-endpoint"),
    (('"listen": {"endpoints": []}', '"listen": {"endpoints": ["tcp/[::]:0"]}'), "zenoh-listen"),
    (('"gossip": {"enabled": false}', '"gossip": {"enabled": true}'), "zenoh-scouting"),
    (('"gossip": {"enabled": false}', '"gossip": {}'), "zenoh-scouting"),
    (('"multicast": {"enabled": false}', '"multicast": {"enabled": true}'), "zenoh-scouting"),
    (('"protocols": ["tls"]', '"protocols": ["tls", "tcp"]'), "zenoh-endpoint"),
    (('"enable_mtls": true', '"enable_mtls": false'), "zenoh-tls"),
    (('"verify_name_on_connect": true', '"verify_name_on_connect": false'), "zenoh-tls"),
    (('"close_link_on_expiration": true', '"close_link_on_expiration": false'), "zenoh-tls"),
    (("talker/identity_ca.cert.pem", "talker/other.pem"), "zenoh-tls"),
    (('"cert_common_names": ["/zenoh_router"]', '"cert_common_names": ["/listener"]'), "zenoh-router-pin"),
    (('"default_permission": "deny"', '"default_permission": "allow"'), "zenoh-default"),
    (('"enabled": true,\n    "default', '"enabled": false,\n    "default'), "zenoh-default"),
    (('"queries_default_timeout"', '"namespace": "a", "queries_default_timeout"'), "zenoh-setting"),
]


@pytest.mark.parametrize(
    ("change", "code"), SESSION_FAULTS, ids=lambda each: each[1] if isinstance(each, tuple) else ""
)
def test_faults_of_a_session(talker: dict[str, bytes], change: tuple[str, str], code: str) -> None:
    wrong = edited(talker, change)
    assert codes(wrong) == sorted(["drift", code])
    [found] = [each for each in examined(build_type, inspection(OWN_TALKER, wrong)) if each.code == code]
    assert found.where
    assert found.where.file == "install/enclaves/talker/session.json5"
    assert found.help
    assert found.where.line or change[1] == '"gossip": {}'


def test_a_session_with_a_wildcard_subject(talker: dict[str, bytes]) -> None:
    wrong = edited(talker, (', "cert_common_names": ["/zenoh_router"]', ""))
    assert codes(wrong) == ["drift", "zenoh-router-pin", "zenoh-wildcard-subject"]


def test_a_session_that_zenoh_refuses(talker: dict[str, bytes]) -> None:
    assert codes(edited(talker, ('"mode": "client"', '"mode": "clint"'))) == ["drift", "zenoh-configuration"]


def router_codes(files: Mapping[str, bytes], **fields: Any) -> list[str]:
    access = TrustAnchor("access", "public/permissions_ca.cert.pem", pem("permissions_ca"))
    anchored = router_differences(files, "install", access)
    own = build_type.check_shared(shared_inspection(PACKAGES, files, **fields))
    return sorted(each.code for each in (*own, *anchored))


def signed(content: bytes, by: str = "permissions_ca") -> dict[str, bytes]:
    signer = authority(by)
    return {ROUTER: content, SIGNATURE: cms.sign(content, signer.certificate, signer.key)}


ROUTER_FAULTS = [
    ([('"cert_common_names": ["/talker"]', '"cert_common_names": ["/robot/listener"]')],
     ["zenoh-common-name", "zenoh-common-name", "zenoh-subject-missing"]),
    ([(', "cert_common_names": ["/talker"]', "")], ["zenoh-subject-missing", "zenoh-wildcard-subject"]),
    ([('["/talker"]},', '["/talker"], "interfaces": ["lo"]},')], ["zenoh-subject"]),
    ([('"cert_common_names": ["/talker"]', '"cert_common_names": ["/talker", "/thief"]')],
     ["zenoh-common-name", "zenoh-subject-unknown"]),
    ([('"default_permission": "deny"', '"default_permission": "allow"')], ["zenoh-default"]),
    ([('"mode": "router"', '"mode": "peer"')], ["zenoh-mode"]),
    ([('["tls/localhost:7447"]', '["tls/localhost:7447", "tcp/[::]:7448"]')], ["zenoh-listen"]),
    ([('"connect": {"endpoints": []}', '"connect": {"endpoints": ["tls/far:7447"]}')], ["zenoh-endpoint"]),
    ([('"enable_mtls": true', '"enable_mtls": false')], ["zenoh-tls"]),
    ([('"close_link_on_expiration": true', '"close_link_on_expiration": false')], ["zenoh-tls"]),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "expected"), ROUTER_FAULTS)
def test_faults_of_the_router(router: dict[str, bytes], changes: list[tuple[str, str]], expected: list[str]) -> None:
    content = router[ROUTER].decode()
    if changes[0][0].endswith(","):
        changes = [(old.rstrip(","), new.rstrip(",")) for old, new in changes]
    for old, new in changes:
        assert old in content, old
        content = content.replace(old, new)
    found = router_codes(signed(content.encode()))
    assert found == sorted(["drift", *expected])


def test_signatures(router: dict[str, bytes]) -> None:
    assert router_codes({ROUTER: router[ROUTER]}) == ["file-missing"]
    assert router_codes({**router, SIGNATURE: b"?"}) == ["zenoh-signature"]
    assert router_codes(signed(router[ROUTER], by="other_ca")) == ["zenoh-signature"]
    older = shared(workspace(TALKER))
    assert router_codes({ROUTER: router[ROUTER], SIGNATURE: older[SIGNATURE]}) == ["zenoh-signature"]
    altered = {**router, ROUTER: router[ROUTER].replace(b"/chatter/", b"/chatten/")}
    assert router_codes(altered) == ["drift", "zenoh-signature"]


def test_a_router_file_that_was_signed_earlier() -> None:
    """Its signature is right, but it lacks an enclave, and has one that was removed."""
    removed = package(subject="/removed")
    earlier = shared(workspace(LISTENER, removed))
    assert router_codes(earlier) == ["drift", "zenoh-subject-missing", "zenoh-subject-unknown"]


def test_a_certificate_that_the_router_knows_by_another_name(router: dict[str, bytes]) -> None:
    other = installed(OWN_LISTENER)
    assert router_codes(router, enclaves={"/talker": other}) == ["zenoh-common-name"]
    assert router_codes(router, enclaves={"/talker": {"cert.pem": b"?"}}) == []


def test_a_router_file_that_zenoh_refuses(router: dict[str, bytes]) -> None:
    assert router_codes(signed(router[ROUTER] + b"x")) == ["drift", "json5-syntax"]


@pytest.mark.parametrize("name", [ROUTER, SIGNATURE])
def test_any_flipped_bit_of_the_router_file_is_found(router: dict[str, bytes], name: str) -> None:
    @settings(max_examples=tries(40, 80), deadline=None)
    @given(at=st.integers(0, len(router[name]) - 1), bit=st.integers(0, 7))
    def law(at: int, bit: int) -> None:
        content = bytearray(router[name])
        content[at] ^= 1 << bit
        assert "zenoh-signature" in router_codes({**router, name: bytes(content)})

    law()
