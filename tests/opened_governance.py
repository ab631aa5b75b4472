# SPDX-License-Identifier: Apache-2.0
"""A governance with a rule that opens names which no policy mentions, signed with the workspace's own key."""

from __future__ import annotations

import re
from pathlib import Path

from keymint.pki import certificates, keys, smime


def open_governance(workspace: Path, package: str, expression: str) -> None:
    """Put a rule without access control before the others, in the governance of one enclave."""
    file = (workspace / "install/enclaves" / package / "governance.p7s").resolve()
    certificate = certificates.load((workspace / "public/permissions_ca.cert.pem").read_bytes())
    key = keys.from_pem((workspace / "private/permissions_ca.key.pem").read_bytes(), None)
    content = smime.signed_content(file.read_bytes()).decode()
    rule = content[content.index("<topic_rule>") : content.index("</topic_rule>")] + "</topic_rule>"
    opened = re.sub(r"(<enable_(?:read|write)_access_control>)true", r"\1false", rule)
    opened = re.sub(r"<topic_expression>.*<", f"<topic_expression>{expression}<", opened)
    assert opened != rule
    file.write_bytes(smime.sign(content.replace(rule, f"{opened}{rule}", 1).encode(), certificate, key))
