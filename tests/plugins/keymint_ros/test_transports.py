# SPDX-License-Identifier: Apache-2.0
"""Profiles and packages for the transports that ship with Keymint: one of them, the other, or both."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import pytest
import xmlschema
from keymint_ros import manifest, package_type, profile_type
from keymint_ros.bootstrap import bootstrap
from lxml import etree

from comarmor.data import locate
from keymint.api import Package, Role
from tests.conftest import installed_plugins

from .workspaces import REQUEST, ROOT, Workspace, diagnostic_of, load_package

DDS, ZENOH = "keymint_ros2_dds", "keymint_ros2_zenoh"
ROUTER = "zenoh_router"
SETS = pytest.mark.parametrize("build_types", [(DDS,), (ZENOH,), (DDS, ZENOH), (ZENOH, DDS)], ids="+".join)


def files_for(*build_types: str) -> Mapping[str, bytes]:
    return bootstrap(replace(REQUEST, build_types=build_types))


def package(*build_types: str) -> Package:
    """Load a new package of a subject."""
    return Workspace.new(replace(REQUEST, build_types=build_types)).load()


def router(*build_types: str) -> Package:
    """Load the package of the router."""
    profile = profile_type.load(ROOT, files_for(*build_types))
    (needed,) = installed_plugins().build_type(ZENOH).packages(profile)
    files = package_type.create_infrastructure(profile, needed, ZENOH, {})
    return load_package(profile, needed, f"src/{needed}", files)


@SETS
def test_a_profile_has_the_defaults_of_its_transports(build_types: tuple[str, ...]) -> None:
    files = files_for(*build_types)
    assert profile_type.load(ROOT, files).build_types == build_types
    assert ("package.defaults/governance.xml" in files) == (DDS in build_types)
    assert ("package.defaults/zenoh.xml" in files) == (ZENOH in build_types)
    assert package(*build_types).build_types == build_types


def test_the_default_is_what_it_was_before_there_was_a_choice() -> None:
    assert files_for() == files_for(DDS)
    assert b"<build_type>" not in files_for()["keymint_profile.xml"]


def test_nothing_in_a_workspace_for_zenoh_alone_speaks_of_dds() -> None:
    workspace = Workspace.new(replace(REQUEST, build_types=(ZENOH,)))
    # The policy library, which is shared, names raw topics of DDS; the format of authorities has its historical name.
    texts = {
        path: text for path, text in {**workspace.profile, **workspace.package}.items() if "comarmor.d" not in path
    }
    said = {path: re.findall(rb"(?i).*\b(?:dds|governances?|participants?)\b.*", text) for path, text in texts.items()}
    assert {path: lines for path, lines in said.items() if lines} == {}
    assert package(ZENOH).grant.validity is None
    assert package(ZENOH).grant.subject_name == ""
    assert package(DDS, ZENOH).grant.validity == package(DDS).grant.validity


def test_the_defaults_of_zenoh_are_valid_for_both_validators() -> None:
    path = str(locate(ZENOH, "schemas") / "source_zenoh.xsd")
    content = files_for(ZENOH)["package.defaults/zenoh.xml"]
    xmlschema.XMLSchema10(path).validate(content.decode())
    assert etree.XMLSchema(file=path).validate(etree.fromstring(content))


@SETS
def test_settings_are_those_of_the_request(build_types: tuple[str, ...]) -> None:
    request = replace(REQUEST, build_types=build_types, domain=7, subject_format="sros2")
    profile = profile_type.load(ROOT, bootstrap(request))
    assert profile_type.settings(profile) == {
        "distro": "jazzy", "layout": "sros2", "domain": "7", "subject-format": "sros2", "valid-for": "P365D",
    }  # fmt: skip


def test_nodes_are_clients_and_the_router_is_a_server() -> None:
    def extensions(of: Package) -> dict[str, str]:
        return {each.name: each.value for each in of.identity.extensions}

    assert extensions(package(DDS)) == {}
    for build_types in ((ZENOH,), (DDS, ZENOH)):
        assert extensions(package(*build_types)) == {"extendedKeyUsage": "clientAuth"}
        assert extensions(router(*build_types)) == {
            "extendedKeyUsage": "serverAuth", "subjectAltName": "DNS:localhost",
        }  # fmt: skip


def test_the_router_is_infrastructure_of_one_build_type() -> None:
    loaded = router(DDS, ZENOH)
    assert (loaded.name, loaded.role, loaded.build_types) == (ROUTER, Role.INFRASTRUCTURE, (ZENOH,))
    assert loaded.grant.rules.rules == ()
    assert loaded.identity.issuer == "identity_ca"


def test_infrastructure_that_exists_is_kept() -> None:
    profile = profile_type.load(ROOT, files_for(ZENOH))
    mine = {"identities.xml": b"<package><identities><identity/></identities></package>"}
    made = package_type.create_infrastructure(profile, ROUTER, ZENOH, mine)
    assert set(made) == {manifest.MARKER}
    assert package_type.create_infrastructure(profile, ROUTER, ZENOH, {**mine, **made}) == {}


def test_the_role_of_a_manifest_with_defects_is_that_of_a_subject() -> None:
    assert package_type.role(b"<package><role>infrastructure</role></package>") is Role.INFRASTRUCTURE
    assert package_type.role(b"<package/>") is Role.SUBJECT
    assert package_type.role(b"<package><role>infra") is Role.SUBJECT


def test_an_element_of_the_profile_that_occurs_twice() -> None:
    workspace = Workspace.new().edit("profile/keymint_profile.xml", "<export>", "<export><layout>flat</layout>")
    diagnostic = diagnostic_of(workspace.load_profile, "/ws/profile/keymint_profile.xml")
    assert (diagnostic.code, diagnostic.message) == ("schema", "there are two elements <layout>")


def test_a_grant_without_dates_is_incomplete_for_dds() -> None:
    zenoh = Workspace.new(replace(REQUEST, build_types=(ZENOH,)))
    both = zenoh.edit("keymint_package.xml", "<export>", f"<export><build_type>{DDS}</build_type>")
    both = replace(both, profile={**both.profile, **{
        path: content for path, content in files_for(DDS).items() if path.endswith("governance.xml")
    }})  # fmt: skip
    diagnostic = diagnostic_of(both.load, "/ws/profile/package.defaults/permissions.xml")
    assert diagnostic.code == "grant-incomplete"
