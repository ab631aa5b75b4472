# SPDX-License-Identifier: Apache-2.0
"""Unusual documents: the models read them as the vendors do.

Where a model says that it does not know, nothing is compared; ``docs/vendors.md`` has the kinds.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.serialization import pkcs7
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, Variation
from keymint_ros2_dds.reading import signed_permissions
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor

from keymint.errors import KeymintError
from keymint.host.vendor_process import ProcessFailedError

from .conftest import variation_of
from .handmade import Authorities, criteria, governance_document, permissions_document, rule

if TYPE_CHECKING:
    from pathlib import Path


QUESTIONS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("publish", "rt/x", ()), ("publish", "rt/y", ()), ("publish", "rt/z", ()), ("subscribe", "rt/s", ()),
    ("publish", "rt/", ()), ("publish", "rt/other", ()), ("publish", "rt/p", ("a",)),
)  # fmt: skip
PLAIN = permissions_document(
    "CN=/talker",
    rule("allow", criteria("publish", ["rt/x", "rt/y"]) + criteria("subscribe", ["rt/s"]))
    + rule("deny", criteria("publish", ["rt/zz*"]))
    + rule("allow", criteria("publish", ["rt/z*"]) + criteria("publish", ["rt/p"], ["a"])),
)
WIDE = governance_document(domains="<id_range><min>0</min><max>230</max></id_range>")
DATE = r"<not_before>.*?</not_before>"
END = r"<not_after>.*?</not_after>"
XSI = ' xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
IN_AN_HOUR = "IN_AN_HOUR"  # A clock in a parameter would make the test workers collect different tests.
DATES = (
    "Y-01-01T00:00:00Z", "Y-01-01T00:00:00.5", "Y-01-01T00:00:00+13:00", "Y-02-30T00:00:00", "Y-01-01T24:00:00",
    "Y-01-01", " Y-01-01T00:00:00 ", "garbage", "Y-01-01T00:00:00x", "Y-01-01T00:00:60", "0Y-01-01T00:00:00", "",
)  # fmt: skip

COMMON = [
    ("", ""), ("<topic>", "<topic\n>"), ("<publish>", "\n  <publish>\n  "),
    *((old, f"<!-- c -->{old}") for old in ("<dds", "<grant", "<publish>", "<default>", "</dds>")),
    (r"<\?xml.*?\?>\n", ""), ("UTF-8", "ISO-8859-1"), (r"<\?xml", "\ufeff<?xml"), ("</topic>", "</topic >"),
    ("<dds", f"<dds{XSI}"), ("<dds", f'<dds{XSI} xsi:noNamespaceSchemaLocation="x"'),
    ("<dds", f'<dds xsi:noNamespaceSchemaLocation="x"{XSI}'),
    ("rt/x<", "rt/&amp;<"), ("rt/x<", " rt/x<"), ("<id>0</id>", "<id> 0 </id>"), ("CN=/talker", " CN=/talker "),
    ("<id>0</id>", "<id>230</id>"), ("<id>0</id>", "<id>231</id>"), ("<id>0</id>", "<id_range><min>0</min></id_range>"),
    (DATE, "<not_before>2020-01-01T00:00:00+02:00</not_before>"),
]  # fmt: skip
"""Common edits by hand; the models cover all of them."""
CHANGES = [
    *COMMON,
    *((old, f"{comment}{old}") for comment in ("<!-- c -->", "<?a b?>")
      for old in ("<dds", "<grant", "<publish>", "<id>", "</id>", "rt/x<", "x</topic>", "</dds>", "CN=", "<default>")),
    ("rt/x<", "rt/<![CDATA[x]]><"), ("rt/x<", "<![CDATA[rt/]]>x<"), ("rt/x<", "<![CDATA[rt/x]]><"),
    ("rt/x<", " <!-- c -->rt/x<"), ("rt/x<", "rt/x <!-- c --><"), ("rt/x<", "rt/&#120;<"), ("rt/x<", "&#x72;t/x<"),
    ("rt/x<", "rt/&amp;<"), ("rt/x<", "\nrt/x\n<"), ("rt/x<", "rt/x&#160;<"), ("rt/x<", " rt/x<"),
    (r"<\?xml", "\ufeff<?xml"), (r"<\?xml.*?\?>\n", ""), ("UTF-8", "ISO-8859-1"),
    ("</topic>", "</topic >"), ("<topic>", "<topic\n>"), ("<publish>", '<publish a="b">'), ("<grant", '<grant a="b"'),
    ("<dds", f"<dds{XSI}"), ("<dds", f'<dds{XSI} xsi:noNamespaceSchemaLocation="x"'), ("<dds", '<dds xmlns:a="b"'),
    ("<dds", f'<dds{XSI} xsi:schemaLocation="a b"'), ("<dds", '<dds xml:lang="en"'),
    *((old, f"<foo/>{old}") for old in
      ("<permissions", "<grant", "<validity", "<publish>", "<topics>", "<topic>", "<id>")),
    *((old, f"x{old}") for old in ("<permissions", "<grant", "<validity", "<publish>", "<topics>", "</allow_rule>")),
    (r"<topic>rt/x</topic>", "<TOPIC>rt/x</TOPIC>"), ("<topic>rt/x</topic>", "<topic/>"),
    ("<topic>rt/x</topic>", "<topic> </topic>"), ("<topics>.*?</topics>", "<topics/>"), ("<topics>.*?</topics>", ""),
    ("<partition>a</partition>", "<partition> </partition>"), ("<partition>a</partition>", ""),
    ("<partition>a</partition>", "<partition> a </partition>"),
    ("(<default>.*?</default>)(.*)", r"\2"), ("<default>DENY</default>", "<default/>"), ("DENY", "deny"),
    ("DENY", " ALLOW "), ("DENY", "MAYBE"), ("(<validity>.*</validity>)(.*)(<default>.*</default>)", r"\1\3\2"),
    ("(<deny_rule>.*</deny_rule>)(.*)(<default>.*</default>)", r"\3\1\2"),
    ("(<default>.*</default>)", r"\1<default>ALLOW</default>"), ("(<default>.*</default>)", r"\1<allow_rule/>"),
    ("<domains>.*?</domains>", ""), ("<domains>.*?</domains>", "<domains/>"),
    *(("<id>0</id>", f"<id>{number}</id>") for number in
      ("00", "010", "08", "+0", "-0", " 0 ", "4294967296", "2147483648", "-1", "231", "230", "99999999999999999999")),
    ("<id>0</id>", "<id_range><min>0</min></id_range>"), ("<id>0</id>", "<id_range/>"),
    ("<id>0</id>", "<id_range><max>3</max><min>0</min></id_range>"),
    ("<id>0</id>", "<id_range><min>3</min><max>0</max></id_range>"),
    (' name="grant"', ""), ("<subject_name>.*</subject_name>", ""), ("CN=/talker", ""), ("CN=/talker", " CN=/talker "),
    ("(<subject_name>.*</subject_name>)(<validity>.*</validity>)", r"\2\1"),
    ("(<publish>.*?</publish>)(<subscribe>.*?</subscribe>)", r"\2\1"),
    *(("<subscribe>", f"<relay>{body}</relay><subscribe>") for body in ("", "<topics/>", "<topics><topic/></topics>")),
    ("</topics>", "</topics><data_tags/>"), ("</topics>", "</topics><data_tags><tag/></data_tags>"),
    ("<permissions>.*</permissions>", "<permissions/>"),
    *((pattern, f"<{name}>{date.replace('Y', year)}</{name}>")
      for pattern, name, year in ((DATE, "not_before", "2020"), (END, "not_after", "2040")) for date in DATES),
    (END, f"<not_after>{IN_AN_HOUR}+02:00</not_after>"), (END, "<not_after>2262-04-11T23:47:17</not_after>"),
    (END, "<not_after>2262-04-11T23:47:16</not_after>"), (DATE, "<not_before>2263-01-01T00:00:00</not_before>"),
]  # fmt: skip


def changed(old: str, new: str) -> str:
    hour = f"{datetime.now(UTC) + timedelta(hours=1):%Y-%m-%dT%H:%M:%S}"
    new = new.replace(IN_AN_HOUR, hour)
    found, count = re.subn(old, new.replace("\\n", "\n"), PLAIN, count=1, flags=re.DOTALL)
    assert count == 1
    return found


def answers(system: System, folder: Path) -> list[bool]:
    """Return what the vendor permits a participant; nothing if it is refused or its process ends."""
    try:
        participant = system.open(folder)
        return [participant.allows(*question) for question in QUESTIONS]
    except (RefusedError, ProcessFailedError):
        return [False] * len(QUESTIONS)


def expected(content: bytes, variation: Variation) -> list[bool] | None:
    """Return what the model permits; None if it does not know."""
    try:
        document = signed_permissions.read(content)
    except KeymintError:
        return None
    if not variation.semantics.refusal(document) and variation.semantics.unmodelled(document):
        return None
    judge = DocumentEvaluator(document, "CN=/talker", datetime.now(UTC), 0, variation)
    return [judge.joins and judge.decide(*question).allowed for question in QUESTIONS]


@pytest.mark.parametrize(("old", "new"), CHANGES)
def test_models_read_as_vendors_do(
    authorities: Authorities, vendor: Vendor, tmp_path: Path, old: str, new: str
) -> None:
    content = changed(old, new).encode()
    said = expected(content, variation_of(vendor))
    if said is None:
        return
    folder = authorities.enclave(tmp_path, governance=WIDE, permissions=PLAIN)
    (folder / "permissions.p7s").write_bytes(signed(authorities, content))
    with System(vendor) as system:
        assert answers(system, folder) == said


@pytest.mark.parametrize("variation", [CYCLONEDDS_0_10, FASTDDS_2_9], ids=lambda each: each.name)
@pytest.mark.parametrize(("old", "new"), COMMON)
def test_the_models_know_common_edits(variation: Variation, old: str, new: str) -> None:
    assert expected(changed(old, new).encode(), variation) is not None


def signed(authorities: Authorities, content: bytes) -> bytes:
    """Sign bytes, even if they are not text."""
    own = authorities.permissions
    builder = pkcs7.PKCS7SignatureBuilder().set_data(content).add_signer(own.certificate, own.key, hashes.SHA256())
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    return builder.sign(serialization.Encoding.SMIME, options)
