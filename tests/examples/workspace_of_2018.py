# SPDX-License-Identifier: Apache-2.0
"""A workspace in the form of 2018, with everything that its schemas allowed and the tool of then wrote."""

from __future__ import annotations

from pathlib import Path

PACKAGES = ("talker", "robot1/talker", "listener")
_CONSTRAINTS = "<BasicConstraints critical='true'><ca>true</ca><path_length>{}</path_length></BasicConstraints>"
_VALIDITY = (
    "<validity><not_before>2013-10-26T00:00:00</not_before><not_after>2033-10-26T22:45:30</not_after></validity>"
)
_KEY = """<key>
    <asymmetric_type><ec><curve>SECP256R1</curve></ec></asymmetric_type>
    <encryption_algorithm>NoEncryption</encryption_algorithm>
    <password_env></password_env>
  </key>"""
_PROTECTION = "".join(
    f"<{name}>ENCRYPT</{name}>"
    for name in ("discovery_protection_kind", "liveliness_protection_kind", "rtps_protection_kind")
)
_TOPIC_RULE = """<topic_rule>
      <topic_expression>*</topic_expression>
      <enable_discovery_protection>true</enable_discovery_protection>
      <enable_read_access_control>true</enable_read_access_control>
      <enable_write_access_control>true</enable_write_access_control>
      <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
      <data_protection_kind>ENCRYPT</data_protection_kind>
    </topic_rule>"""
_XSI = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://example.com/x.xsd"'

_PROFILE = {
    "keymint_profile.xml": f"""<profile {_XSI} format="1">
  <name>fleet of 2018</name>
  <version>1.0.2</version>
  <description>The <b>first</b> fleet, see <a href="fleet.html">its page</a>.</description>
  <authorities format="keymint_ros2_dds">
    <authority>
      <authority_path>authorities.xml</authority_path>
      <defaults_path>profile.defaults/authorities.xml</defaults_path>
    </authority>
  </authorities>
  <policies format="keymint_ros2_comarmor">
    <policy><policy_path>policies.xml</policy_path><defaults_path>policies.defaults.xml</defaults_path></policy>
  </policies>
  <export><policy_type>keymint_ros2_comarmor</policy_type></export>
</profile>""",
    "authorities.xml": f"""<profile><authorities>
  <authority name="root_ca"><cert><serial_number>0</serial_number><issuer_name></issuer_name></cert></authority>
  <authority name="identity_ca"><cert>
    <serial_number>-1</serial_number>
    <issuer_name>root_ca</issuer_name>
    <extensions>{_CONSTRAINTS.format(0)}</extensions>
  </cert></authority>
  <authority name="permissions_ca"><cert><serial_number>3</serial_number></cert></authority>
</authorities></profile>""",
    "profile.defaults/authorities.xml": f"""<defaults>
  <subject_name>CN={{name}}, C=US, ST=CA, O=Acme, emailAddress=acme@acme.acme</subject_name>
  {_VALIDITY}
  <issuer_name></issuer_name>
  <hash_algorithm>SHA256</hash_algorithm>
  {_KEY}
  <extensions>{_CONSTRAINTS.format(1)}</extensions>
</defaults>""",
    "policies.xml": """<profile><policies><policy name="fleet"><comarmor>
  <config_dir>comarmor.d</config_dir>
  <profile_dir>comarmor.d</profile_dir>
</comarmor></policy></policies></profile>""",
    "package.defaults/identities.xml": f"""<defaults>
  <subject_name>CN={{name}}</subject_name>
  {_VALIDITY}
  <serial_number>-1</serial_number>
  <issuer_name>identity_ca</issuer_name>
  <hash_algorithm>SHA256</hash_algorithm>
  {_KEY}
</defaults>""",
    "package.defaults/permissions.xml": f"""<defaults>
  <domains><id>0</id></domains>
  <subject_name>CN={{name}}</subject_name>
  {_VALIDITY}
</defaults>""",
    "package.defaults/governance.xml": f"""<defaults>
  <domains><id>0</id></domains>
  <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
  <enable_join_access_control>true</enable_join_access_control>
  {_PROTECTION}
  <topic_access_rules>{_TOPIC_RULE}</topic_access_rules>
</defaults>""",
    "comarmor.d/common/clock.xml": """<profile name="Clock">
  <attachments><attachment>/*</attachment></attachments>
  <ros_topic qualifier="ALLOW">
    <attachments><attachment>/clock</attachment></attachments>
    <permissions><ros_subscribe/></permissions>
  </ros_topic>
</profile>""",
    "comarmor.d/talker_listener.xml": """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="My Talker Profile">
    <attachments><attachment>*/talker</attachment></attachments>
    <xi:include href="common/clock.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachments><attachment>{namespace}chatter</attachment></attachments>
      <permissions><ros_publish/></permissions>
    </ros_topic>
  </profile>
  <profile name="My Listener Profile">
    <attachments><attachment>*/listener</attachment></attachments>
    <xi:include href="common/clock.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachments><attachment>{namespace}chatter</attachment></attachments>
      <permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
</profiles>""",
}


def _part(group: str, item: str, document: str, issuer: str = "") -> str:
    return f"""<{group} format="keymint_ros2_dds">{issuer and f"<issuer_name>{issuer}</issuer_name>"}
    <{item}>
      <{item}_path>{document}</{item}_path>
      <defaults_path>package.defaults/{document}</defaults_path>
    </{item}>
  </{group}>"""


def _package(name: str) -> dict[str, str]:
    return {
        "keymint_package.xml": f"""<package {_XSI} format="1">
  <name>{name}</name>
  <version>0.1.0</version>
  <description>Any <i>content</i>.</description>
  {_part("permissions", "permission", "permissions.xml", "permissions_ca")}
  {_part("governances", "governance", "governance.xml", "permissions_ca")}
  {_part("identities", "identity", "identities.xml")}
  <export><build_type>keymint_ros2_dds</build_type></export>
</package>""",
        "identities.xml": f"""<package><identities>
  <identity name="{name}"><cert><serial_number></serial_number></cert></identity>
</identities></package>""",
        "governance.xml": """<package><domain_access_rules>
  <domain_rule><enable_join_access_control>true</enable_join_access_control></domain_rule>
</domain_access_rules></package>""",
        "permissions.xml": f"""<package><permissions><grant name="{name}">
  <allow_rule><ros_publish><ros_topics><ros_topic>/anything</ros_topic></ros_topics></ros_publish></allow_rule>
  <default>DENY</default>
</grant></permissions></package>""",
    }


def write(root: Path, link: str = "") -> None:
    """Write the profile and source space of a workspace.

    Args:
        root: the folder of the workspace; must not exist.
        link: what ``package.defaults`` of each package links to; by default, the relative path of the profile's.
    """
    for path, content in _PROFILE.items():
        _file(root / "profile" / path, content)
    for name in PACKAGES:
        folder = root / "src" / name
        for path, content in _package(name).items():
            _file(folder / path, content)
        (folder / "package.defaults").symlink_to(link or f"{'../' * (name.count('/') + 2)}profile/package.defaults")


def write_build(root: Path) -> None:
    """Write a build space as the tool of 2018 left it: its key and request, and documents of older sources."""
    for name in PACKAGES:
        for path in ("permissions.xml", "governance.xml", "key.pem", "csr.pem"):
            _file(root / "build" / name / path, f"<dds><!-- stale {path} of {name} --></dds>")


def _file(path: Path, content: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
