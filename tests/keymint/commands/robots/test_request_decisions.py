# SPDX-License-Identifier: Apache-2.0
"""Whose key a request is for."""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from comarmor.errors import Origin
from keymint.commands.robots.sign import current_fingerprint, plan_requests
from keymint.errors import KeymintError
from keymint.pki import keys
from keymint.robots import certification_request
from keymint.workspace.session import Session
from tests.keymint.stages.sessions import session_of

NONCE = "0123456789abcdef" * 2
KEY = ec.derive_private_key(20_261_122, ec.SECP256R1())
PRINT = keys.fingerprint(KEY)
Asked = tuple[certification_request.CertificationRequest, Origin]


def given(name: str = "/talker", key: ec.EllipticCurvePrivateKey = KEY) -> Asked:
    where = Origin(f"{name.replace('/', '')}.pem")
    return certification_request.read(certification_request.make(name, key, NONCE), where), where


def codes(session: Session, *requests: Asked, **fingerprints: str) -> list[str]:
    with pytest.raises(KeymintError) as refused:
        plan_requests(session, requests, fingerprints)
    return [each.code for each in refused.value.diagnostics]


def test_the_sources_get_the_public_key(ws: Path) -> None:
    session = session_of(ws)
    plan, requests = plan_requests(session, [given()], {"talker": PRINT})
    assert list(requests) == ["talker"]
    [step] = plan.steps
    assert (step.stage, step.package) == ("sign", "talker")
    [change] = step.changes
    assert list(change.files) == ["issuance.xml"]
    after = session.after(plan)
    assert after.package("talker").issuance.public_key == requests["talker"].public_key
    assert current_fingerprint(after, "talker") == PRINT
    # From now on the key confirms itself.
    assert plan_requests(after, [given()], {})[1] == requests


def test_a_key_that_is_here_stays_here(ws: Path) -> None:
    session = session_of(ws)
    own = keys.from_pem((ws / "private/identities/talker/key.pem").read_bytes())
    assert isinstance(own, ec.EllipticCurvePrivateKey)
    plan, requests = plan_requests(session, [given(key=own)], {})
    assert (plan.steps, list(requests)) == ((), ["talker"])


def test_long_names_that_are_shortened_to_one(ws: Path) -> None:
    """The common name of a certificate has the last segments only; the fingerprint says which package is meant."""
    end = "/".join(["segment_of_a_name"] * 3)
    tail = f"segment_of_a_name/{end}"
    for top in ("one", "two"):
        folder = ws / "src" / top / tail
        folder.mkdir(parents=True)
        for file in (ws / "src/talker").glob("*.xml"):
            (folder / file.name).write_text(file.read_text().replace("/talker", f"/{top}/{tail}"))
    session = session_of(ws)
    asked = given(f"/{end}")
    assert codes(session, asked) == ["request-unconfirmed"]
    _, requests = plan_requests(session, [asked], {f"two/{tail}": PRINT})
    assert list(requests) == [f"two/{tail}"]


def test_all_defects_together(ws: Path) -> None:
    session = session_of(ws)
    assert codes(session, given(), given("/nobody")) == ["request-unconfirmed", "request-unknown"]
    assert codes(session, given(), talker="0" * 64) == ["request-exchanged"]
    assert codes(session, given(), nobody=PRINT) == ["package-unknown"]
    assert codes(session, given(), given(), talker=PRINT) == ["request-twice"]
