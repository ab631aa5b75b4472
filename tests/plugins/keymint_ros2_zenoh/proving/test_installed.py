# SPDX-License-Identifier: Apache-2.0
"""Proofs about installed files: sound ones are proven, and each fault in them is found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from keymint_ros2_zenoh.documents.configuration import (
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Configuration,
    Flow,
    Message,
    Permission,
    write,
)
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SESSION, SIGNATURE
from keymint_ros2_zenoh.examine.enclaves import differences, terms
from keymint_ros2_zenoh.proving.enclave_proof import ASSUMPTIONS, prove
from keymint_ros2_zenoh.proving.shared_proof import prove_shared

from keymint.api import Claim, EnclaveFiles, Package, Proof, ProofTask, SharedProofTask, TrustAnchor, TrustAnchors
from keymint.errors import KeymintError
from keymint.pki import cms
from tests.plugins.keymint_ros2_zenoh.enclaves import authority, installed, pem, shared
from tests.plugins.keymint_ros2_zenoh.workspaces import package, rule, workspace

TALKER = package(
    rule("ALLOW", "ros_topic", "ros_publish", "/chatter", "/public/*"),
    rule("DENY", "ros_topic", "ros_publish", "/public/secret", line=8),
)
LISTENER = package(rule("ALLOW", "ros_topic", "ros_subscribe", "/chatter", "/public/secret"), subject="/robot/listener")
PACKAGES = workspace(TALKER, LISTENER)
FOLDER = "install/enclaves"


def of(subject: str, packages: tuple[Package, ...] = PACKAGES) -> Package:
    return next(each for each in packages if each.subject == subject)


@cache
def files_of(subject: str) -> Mapping[str, bytes]:
    return installed(of(subject))


@cache
def router_files() -> Mapping[str, bytes]:
    return shared(PACKAGES)


ANCHORS = {
    "identity": TrustAnchor("identity_ca", "public/identity_ca.pem", pem("identity_ca")),
    "access": TrustAnchor("permissions_ca", "public/permissions_ca.pem", pem("permissions_ca")),
}


def anchors_of(of_package: Package) -> TrustAnchors:
    return TrustAnchors(ANCHORS, of_package.identity.subject_name, "sros2")


def task(subject: str = "/talker", **changed: Any) -> ProofTask:
    own = of(subject)
    usual = ProofTask(
        own,
        own.grant.rules,
        EnclaveFiles(files_of(subject), f"{FOLDER}{subject}", anchors_of(own), router_files(), "install"),
        100_000,
        lambda: True,
    )
    of_enclave = {name: changed.pop(name) for name in [*changed] if name in EnclaveFiles.__slots__}
    return replace(usual, enclave=replace(usual.enclave, **of_enclave), **changed)


def shared_task(**changed: Any) -> SharedProofTask:
    subjects = [each.subject for each in PACKAGES]
    usual = SharedProofTask(
        PACKAGES,
        {each.subject: each.grant.rules for each in PACKAGES},
        {subject: files_of(subject) for subject in subjects},
        FOLDER,
        router_files(),
        "install",
        ANCHORS,
        100_000,
        lambda: True,
    )
    return replace(usual, **changed)


def signed(content: bytes, by: str = "permissions_ca") -> dict[str, bytes]:
    signer = authority(by)
    return {ROUTER: content, SIGNATURE: cms.sign(content, signer.certificate, signer.key)}


def changed_router(change: Callable[[Configuration], Configuration]) -> dict[str, bytes]:
    """Return the router's file with a fault, signed as it is."""
    content = write(change(read(router_files()[ROUTER], ROUTER)), ())
    assert content != router_files()[ROUTER]
    return signed(content)


def changed_session(change: Callable[[Configuration], Configuration], subject: str = "/talker") -> dict[str, bytes]:
    content = write(change(read(files_of(subject)[SESSION], SESSION)), ())
    return {**files_of(subject), SESSION: content}


def in_control(change: Callable[[AccessControl], AccessControl]) -> Callable[[Configuration], Configuration]:
    return lambda found: replace(found, access_control=change(found.access_control))


def refuted(claims: tuple[Claim, ...]) -> dict[str, str]:
    """Return the reasons for which claims are refuted, by action."""
    assert Proof.UNKNOWN not in {claim.proof for claim in claims}, [claim.reason for claim in claims]
    return {claim.action: claim.counterexample.document.reason for claim in claims if claim.counterexample}


@pytest.mark.parametrize("subject", ["/talker", "/robot/listener"])
def test_what_is_installed_is_proven(subject: str) -> None:
    claims = prove(task(subject))
    assert {claim.proof for claim in claims} == {Proof.PROVEN}
    assert len(claims) == 19
    assert {claim.model for claim in claims} == set(ASSUMPTIONS)


def test_nothing_is_claimed_about_the_router_itself() -> None:
    assert prove(task("/zenoh_router")) == ()


def test_the_claims_across_subjects_are_proven() -> None:
    claims = prove_shared(shared_task())
    assert [(claim.action, claim.proof) for claim in claims] == [
        ("route", Proof.PROVEN),
        ("identify", Proof.PROVEN),
        ("address by put", Proof.PROVEN),
        ("address by delete", Proof.PROVEN),
        ("address by query", Proof.PROVEN),
    ]


def tls(**changed: Any) -> Callable[[Configuration], Configuration]:
    return lambda found: replace(found, **changed)


SESSION_FAULTS = {
    "mode peer": (lambda found: replace(found, mode="peer"), "mode is not 'client'"),
    "gossip": (lambda found: replace(found, gossip=True), "gossip/enabled is not false"),
    "multicast": (lambda found: replace(found, multicast=True), "multicast/enabled is not false"),
    "listens": (lambda found: replace(found, listen=("tls/[::]:0",)), "listen/endpoints is not empty"),
    "another router": (lambda found: replace(found, connect=("tls/evil:7447",)), "connect/endpoints is"),
    "a second router": (lambda found: replace(found, connect=(*found.connect, "tls/b:1")), "connect/endpoints is"),
    "no names": (tls(verify_name=False), "verify_name_on_connect is not true"),
    "expired": (tls(close_expired=False), "outlives its certificate"),
    "one side": (tls(mutual=False), "enable_mtls is not true"),
    "another authority": (tls(root_ca="/tmp/ca.pem"), "root_ca_certificate is not '/"),
    "tcp": (lambda found: replace(found, protocols=("tls", "tcp")), "not limited to tls and quic"),
    "any protocol": (lambda found: replace(found, protocols=()), "not limited to tls and quic"),
    "open": (
        in_control(lambda control: replace(control, default_permission=Permission.ALLOW)),
        "allowed by default",
    ),
    "off": (in_control(lambda control: replace(control, enabled=False)), "everything is allowed"),
    "not pinned": (
        in_control(lambda control: replace(control, subjects=(replace(control.subjects[0], cert_common_names=()),))),
        "must be the router",
    ),
    "another enclave as router": (
        in_control(
            lambda control: replace(
                control,
                subjects=(replace(control.subjects[0], cert_common_names=("/zenoh_router", "/robot/listener")),),
            )
        ),
        "must be the router",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", SESSION_FAULTS)
def test_faults_of_a_session(fault: str) -> None:
    change, reason = SESSION_FAULTS[fault]
    found = refuted(prove(task(files=changed_session(change))))
    assert reason in found["connect"]


def test_a_fault_is_told_without_the_value_that_differs_from_enclave_to_enclave() -> None:
    """Reports put enclaves together that differ from what they should be in the same way."""
    one, other = (
        refuted(prove(task(files=changed_session(tls(root_ca=path))))) for path in ("/tmp/a.pem", "/tmp/b.pem")
    )
    assert one == other != {}


def test_a_fault_of_a_session_has_its_place() -> None:
    claims = prove(task(files=changed_session(lambda found: replace(found, gossip=True))))
    [example] = [claim.counterexample for claim in claims if claim.counterexample]
    where = example.document.where
    assert where is not None
    assert where.file == f"{FOLDER}/talker/{SESSION}"
    assert where.line > 1
    assert example.difference == "a session must exchange messages with the router alone"


def test_a_session_that_restricts_what_the_policy_allows() -> None:
    def change(control: AccessControl) -> AccessControl:
        [own] = control.rules
        return replace(control, rules=(replace(own, messages=(Message.PUT,)),))

    found = refuted(prove(task(files=changed_session(in_control(change)))))
    assert "put in" not in found
    assert "own sessions" in found["declare subscriber out"]


def test_a_session_that_denies_other_names_is_proven() -> None:
    def change(control: AccessControl) -> AccessControl:
        [own] = control.rules
        denial = AclRule("other", tuple(Message), tuple(Flow), Permission.DENY, ("0/other/**",))
        [policy] = control.policies
        return replace(control, rules=(own, denial), policies=(replace(policy, rules=(own.id, "other")),))

    assert refuted(prove(task(files=changed_session(in_control(change))))) == {}


def test_a_setting_that_is_not_modelled() -> None:
    def change(found: Configuration) -> Configuration:
        return replace(found, other={**found.other, "queries_default_timeout": 7})

    [claim] = [each for each in prove(task(files=changed_session(change))) if each.reason]
    assert (claim.action, claim.proof) == ("connect", Proof.UNKNOWN)
    assert "queries_default_timeout" in claim.reason


ROUTER_FAULTS = {
    "mode peer": (lambda found: replace(found, mode="peer"), "route", "mode is not 'router'"),
    "tcp": (lambda found: replace(found, listen=(*found.listen, "tcp/[::]:7447")), "route", "endpoints of tls or quic"),
    "an authority of its own": (
        lambda found: replace(found, listen=("tls/[::]:7447#root_ca_certificate_file=/tmp/ca.pem",)),
        "route", "without settings of their own",
    ),
    "connects": (lambda found: replace(found, connect=("tls/b:7447",)), "route", "connect/endpoints is"),
    "gossip": (lambda found: replace(found, gossip=True), "route", "gossip"),
    "one side": (tls(mutual=False), "route", "enable_mtls is not true"),
    "expired": (tls(close_expired=False), "route", "outlives"),
    "another key": (tls(listen_key="/tmp/key.pem"), "route", "listen_private_key is not '/"),
    "off": (in_control(lambda control: replace(control, enabled=False)), "identify", "is off"),
    "open": (
        in_control(lambda control: replace(control, default_permission=Permission.ALLOW)), "identify", "by default",
    ),
    "everyone": (
        in_control(lambda control: replace(control, subjects=(*control.subjects, AclSubject("any")))),
        "identify", "it is every link",
    ),
    "doubled": (
        in_control(
            lambda control: replace(control, subjects=(*control.subjects, AclSubject("second", ("/talker",))))
        ),
        "identify", "is not the only one",
    ),
    "forgotten": (
        in_control(lambda control: replace(control, subjects=control.subjects[1:], policies=control.policies[1:])),
        "identify", "is missing: /",
    ),
    "stranger": (
        in_control(lambda control: replace(control, subjects=(*control.subjects, AclSubject("x", ("/stranger",))))),
        "identify", "no package of the workspace has it",
    ),
    "interface": (
        in_control(
            lambda control: replace(
                control, subjects=tuple(replace(each, interfaces=("eth0",)) for each in control.subjects)
            )
        ),
        "identify", "more properties than a common name",
    ),
    "two enclaves together": (
        in_control(
            lambda control: replace(
                control, subjects=(replace(control.subjects[0], cert_common_names=("/talker", "/robot/listener")),),
                policies=tuple(replace(each, subjects=(control.subjects[0].id,)) for each in control.policies),
            )
        ),
        "identify", "has 2 common names",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", ROUTER_FAULTS)
def test_faults_of_the_router(fault: str) -> None:
    change, action, reason = ROUTER_FAULTS[fault]
    found = refuted(prove_shared(shared_task(shared=changed_router(change))))
    assert reason in found[action]


def test_two_enclaves_with_one_common_name() -> None:
    files = {"/talker": files_of("/talker"), "/robot/listener": files_of("/talker")}
    found = refuted(prove_shared(shared_task(enclaves=files)))
    assert "/robot/listener" in found["identify"]


def test_an_enclave_with_the_certificate_of_another() -> None:
    def one_entry(control: AccessControl) -> AccessControl:
        [own] = [each for each in control.subjects if each.cert_common_names == ("/talker",)]
        policies = tuple(each for each in control.policies if own.id in each.subjects)
        return replace(control, subjects=(own,), policies=policies)

    files = {"/talker": files_of("/talker"), "/robot/listener": files_of("/talker")}
    found = refuted(prove_shared(shared_task(enclaves=files, shared=changed_router(in_control(one_entry)))))
    assert "is not the only one with the common name '/talker'" in found["identify"]


def test_a_receiver_that_gets_what_a_denial_hides() -> None:
    everything = package(rule("ALLOW", "ros_topic", "ros_subscribe", "/public/*"), subject="/robot/listener")
    packages = workspace(TALKER, everything)
    claims = prove_shared(shared_task(packages=packages, shared=shared(packages)))
    assert {claim.proof for claim in claims} == {Proof.PROVEN}
    [(action, [exception])] = [(claim.action, claim.excepted) for claim in claims if claim.excepted]
    assert action == "address by put"
    assert exception.startswith("a put of /talker to 0/public/$*secret/*/* reaches /robot/listener")


@pytest.mark.parametrize(("called", "excepted"), [("/public/*", ["address by query"]), ("/other", [])])
def test_cached_data_that_a_subscriber_is_denied(called: str, excepted: list[str]) -> None:
    publisher = package(rule("ALLOW", "ros_topic", "ros_publish", "/public/*"))
    subscriber = package(
        rule("ALLOW", "ros_topic", "ros_subscribe", "/public/*"),
        rule("DENY", "ros_topic", "ros_subscribe", "/public/secret", line=8),
        rule("ALLOW", "ros_service", "ros_call", called, line=9),
        subject="/robot/listener",
    )
    packages = workspace(publisher, subscriber)
    claims = prove_shared(shared_task(packages=packages, shared=shared(packages)))
    assert {claim.proof for claim in claims} == {Proof.PROVEN}
    assert [claim.action for claim in claims if claim.excepted] == excepted


def earlier() -> Mapping[str, bytes]:
    """Return a router's file that the authority signed when the policy allowed more."""
    before = package(
        rule("ALLOW", "ros_topic", "ros_publish ros_subscribe", "/chatter", "/public/*"),
        rule("DENY", "ros_topic", "ros_publish", "/public/secret", line=8),
    )
    return shared(workspace(before, LISTENER))


def test_a_router_file_that_was_signed_earlier() -> None:
    found = refuted(prove(task(shared=earlier())))
    assert set(found) >= {"put out", "declare subscriber in"}
    assert "put in" not in found
    assert refuted(prove(task("/robot/listener", shared=earlier()))) == {}


def test_a_dropped_denial() -> None:
    def change(control: AccessControl) -> AccessControl:
        gone = {each.id for each in control.rules if each.permission is Permission.DENY}
        kept = tuple(
            AclPolicy(tuple(n for n in each.rules if n not in gone), each.subjects) for each in control.policies
        )
        return replace(control, rules=tuple(each for each in control.rules if each.id not in gone), policies=kept)

    found = refuted(prove(task(shared=changed_router(in_control(change)))))
    assert "put in" in found


@pytest.mark.parametrize("by", ["identity_ca", "someone"])
def test_a_router_file_signed_by_another_authority(by: str) -> None:
    forged = signed(router_files()[ROUTER], by)
    for attempt in (lambda: prove(task(shared=forged)), lambda: prove_shared(shared_task(shared=forged))):
        with pytest.raises(KeymintError, match=f"^install/{SIGNATURE}: is by another certificate"):
            attempt()


def test_a_router_file_that_was_altered_after_signing() -> None:
    altered = {**router_files(), ROUTER: router_files()[ROUTER].replace(b"/chatter/", b"/chattel/")}
    with pytest.raises(KeymintError, match="is not over the configuration beside it"):
        prove(task(shared=altered))


@pytest.mark.parametrize("name", [ROUTER, SIGNATURE])
def test_a_missing_shared_file(name: str) -> None:
    rest = {key: value for key, value in router_files().items() if key != name}
    with pytest.raises(KeymintError, match=f"^install/{name}: is missing"):
        prove(task(shared=rest))
    with pytest.raises(KeymintError, match=f"^install/{name}: is missing"):
        prove_shared(shared_task(shared=rest))


@pytest.mark.parametrize("name", [CERTIFICATE, KEY, IDENTITY_CA, SESSION])
def test_a_missing_file_of_an_enclave(name: str) -> None:
    rest = {key: value for key, value in files_of("/talker").items() if key != name}
    with pytest.raises(KeymintError, match=f"^{FOLDER}/talker/{name}: is missing"):
        prove(task(files=rest))


def codes(files: Mapping[str, bytes], subject: str = "/talker") -> set[str]:
    found = differences(EnclaveFiles(files, f"{FOLDER}{subject}", anchors_of(of(subject)), router_files(), "install"))
    return {each.code for each in found}


def test_differences() -> None:
    own, other = files_of("/talker"), files_of("/robot/listener")
    assert codes(own) == set()
    assert codes({**own, CERTIFICATE: other[CERTIFICATE]}) == {"certificate-subject", "key-mismatch"}
    assert codes({**own, KEY: other[KEY]}) == {"key-mismatch"}
    assert codes({**own, IDENTITY_CA: pem("someone")}) == {"authority-differs"}
    assert "certificate-subject" in codes({**own, CERTIFICATE: pem("identity_ca")})


def test_a_missing_authority() -> None:
    anchors = replace(
        anchors_of(TALKER), authorities={**ANCHORS, "access": TrustAnchor("permissions_ca", "public/x.pem", b"")}
    )
    [found] = differences(EnclaveFiles(files_of("/talker"), "x", anchors, router_files(), "install"))
    assert (found.code, str(found.where)) == ("authority-missing", "public/x.pem")


def test_terms_are_those_of_the_certificates() -> None:
    found = terms(EnclaveFiles(files_of("/talker"), "x", anchors_of(TALKER), router_files(), "install"))
    assert [(each.code, str(each.where)) for each in found] == [
        ("certificate", f"x/{CERTIFICATE}"), ("authority", f"x/{IDENTITY_CA}"),
    ]  # fmt: skip
    assert found[0].periods == ((TALKER.identity.validity.not_before, TALKER.identity.validity.not_after),)
