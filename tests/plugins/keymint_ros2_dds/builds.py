# SPDX-License-Identifier: Apache-2.0
"""Packages built to documents, and what is written in these."""

from __future__ import annotations

import pytest
from keymint_ros2_dds import build_type
from lxml import etree

from keymint.api import BuildOptions
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.packages import package, rule

STRICT, LENIENT = BuildOptions(), BuildOptions(allow_vendor_specific=True)


CHATTER = rule("ALLOW", "ros_topic", "ros_publish", "/chatter")


def build(*rules, options=STRICT, **fields):
    return build_type.build(package(*rules, **fields), options)


def permissions(*rules, options=STRICT, **fields):
    return etree.fromstring(build(*rules, options=options, **fields).documents["permissions.xml"])


def shape(*rules, **fields):
    """Return the rules of a document as (tag, {action: topics})."""
    return [
        (
            item.tag,
            {str(each.tag): [topic.text for topic in each.find("topics")] for each in item if each.tag != "domains"},
        )
        for item in permissions(*rules, **fields).find("permissions/grant")
        if item.tag in {"allow_rule", "deny_rule"}
    ]


def refusal(*rules, **fields):
    with pytest.raises(KeymintError) as caught:
        build(*rules, **fields)
    return caught.value.diagnostics


def codes(found):
    return [item.code for item in found]
