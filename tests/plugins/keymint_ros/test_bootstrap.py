# SPDX-License-Identifier: Apache-2.0
"""New profiles are complete, loadable and conservative."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from keymint_ros import package_type, profile_type
from keymint_ros.bootstrap import checked_domain
from keymint_ros2_dds.settings import settings_of

import comarmor
from keymint.api import DomainRange, KeySpec
from keymint.errors import KeymintError
from keymint.pki import distinguished_names

from .workspaces import NOW, REQUEST, ROOT, RULES, Workspace, write_folder

DISTROS = ("bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic", "humble")
DISTROS += ("iron", "jazzy", "kilted", "lyrical", "rolling")


@pytest.mark.parametrize("distro", DISTROS)
def test_the_example_policy_of_every_distro_loads(distro: str, tmp_path: Path) -> None:
    files = profile_type.bootstrap(replace(REQUEST, distro=distro))
    write_folder(tmp_path, files)
    profile = profile_type.load(tmp_path, files)
    assert (profile.distro, profile.profile_type, profile.policy_type) == (
        distro,
        "keymint_ros",
        "keymint_ros2_comarmor",
    )
    (source,) = profile.policies
    policy = comarmor.load(source.path, library=profile.library)
    assert policy.subjects() == ("/listener", "/talker")

    def allowed(kind: str, permission: str, name: str) -> bool:
        return policy.decide("/talker", kind, permission, name).allowed

    assert allowed("ros_topic", "ros_publish", "/chatter")
    assert not allowed("ros_topic", "ros_subscribe", "/chatter")
    for service in ("describe_parameters", "get_parameters", "set_parameters_atomically"):
        assert allowed("ros_service", "ros_execute", f"/talker/{service}")
        assert not allowed("ros_service", "ros_call", f"/talker/{service}")
        assert not allowed("ros_service", "ros_execute", f"/listener/{service}")
    assert allowed("ros_topic", "ros_publish", "/rosout")
    assert allowed("ros_topic", "ros_subscribe", "/clock")
    assert not allowed("ros_topic", "ros_publish", "/clock")
    assert allowed("topic", "publish", "ros_discovery_info") == (distro not in DISTROS[:4])
    assert allowed("ros_service", "ros_execute", "/talker/get_type_description") == (distro in DISTROS[7:])


def test_identities_and_permissions_have_different_authorities() -> None:
    workspace = Workspace.new()
    profile, package = workspace.load_profile(), workspace.load()
    assert [authority.name for authority in profile.authorities] == ["identity_ca", "permissions_ca"]
    assert {authority.certificate.issuer for authority in profile.authorities} == {""}
    assert {authority.certificate.key for authority in profile.authorities} == {KeySpec("ec", "SECP256R1")}
    assert package.identity.issuer == "identity_ca"
    assert (package.grant.issuer, settings_of(package).issuer) == ("permissions_ca", "permissions_ca")


def test_the_flat_layout_has_one_authority_for_identities_and_permissions() -> None:
    workspace = Workspace.new(replace(REQUEST, layout="flat"))
    profile, package = workspace.load_profile(), workspace.load()
    assert profile.layout == "flat"
    assert [authority.name for authority in profile.authorities] == ["ca"]
    assert {package.identity.issuer, package.grant.issuer, settings_of(package).issuer} == {"ca"}


def test_validity_begins_at_least_a_day_ago_and_is_written_out() -> None:
    workspace = Workspace.new()
    authority, package = workspace.load_profile().authorities[0].certificate.validity, workspace.load()
    assert authority.not_before == datetime(2026, 11, 20, tzinfo=UTC)
    assert NOW - authority.not_before >= timedelta(days=1)
    assert authority.not_after - authority.not_before == timedelta(days=3650)
    assert package.identity.validity == package.grant.validity
    assert package.identity.validity.not_after - NOW > timedelta(days=362)


@pytest.mark.parametrize(
    ("subject_format", "expected"),
    [
        ("unique", f"OU={distinguished_names.unique_suffix('/robot1/talker')},CN=/robot1/talker"),
        ("sros2", "CN=/robot1/talker"),
    ],
)
def test_subject_formats(subject_format: str, expected: str) -> None:
    package = Workspace.new(replace(REQUEST, subject_format=subject_format)).load()
    assert (package.identity.subject_name, package.grant.subject_name) == (expected, expected)


def test_a_long_name_keeps_its_subject_unique() -> None:
    name = "/".join(["robot"] * 14)
    workspace = Workspace.new()
    rules = replace(RULES, subject=f"/{name}")
    files = package_type.create(workspace.load_profile(), rules, {}, force=False)
    package = replace(workspace, package=files, name=name).load()
    assert distinguished_names.parse(package.identity.subject_name)
    assert distinguished_names.unique_suffix(f"/{name}") in package.identity.subject_name


def test_governance_is_conservative_and_names_the_domain() -> None:
    (rule,) = settings_of(Workspace.new(replace(REQUEST, domain=42)).load()).domain_rules
    assert rule.domains == (DomainRange(42, 42),)
    assert (rule.allow_unauthenticated_participants, rule.enable_join_access_control) == (False, True)
    assert (rule.discovery_protection_kind, rule.liveliness_protection_kind, rule.rtps_protection_kind) == (
        "ENCRYPT",
        "ENCRYPT",
        "SIGN",
    )
    (topic,) = rule.topic_rules
    assert (topic.kind, topic.expression) == ("topic", "*")
    assert topic.enable_read_access_control
    assert topic.enable_write_access_control


def test_the_files_depend_on_the_day_but_not_on_the_hour() -> None:
    later = replace(REQUEST, now=NOW + timedelta(hours=5))
    assert profile_type.bootstrap(later) == profile_type.bootstrap(REQUEST)


def test_names_are_escaped() -> None:
    files = profile_type.bootstrap(replace(REQUEST, name="R&D <1>", policy="../a & b/{c}.xml"))
    profile = profile_type.load(ROOT, files)
    assert profile.name == "R&D <1>"
    assert profile.policies[0].path == Path("/ws/a & b/{c}.xml")


@pytest.mark.parametrize(
    ("changes", "code", "hint"),
    [
        ({"distro": "ardnet"}, "distro-unknown", "did you mean 'ardent'?"),
        ({"distro": "Jazy"}, "distro-unknown", "did you mean 'jazzy'?"),
        ({"distro": "x"}, "distro-unknown", "known are ardent"),
        ({"layout": "sros"}, "layout-unknown", "did you mean 'sros2'?"),
        ({"subject_format": "uniqe"}, "subject-format-unknown", "did you mean 'unique'?"),
        ({"domain": 231}, "domain-range", "ROS_DOMAIN_ID"),
        ({"domain": -1}, "domain-range", "ROS_DOMAIN_ID"),
        ({"policy": "a\nb"}, "text-invalid", "choose"),
        ({"policy": "a\0b"}, "text-invalid", "choose"),
        ({"name": ""}, "text-invalid", "choose"),
    ],
)
def test_an_invalid_request_is_an_error(changes: dict[str, object], code: str, hint: str) -> None:
    with pytest.raises(KeymintError) as error:
        profile_type.bootstrap(replace(REQUEST, **changes))
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == code
    assert hint in diagnostic.help
    assert "\n" not in str(diagnostic)


@given(st.text(st.sampled_from("0129+-_ \u0663\n"), max_size=4))
def test_a_domain_id_is_a_number_of_up_to_three_digits(text: str) -> None:
    if re.fullmatch("[0-9]{1,3}", text) and int(text) <= 230:
        assert checked_domain(text) == str(int(text))
    else:
        with pytest.raises(KeymintError):
            checked_domain(text)
