# SPDX-License-Identifier: Apache-2.0
"""A signed governance becomes the source of a profile, and is compared by what it means."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.keystores import governance_as_source

from tests import sros2_keystore

DOCUMENT = sros2_keystore.governance(3)


def test_the_source_has_what_the_document_says() -> None:
    source = governance_as_source.source(DOCUMENT, "ca")
    assert source is not None
    text = source.decode()
    assert "<issuer_name>ca</issuer_name>" in text
    assert "<id>3</id>" in text
    assert "<rtps_protection_kind>SIGN</rtps_protection_kind>" in text
    assert "<topic_expression>*</topic_expression>" in text


def test_several_domain_rules_are_no_defaults() -> None:
    rule = DOCUMENT[DOCUMENT.index(b"        <domain_rule>") : DOCUMENT.index(b"    </domain_access_rules>")]
    assert governance_as_source.source(DOCUMENT.replace(rule, rule * 2), "ca") is None


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        (b"        ", b" ", True),
        (b"true", b"1", True),
        (b"<id>3</id>", b"<id>4</id>", False),
        (b"<rtps_protection_kind>SIGN", b"<rtps_protection_kind>NONE", False),
        (b"<enable_read_access_control>true", b"<enable_read_access_control>false", False),
        (b"<topic_expression>*", b"<topic_expression>rt/*", False),
        (b"<enable_liveliness_protection>true", b"<enable_liveliness_protection>false", False),
        (b"<data_protection_kind>ENCRYPT", b"<data_protection_kind>SIGN", False),
    ],
)
def test_documents_are_compared_by_what_they_mean(old: bytes, new: bytes, same: bool) -> None:
    assert old in DOCUMENT
    assert governance_as_source.is_same(DOCUMENT, DOCUMENT.replace(old, new)) is same
