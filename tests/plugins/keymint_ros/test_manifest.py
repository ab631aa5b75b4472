# SPDX-License-Identifier: Apache-2.0
"""``keymint_package.xml``: names, documents and authorities of a package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from keymint_ros import package_type
from keymint_ros2_dds import build_type
from keymint_ros2_dds.settings import settings_of

from comarmor.errors import Origin
from keymint.api import Extension, Package, PackageSettings, PackageSources, Role
from keymint.errors import KeymintError
from keymint.ir import SubjectRules

from .workspaces import Workspace, diagnostic_of

_MANIFEST = "keymint_package.xml"


@pytest.mark.parametrize("name", ["talker", "robot1/talker", "/robot1/talker"])
def test_the_manifest_may_repeat_the_name(workspace: Workspace, name: str) -> None:
    assert workspace.edit(_MANIFEST, "<export>", f"<name>{name}</name><export>").load().name == "robot1/talker"


@pytest.mark.parametrize(
    ("parts", "code", "hint"),
    [
        ("<name>listener</name>", "name-mismatch", "<name>talker</name>"),
        ("<permissions><issuer_name>permision_ca</issuer_name></permissions>", "authority-unknown", "mean"),
        ("<permissions><issuer_name>identity_ca</issuer_name></permissions>", "signers-differ", "same"),
        ("<permisions/>", "schema", "did you mean 'permissions'?"),
        (
            "<identities><identity><identity_path>identites.xml</identity_path></identity></identities>",
            "file-missing",
            "did you mean 'identities.xml'?",
        ),
        (
            "<identities><identity><defaults_path>../x.xml</defaults_path></identity></identities>",
            "path-outside",
            "inside",
        ),
        (
            "<governances><governance><governance_path>/x</governance_path></governance></governances>",
            "path-outside",
            "inside",
        ),
        (
            "<governances><governance><defaults_path>x.xml</defaults_path></governance></governances>",
            "file-missing",
            "create it",
        ),
        ('<parts><part name="governance"><path>x.xml</path></part></parts>', "file-missing", "create it"),
        ('<parts><part name="a"/><part name="a"/></parts>', "part-doubled", "remove"),
        ('<governances/><parts><part name="governance"/></parts>', "part-doubled", "remove"),
        ('<permissions/><parts><part name="permissions"/></parts>', "part-doubled", "remove"),
        ('<parts><part name="identities"><path>x.xml</path></part></parts>', "file-missing", "create it"),
        ('<parts><part name="../a"/></parts>', "schema", ""),
        ("<role>router</role>", "schema", ""),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(workspace: Workspace, parts: str, code: str, hint: str) -> None:
    edited = workspace.edit(_MANIFEST, "<export>", f"{parts}<export>")
    diagnostic = diagnostic_of(edited.load, f"src/robot1/talker/{_MANIFEST}")
    assert diagnostic.code == code
    assert hint in diagnostic.help


def test_a_build_type_is_named_once(workspace: Workspace) -> None:
    twice = "<build_type>keymint_ros2_dds</build_type>"
    diagnostic = diagnostic_of(
        workspace.edit(_MANIFEST, "<export>", f"<export>{twice}").load, f"src/robot1/talker/{_MANIFEST}"
    )
    assert diagnostic.code == "build-type-doubled"


class Reading:
    """A build type that reads parts, and wants extensions in the certificate."""

    PARTS = ("governance", "radio")
    KNOWS_COMMON_NAMES_ONLY = False

    def __init__(self) -> None:
        self.seen: list[PackageSources] = []

    def settings(self, sources: PackageSources) -> PackageSettings:
        self.seen.append(sources)
        here = Origin("of the build type")
        wanted = ("extendedKeyUsage", "clientAuth"), ("subjectAltName", "DNS:default")
        radio = sources.parts["radio"]
        if radio.content == b"broken":
            raise KeymintError("is broken", where=Origin(radio.file, 1), code="radio-broken")
        return PackageSettings(radio.content, tuple(Extension(name, value, False, here) for name, value in wanted))


def load_for(build_types: Mapping[str, object], workspace: Workspace) -> Package:
    """Load the package with these build types."""
    elements = "".join(f"<build_type>{name}</build_type>" for name in build_types)
    edited = workspace.edit(_MANIFEST, "<build_type>keymint_ros2_dds</build_type>", elements)
    profile = edited.load_profile()

    def plugin(name: str, where: Origin) -> object:
        assert where.file == f"src/robot1/talker/{_MANIFEST}"
        return build_types[name]

    return package_type.load(profile, edited.name, "src/robot1/talker", edited.package, plugin, "/ws/install")


def test_each_build_type_reads_its_parts_and_its_settings_stay_apart(workspace: Workspace) -> None:
    reading = Reading()
    files = {**workspace.package, "radio.xml": b"<radio/>"}
    loaded = load_for({"mine": reading, "keymint_ros2_dds": build_type}, replace(workspace, package=files))
    assert loaded.build_types == ("mine", "keymint_ros2_dds")
    assert loaded.settings["mine"] == b"<radio/>"
    assert settings_of(loaded).issuer == "permissions_ca"
    (sources,) = reading.seen
    radio, governance = sources.parts["radio"], sources.parts["governance"]
    assert (radio.file, radio.defaults, radio.defaults_file) == (
        "src/robot1/talker/radio.xml", None, "/ws/profile/package.defaults/radio.xml",
    )  # fmt: skip
    assert governance.defaults == workspace.profile["package.defaults/governance.xml"]
    assert (sources.install_space, sources.authorities) == ("/ws/install", ("identity_ca", "permissions_ca"))
    assert (sources.grant, sources.identity and sources.identity.subject_name) == (
        loaded.grant, loaded.identity.subject_name,
    )  # fmt: skip


def test_an_extension_of_the_sources_goes_before_that_of_a_build_type(workspace: Workspace) -> None:
    given = "<extensions><extension name='subjectAltName'>DNS:robot1</extension></extensions>"
    own = f"<identity><cert>{given}</cert></identity>"
    edited = workspace.edit("identities.xml", "<identity/>", own)
    extensions = {each.name: each.value for each in load_for({"mine": Reading()}, edited).identity.extensions}
    assert extensions == {"subjectAltName": "DNS:robot1", "extendedKeyUsage": "clientAuth"}
    assert load_for({"keymint_ros2_dds": build_type}, workspace).identity.extensions == ()


def test_the_defects_of_all_build_types_are_reported_at_once(workspace: Workspace) -> None:
    files = {**workspace.package, "radio.xml": b"broken", "identities.xml": b"<package/>", "governance.xml": b"<x/>"}
    with pytest.raises(KeymintError) as error:
        load_for({"mine": Reading(), "keymint_ros2_dds": build_type}, replace(workspace, package=files))
    codes = [each.code for each in error.value.diagnostics]
    assert codes.count("radio-broken") == 1
    assert {each.where.file.rpartition("/")[2] for each in error.value.diagnostics if each.where} == {
        "radio.xml", "identities.xml", "governance.xml",
    }  # fmt: skip


def test_infrastructure_needs_no_rules(workspace: Workspace) -> None:
    edited = workspace.edit(_MANIFEST, "<export>", "<role>infrastructure</role><export>").without("permissions.xml")
    loaded = edited.load()
    assert (loaded.role, loaded.grant.rules) == (Role.INFRASTRUCTURE, SubjectRules("/robot1/talker", ()))
    assert (loaded.grant.issuer, loaded.grant.subject_name) == ("permissions_ca", loaded.identity.subject_name)
    with pytest.raises(KeymintError, match=r"no permissions\.xml"):
        workspace.without("permissions.xml").load()
