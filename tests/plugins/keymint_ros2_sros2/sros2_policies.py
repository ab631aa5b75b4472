# SPDX-License-Identifier: Apache-2.0
"""SROS2 policies of our own, in the forms that SROS2's documentation and its common files have."""

from __future__ import annotations

XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'
DRAFT = 'xmlns:xi="http://www.w3.org/2003/XInclude"'

LOGGING = '<profile><topics publish="ALLOW"><topic>rosout</topic></topics></profile>'
TIME = '<profile><topics subscribe="ALLOW"><topic>/clock</topic></topics></profile>'
SERVICES = (
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
    "set_parameters_atomically",
)  # fmt: skip
PARAMETERS = (
    '<profile><topics publish="ALLOW" subscribe="ALLOW"><topic>/parameter_events</topic></topics>'
    '<services reply="ALLOW" request="ALLOW">'
    + "".join(f"<service>~/{name}</service>" for name in SERVICES)
    + "</services></profile>"
)
NODE = f"""<profile {DRAFT}>
  <xi:include href="node/logging.xml" xpointer="xpointer(/profile/*)"/>
  <xi:include href="node/time.xml" xpointer="xpointer(/profile/*)"/>
  <xi:include href="node/parameters.xml" xpointer="xpointer(/profile/*)"/>
</profile>
"""
COMMON = {
    "common/node.xml": NODE,
    "common/node/logging.xml": LOGGING,
    "common/node/time.xml": TIME,
    "common/node/parameters.xml": PARAMETERS,
}
"""The shape of the common files that SROS2's examples include."""
INCLUDE = '<xi:include href="common/node.xml" xpointer="xpointer(/profile/*)"/>'


def enclave(path: str, rules: str, ns: str = "/", node: str = "n") -> str:
    """Return an enclave with one node."""
    return f'<enclave path="{path}"><profiles><profile ns="{ns}" node="{node}">{rules}</profile></profiles></enclave>'


def policy(*enclaves: str) -> str:
    """Return a policy of version 0.2.0."""
    return f'<policy version="0.2.0" {XI}><enclaves>{"".join(enclaves)}</enclaves></policy>'


ROBOT = policy(
    enclave("/robot/talker", INCLUDE + '<topics publish="ALLOW"><topic>chatter</topic></topics>', "/robot", "talker"),
    enclave(
        "/robot/listener",
        '<topics subscribe="ALLOW" publish="DENY"><topic>/robot/*</topic></topics>'
        '<services request="ALLOW"><service>add</service></services>'
        '<actions call="ALLOW"><action>dock</action></actions>',
        "/robot", "listener",
    ),
)  # fmt: skip
