# SPDX-License-Identifier: Apache-2.0
"""Governance documents, completed by their defaults."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_dds.settings import settings_of

from keymint.api import DomainRange
from tests.plugins.keymint_ros.workspaces import Workspace, diagnostic_of


def topic_rule(settings: str, kind: str = "topic") -> str:
    rule = f"<{kind}_rule><topic_expression>*</topic_expression>{settings}</{kind}_rule>"
    return f"<topic_access_rules>{rule}</topic_access_rules>"


@pytest.fixture
def workspace() -> Workspace:
    return Workspace.new()


def test_a_governance_overrides_its_defaults_and_keeps_their_last_rule(workspace: Workspace) -> None:
    package = workspace.edit(
        "governance.xml",
        "<domain_rule/>",
        """<domain_rule>
             <rtps_protection_kind>NONE</rtps_protection_kind>
             <topic_access_rules>
               <ros_service_rule><service_expression>/add</service_expression>
                 <data_protection_kind>SIGN</data_protection_kind></ros_service_rule>
               <topic_rule><topic_expression>DCPS*</topic_expression>
                 <enable_read_access_control>false</enable_read_access_control></topic_rule>
             </topic_access_rules>
           </domain_rule>
           <domain_rule><domains><id_range><min>1</min><max>4</max></id_range></domains></domain_rule>""",
    ).load()
    first, second = settings_of(package).domain_rules
    assert (first.domains, first.rtps_protection_kind, first.discovery_protection_kind) == (
        (DomainRange(0, 0),),
        "NONE",
        "ENCRYPT",
    )
    assert [(rule.kind, rule.expression) for rule in first.topic_rules] == [
        ("ros_service", "/add"),
        ("topic", "DCPS*"),
        ("topic", "*"),
    ]
    service, raw, rest = first.topic_rules
    assert (service.data_protection_kind, service.metadata_protection_kind) == ("SIGN", "ENCRYPT")
    assert (raw.enable_read_access_control, raw.enable_write_access_control) == (False, True)
    assert str(rest.origin).startswith("/ws/profile/package.defaults/governance.xml:")
    assert second.domains == (DomainRange(1, 4),)


def test_packages_with_the_same_documents_have_places_of_their_own(workspace: Workspace) -> None:
    """They are read once, without a look at their paths."""
    own = "<domain_rule>\n<topic_access_rules>\n<topic_rule><topic_expression>a</topic_expression></topic_rule>"
    edited = workspace.edit("governance.xml", "<domain_rule/>", f"{own}</topic_access_rules></domain_rule>")
    defaults = {path: content for path, content in edited.profile.items() if path.startswith("package.defaults/")}
    for name in ("robot1/talker", "robot2/talker"):
        package = replace(edited, name=name, package={**edited.package, **defaults}).load()
        (rule,) = settings_of(package).domain_rules
        assert rule.domains_origin is not None
        first, *others = rule.topic_rules
        folder = f"src/{name}"
        assert {rule.origin.file, first.origin.file} == {f"{folder}/governance.xml"}
        assert first.origin.line == rule.origin.line + 2
        of_defaults = [each.origin for each in others] + [rule.domains_origin]
        assert {each.file for each in of_defaults} == {f"{folder}/package.defaults/governance.xml"}
        assert package.identity.origin.file == f"{folder}/package.defaults/identities.xml"
        assert package.identity.validity.origin.file == f"{folder}/package.defaults/identities.xml"
        assert package.grant.defaults_origin.file == f"{folder}/package.defaults/permissions.xml"


@pytest.mark.parametrize(
    ("rule", "code", "hint"),
    [
        ("<domains><id_range><min>5</min><max>4</max></id_range></domains>", "domain-range", "exchange"),
        ("<rtps_protection_kind>SING</rtps_protection_kind>", "schema", "did you mean 'SIGN'?"),
        ("<discovery_protection_kind>ENCRYP</discovery_protection_kind>", "schema", "did you mean 'ENCRYPT'?"),
        ("<liveliness_protection_kind>ENCRYP</liveliness_protection_kind>", "schema", "did you mean 'ENCRYPT'?"),
        (topic_rule("<metadata_protection_kind>sign</metadata_protection_kind>"), "schema", "did you mean 'SIGN'?"),
        (topic_rule("<data_protection_kind>SIGN_WITH_ORIGIN_AUTHENTICATION</data_protection_kind>"), "schema", ""),
        (topic_rule("", kind="ros_topics"), "schema", "did you mean 'ros_topic_rule'?"),
    ],
)
def test_a_defect_is_reported_with_its_place_and_a_hint(workspace: Workspace, rule: str, code: str, hint: str) -> None:
    edited = workspace.edit("governance.xml", "<domain_rule/>", f"<domain_rule>{rule}</domain_rule>")
    diagnostic = diagnostic_of(edited.load, "src/robot1/talker/governance.xml")
    assert diagnostic.code == code
    assert hint in diagnostic.help
