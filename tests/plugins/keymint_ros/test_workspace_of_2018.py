# SPDX-License-Identifier: Apache-2.0
"""A workspace of 2018 loads unmodified, once its permissions are recreated from its policy."""

from __future__ import annotations

import pytest
from keymint_ros import package_type, profile_type
from keymint_ros2_comarmor import policy_type
from keymint_ros2_dds.settings import settings_of

from keymint.api import DomainRange, KeySpec, Package, WorkspaceProfile
from keymint.errors import KeymintError

from .workspaces import REFERENCE, load_package, read_folder

pytestmark = pytest.mark.skipif(not REFERENCE.is_dir(), reason="no ../shared/reference beside this checkout")


@pytest.fixture
def profile() -> WorkspaceProfile:
    return profile_type.load(REFERENCE / "profile", read_folder(REFERENCE / "profile"))


def _load(profile: WorkspaceProfile, name: str) -> Package:
    files = read_folder(REFERENCE / "src" / name)
    policy = policy_type.load(profile.policies, profile.library)
    rules = policy.rules(f"/{name}")
    assert rules
    created = package_type.create(profile, rules, files, force=False)
    assert created["permissions.xml.2018"] == files["permissions.xml"]
    return load_package(profile, name, f"src/{name}", {**files, **created})


def test_its_profile(profile: WorkspaceProfile) -> None:
    assert profile.name == "default_keymint_ros2_comarmor"
    assert (profile.layout, profile.policy_type) == ("sros2", "keymint_ros2_comarmor")
    assert profile.policies[0].path == REFERENCE / "profile" / "comarmor.d"
    (authority,) = profile.authorities
    spec = authority.certificate
    assert (authority.name, spec.issuer, spec.serial) == ("ca", "", 1)
    assert spec.subject_name == "C=US, ST=CA, O=Acme, CN=ca/emailAddress=acme@acme.acme"
    assert spec.key == KeySpec("rsa", size=2048)
    assert spec.validity.not_after.isoformat() == "2023-10-26T22:45:30+00:00"


@pytest.mark.parametrize("name", ["talker", "listener"])
def test_its_packages(profile: WorkspaceProfile, name: str) -> None:
    package = _load(profile, name)
    assert package.identity.subject_name == f"CN={name}" == package.grant.subject_name
    assert (package.identity.issuer, package.grant.issuer, settings_of(package).issuer) == ("ca", "ca", "ca")
    assert package.identity.serial is None
    assert package.grant.domains == (DomainRange(0, 0),)
    assert len(package.grant.rules.rules) == 8
    (domain,) = settings_of(package).domain_rules
    assert [(rule.expression, rule.enable_liveliness_protection) for rule in domain.topic_rules] == [("*", True)]


def test_its_old_permissions_name_the_command_that_recreates_them(profile: WorkspaceProfile) -> None:
    with pytest.raises(KeymintError) as error:
        load_package(profile, "talker", "src/talker", read_folder(REFERENCE / "src" / "talker"))
    (diagnostic,) = error.value.diagnostics
    assert diagnostic.code == "permissions-format"
    assert diagnostic.help == "'keymint create talker' recreates them from the policy"
