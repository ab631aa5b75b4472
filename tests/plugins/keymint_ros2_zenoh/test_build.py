# SPDX-License-Identifier: Apache-2.0
"""What is built has the sound shape, whatever the policy says; what cannot be sound is refused with its place."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_zenoh.build import build, build_shared
from keymint_ros2_zenoh.documents.configuration import Configuration, Flow, Message, Permission
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.examine import configurations
from keymint_ros2_zenoh.identities import check_identity
from keymint_ros2_zenoh.lowering.key_rules import combined_rules, lower_package
from keymint_ros2_zenoh.settings import Router

from comarmor.errors import Severity
from keymint.api import Authority, BuildOptions, Extension, KeySpec, Package, Validity
from keymint.errors import KeymintError
from keymint.ir import Rule

from .workspaces import (
    HOST_ORIGIN,
    KEYSTORE,
    LISTENER,
    P256,
    ROUTER,
    TALKER,
    VALIDITY,
    package,
    router_package,
    rule,
    workspace,
)

OPTIONS = BuildOptions()
ANY_USAGE = "anyExtendedKeyUsage"


def session(package_: Package) -> Configuration:
    [own] = [each for each in workspace(package_) if each.name == package_.name]
    return read(build(own, OPTIONS).documents["session.json5"], "session.json5")


def router(*packages: Package) -> Configuration:
    built = build_shared(workspace(*packages), OPTIONS)
    assert list(built.documents) == ["zenoh/router.json5"]
    return read(built.documents["zenoh/router.json5"], "router.json5")


def refused(make: Callable[[], object]) -> dict[str, str]:
    """Return the places of the errors by code."""
    with pytest.raises(KeymintError) as caught:
        make()
    return {each.code: str(each.where) for each in caught.value.diagnostics}


def test_a_session_is_a_client_of_the_router_alone() -> None:
    found = session(TALKER)
    assert found.mode == "client"
    assert found.connect == ("tls/localhost:7447",)
    assert found.listen == ()
    assert not found.gossip
    assert not found.multicast
    assert found.protocols == ("tls",)
    assert found.mutual
    assert found.verify_name
    assert found.close_expired
    assert found.root_ca == f"{KEYSTORE}/enclaves/talker/identity_ca.cert.pem"
    assert found.connect_certificate == f"{KEYSTORE}/enclaves/talker/cert.pem"
    assert found.connect_key == f"{KEYSTORE}/enclaves/talker/key.pem"
    control = found.access_control
    assert (control.enabled, control.default_permission) == (True, Permission.DENY)
    assert [subject.cert_common_names for subject in control.subjects] == [("/zenoh_router",)]
    assert [(set(each.messages), set(each.flows)) for each in control.rules] == [(set(Message), set(Flow))]
    assert found.other["timestamping/enabled"] is True


def test_a_session_depends_on_no_rule() -> None:
    other = package(rule("DENY", "ros_topic", "ros_publish", "/a"))
    documents = [build(workspace(each)[0], OPTIONS).documents for each in (TALKER, other)]
    assert documents[0] == documents[1]


def test_the_router_denies_by_default_and_knows_each_enclave_by_one_common_name() -> None:
    found = router(TALKER, LISTENER)
    assert found.mode == "router"
    assert found.listen == ("tls/localhost:7447",)
    assert found.connect == ()
    assert found.listen_certificate == f"{KEYSTORE}/enclaves/zenoh_router/cert.pem"
    assert found.mutual
    assert found.close_expired
    control = found.access_control
    assert (control.enabled, control.default_permission) == (True, Permission.DENY)
    assert [subject.cert_common_names for subject in control.subjects] == [("/robot/listener",), ("/talker",)]
    assert [policy.subjects for policy in control.policies] == [("/robot/listener",), ("/talker",)]
    rules = {each.id: each for each in control.rules}
    for policy in control.policies:
        assert all(name.startswith(f"{policy.subjects[0]} ") for name in policy.rules)
        tokens = [
            key
            for name in policy.rules
            for key in rules[name].key_exprs
            if Message.LIVELINESS_TOKEN in rules[name].messages and Flow.INGRESS in rules[name].flows
        ]
        own = policy.subjects[0].replace("/", "%")
        assert {key for key in tokens if key.startswith("@ros2_lv")} == {f"@ros2_lv/0/*/*/*/*/{own}/**"}


RULES = st.builds(
    rule,
    st.sampled_from(["ALLOW", "DENY"]),
    st.just("ros_topic"),
    st.sampled_from(["ros_publish", "ros_subscribe", "ros_publish ros_subscribe"]),
    st.sampled_from(["/a", "/a*", "*", "/a/*/b", "/[ab]c"]),
)


@given(st.lists(RULES, max_size=5), st.lists(RULES, max_size=5))
def test_every_policy_gives_the_sound_shape(first: list[Rule], second: list[Rule]) -> None:
    packages = package(*first), package(*second, subject="/b")
    found = router(*packages)
    assert not [*configurations.open_default(found), *configurations.entries(found)]
    assert len(found.access_control.subjects) == 2
    rules = {each.id: each for each in found.access_control.rules}
    for policy, own in zip(found.access_control.policies, sorted(packages, key=lambda each: each.name), strict=True):
        written = [
            (rules[name].permission, rules[name].messages, rules[name].flows, rules[name].key_exprs)
            for name in policy.rules
        ]
        lowered = combined_rules(lower_package(own)[0])
        assert [keys for *_, keys in written] == [each.key_exprs for each in lowered]
        assert [(messages, flows) for _, messages, flows, _ in written] == [
            (each.messages, each.flows) for each in lowered
        ]
        assert [permission for permission, *_ in written] == [each.permission for each in lowered]


def test_fewer_rules_are_reported_with_the_size_of_all_of_them() -> None:
    packages = workspace(package(*(rule("ALLOW", "ros_topic", "ros_publish", f"/t{n}") for n in range(9))))
    built, plain = (build_shared(packages, BuildOptions(optimise=each)) for each in (True, False))
    [name] = built.documents
    assert len(built.documents[name]) < len(plain.documents[name]) == built.plain_sizes[name]
    assert not plain.plain_sizes


def test_the_same_packages_give_the_same_bytes() -> None:
    first, second = (build_shared(workspace(*each), OPTIONS) for each in ((TALKER, LISTENER), (LISTENER, TALKER)))
    assert first.documents == second.documents


@pytest.mark.parametrize(
    ("host", "connect", "listen"),
    [
        ("localhost", "tls/localhost:7447", "tls/localhost:7447"),
        ("127.0.0.1", "tls/127.0.0.1:7447", "tls/127.0.0.1:7447"),
        ("::1", "tls/[::1]:7447", "tls/[::1]:7447"),
        ("robot1.local", "tls/robot1.local:7447", "tls/[::]:7447"),
        ("10.0.0.7", "tls/10.0.0.7:7447", "tls/[::]:7447"),
        ("fe80::7", "tls/[fe80::7]:7447", "tls/[::]:7447"),
    ],
)
def test_a_router_listens_beyond_its_machine_only_if_its_host_is_there(host: str, connect: str, listen: str) -> None:
    own = replace(ROUTER, host=host)
    packages = workspace(package(router=own), router=router_package(router=own))
    [talker, _] = packages
    assert read(build(talker, OPTIONS).documents["session.json5"], "s").connect == (connect,)
    document = build_shared(packages, OPTIONS).documents["zenoh/router.json5"]
    assert read(document, "r").listen == (listen,)


def test_the_router_has_no_document_of_its_own() -> None:
    assert build(workspace(TALKER)[1], OPTIONS).documents == {}


def test_rules_that_zenoh_cannot_express_are_refused_by_both_stages() -> None:
    bad = package(rule("ALLOW", "topic", "publish", "rt/x", line=12))
    for make in (lambda: build(workspace(bad)[0], OPTIONS), lambda: build_shared(workspace(bad), OPTIONS)):
        assert refused(make) == {"zenoh-raw-topic": "policy.xml:12"}


def test_a_router_without_enclaves_is_warned_of() -> None:
    [found] = build_shared(workspace(), OPTIONS).diagnostics
    assert (found.code, found.severity) == ("zenoh-enclaves", Severity.WARNING)
    assert not build_shared(workspace(TALKER), OPTIONS).diagnostics


def test_notes_about_rules_are_reported() -> None:
    graph = package(rule("ALLOW", "topic", "publish subscribe", "ros_discovery_info"))
    [note] = build(workspace(graph)[0], OPTIONS).diagnostics
    assert (note.code, note.severity) == ("zenoh-infrastructure", Severity.NOTE)


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"key": KeySpec("ec", "SECP521R1")}, "zenoh-key-curve"),
        ({"key": KeySpec("ec", "SECP256R1", uri="pkcs11:token=robot;id=%01")}, "zenoh-key-token"),
        ({"name": "OU=x1"}, "zenoh-common-name"),
        ({"extensions": (Extension("extendedKeyUsage", "serverAuth", False, HOST_ORIGIN),)}, "zenoh-key-usage"),
        ({"extensions": (Extension("extendedKeyUsage", ANY_USAGE, False, HOST_ORIGIN),)}, "zenoh-key-usage"),
        ({"validity": Validity(VALIDITY.not_before, VALIDITY.not_before)}, "zenoh-validity"),
    ],
)
def test_what_zenoh_refuses_is_refused(changed, code: str) -> None:
    assert list(refused(lambda: build(workspace(package(**changed))[0], OPTIONS))) == [code]


def test_the_key_of_an_authority_counts_too() -> None:
    authority = Authority("root_ca", replace(TALKER.identity, key=KeySpec("ec", "SECP521R1")))
    [own] = [replace(each, issuers=(authority,)) for each in workspace(TALKER) if each.name == "talker"]
    assert list(refused(lambda: build(own, OPTIONS))) == ["zenoh-key-curve"]


@pytest.mark.parametrize(
    ("key", "digest", "errors"),
    [
        (P256, "SHA384", []),
        (P256, "SHA512", ["zenoh-key-hash"]),
        (KeySpec("ec", "SECP384R1"), "SHA512", ["zenoh-key-hash"]),
        (KeySpec("rsa", size=2048), "SHA512", []),
    ],
)
def test_signatures_that_zenoh_does_not_verify(key: KeySpec, digest: str, errors: list[str]) -> None:
    """The root's own signature does not count."""
    identity = replace(TALKER.identity, hash_algorithm=digest)
    root = Authority("root_ca", replace(TALKER.identity, key=key, hash_algorithm="SHA512"))
    own = replace(TALKER, identity=identity, issuers=(root,), infrastructure=(router_package(),))
    assert [each.code for each in check_identity(own)] == errors


@pytest.mark.parametrize(
    ("host", "names", "fits"),
    [
        ("localhost", "DNS:other.example.com", False),
        ("localhost", "DNS:other.example.com, DNS:LOCALHOST", True),
        ("10.0.0.7", "DNS:10.0.0.7", False),
        ("fe80::1", "IP:10.0.0.7,IP:fe80:0::1", True),
    ],
)
def test_own_names_of_the_router_include_its_host(host: str, names: str, fits: bool) -> None:
    own = router_package(
        router=replace(ROUTER, host=host),
        extensions=(Extension("subjectAltName", names, False, HOST_ORIGIN),),
    )
    if fits:
        assert not build(own, OPTIONS).diagnostics
    else:
        assert refused(lambda: build(own, OPTIONS)) == {"zenoh-host-name": str(HOST_ORIGIN)}


@pytest.mark.parametrize("subject", ["/talker", "/zenoh_router"])
def test_a_certificate_for_both_sides_is_a_warning(subject: str) -> None:
    both = (Extension("extendedKeyUsage", "serverAuth, clientAuth", False, HOST_ORIGIN),)
    own = package(subject=subject, extensions=both)
    [found] = build(replace(own, infrastructure=(router_package(),)), OPTIONS).diagnostics
    assert (found.code, found.severity) == ("zenoh-key-usage", Severity.WARNING)


def test_two_packages_with_one_common_name() -> None:
    same = package(subject="/other", name="CN=/talker,OU=x2")
    with pytest.raises(KeymintError) as caught:
        router(TALKER, same)
    [found] = caught.value.diagnostics
    assert found.code == "zenoh-common-name"
    assert "/talker and /other" in found.message
    assert "src/other/identities.xml:3" in str(found)
    assert "src/talker/identities.xml:3" in str(found)


def test_no_enclave_has_the_common_name_of_the_router() -> None:
    false = package(subject="/other", name="CN=/zenoh_router,OU=x2")
    assert refused(lambda: router(false)) == {"zenoh-common-name": "src/other/identities.xml:3"}


def test_a_shortened_common_name_is_the_one_that_counts() -> None:
    found = router(package(subject="/very/deep/talker", name="CN=/deep/talker,OU=x2"))
    [subject] = found.access_control.subjects
    assert (subject.id, subject.cert_common_names) == ("/very/deep/talker", ("/deep/talker",))


def test_one_router_one_signer_and_one_issuer_for_all() -> None:
    elsewhere = package(subject="/other", router=Router("zenoh_router", "other.local", 7447, HOST_ORIGIN))
    assert refused(lambda: router(TALKER, elsewhere)) == {"zenoh-routers": str(HOST_ORIGIN)}
    signer = package(subject="/other", issuer="other_ca")
    assert refused(lambda: router(TALKER, signer)) == {"zenoh-signers": "policy.xml:7"}
    issuer = replace(package(subject="/other"), identity=replace(package(subject="/other").identity, issuer="other_ca"))
    assert refused(lambda: router(TALKER, issuer)) == {"zenoh-issuers": "src/other/identities.xml:3"}


def test_without_a_package_of_the_router() -> None:
    assert refused(lambda: build(TALKER, OPTIONS)) == {"zenoh-router-missing": str(HOST_ORIGIN)}
    assert refused(lambda: build_shared([TALKER], OPTIONS)) == {"zenoh-router-missing": str(HOST_ORIGIN)}
    assert build_shared([], OPTIONS).documents == {}


def test_zenoh_reads_every_setting(zenoh: ModuleType) -> None:
    """Zenoh refuses a setting that it does not know."""
    packages = workspace(TALKER, LISTENER)
    for content in (
        build_shared(packages, OPTIONS).documents["zenoh/router.json5"],
        build(packages[0], OPTIONS).documents["session.json5"],
    ):
        config = zenoh.Config.from_json5(content.decode())
        for path, value in read(content, "f").other.items():
            assert json.loads(config.get_json(path)) == value
        with pytest.raises(zenoh.ZError):
            zenoh.Config.from_json5(content.decode().replace('"timestamping"', '"time_stamping"'))
