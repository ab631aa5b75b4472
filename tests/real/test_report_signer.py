# SPDX-License-Identifier: Apache-2.0
"""A vendor obeys no rights that the authority of reports signed, whatever it signs."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from keymint.pki import certificates, keys, smime
from tests.keymint.commands.assure.test_report import with_audit_ca

from .test_signed_files import permitted

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pytest
    from keymint_ros2_dds.vendors.participants import Vendor

    from tests.conftest import Outcome

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude"><profile name="talker">
  <attachment>/talker</attachment><xi:include href="common/node.xml" parse="xml"/>
  <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
</profile></profiles>
"""


def test_a_vendor_refuses_rights_that_the_signer_of_reports_signed(
    keymint: Callable[..., Outcome], vendor: Vendor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(int(time.time())))  # vendors have the clock of the machine
    (tmp_path / "policy.xml").write_text(POLICY)
    assert keymint("provision", "policy.xml", "-w", "ws").code == 0
    with_audit_ca(tmp_path / "ws")
    assert keymint("install", "-w", "ws").code == 0
    enclave = tmp_path / "ws/install/enclaves/talker"
    assert permitted(vendor, enclave, "rt/x") == [True]
    own = certificates.load((tmp_path / "ws/public/audit_ca.cert.pem").read_bytes())
    key = keys.from_pem((tmp_path / "ws/private/audit_ca.key.pem").read_bytes(), None, None)
    document = enclave / "permissions.p7s"
    content = smime.signed_content(document.read_bytes())
    document.unlink()
    document.write_bytes(smime.sign(content, own, key))
    assert permitted(vendor, enclave, "rt/x") == [False]
