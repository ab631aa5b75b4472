# SPDX-License-Identifier: Apache-2.0
"""Signing authorities are asked for their keys only when something must be signed."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.authority.authorities import plan_authorities
from keymint.errors import KeymintError
from keymint.stages.identities import Signers
from tests.keymint.stages.keystores import AUTHORITY_KEYS
from tests.keymint.stages.sessions import session_of


def test_a_key_that_is_elsewhere_is_missed_at_access_only(ws: Path) -> None:
    (ws / AUTHORITY_KEYS[1]).unlink()
    _, minted = plan_authorities(session_of(ws))
    signers = Signers({"identity": minted["identity_ca"], "rights": minted["permissions_ca"]})
    assert (len(signers), [*signers]) == (2, ["identity", "rights"])
    assert signers["identity"].certificate == (ws / "public/identity_ca.cert.pem").read_bytes()
    with pytest.raises(KeymintError, match="the private key of the authority 'permissions_ca' is not here"):
        _ = signers["rights"]
    with pytest.raises(KeyError):
        _ = signers["other"]
