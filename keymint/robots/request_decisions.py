# SPDX-License-Identifier: Apache-2.0
"""Decide about requests of robots: for which package is the key, and may it be certified?

Possession of a key proves nothing about a robot: whoever carries a request may put one of his own in its place. So a
key is taken if its fingerprint was read at the robot, or if the key that the package has vouches for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Defects, Origin
from comarmor.text import did_you_mean
from keymint.errors import KeymintError
from keymint.life.examine import Keyring
from keymint.life.package_issuance import place_of, plan_issuance
from keymint.life.workspace_register import register_of
from keymint.names import subject_of
from keymint.pki import keys
from keymint.pki.distinguished_names import common_name
from keymint.robots.certification_request import CertificationRequest
from keymint.store.changes import Plan
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import known_fingerprint

STAGE = "sign"


def plan_requests(
    session: Session, given: Sequence[tuple[CertificationRequest, Origin]], fingerprints: Mapping[str, str]
) -> tuple[Plan, Mapping[str, CertificationRequest]]:
    """Plan to certify the keys of some requests.

    Args:
        session: the workspace and its profile.
        given: the requests, each with the file that it was read from.
        fingerprints: fingerprints of keys, as they were read at the robots, by package.

    Returns:
        The plan for the sources, and the requests by package.

    Raises:
        KeymintError: the defects of all requests. ``request-unknown``: no package has the name that it claims.
            ``request-unconfirmed``: nobody confirms that the key is the robot's. ``request-exchanged``: the fingerprint
            is that of another key. ``key-kind``, ``key-barred``, ``key-shared``, ``key-of-authority``: the key cannot
            be certified.
    """
    known = session.packages()
    for name in fingerprints:
        if name not in known:
            raise KeymintError(
                f"no package {name!r} in {session.workspace.shown(session.workspace.src)}, although its fingerprint is "
                "given",
                help=did_you_mean(name, known, f"'keymint create {name}' makes it"),
                code="package-unknown",
            )
    requests: dict[str, CertificationRequest] = {}
    defects, keyring = Defects(), Keyring(session)
    for request, where in given:
        with defects:
            name = _package(session, request, where, fingerprints)
            if name in requests:
                raise _refused(
                    f"is for {subject_of(name)}, as another request is", where, "sign the later one", "request-twice"
                )
            keyring.require_certifiable(session.package(name), request.public_key, where)
            requests[name] = request
    defects.require_none()
    new = {
        name: replace(session.issuance(name), public_key=request.public_key)
        for name, request in requests.items()
        # The workspace may have the private key itself, as that of a robot that was provisioned from here.
        if session.issuance(name).public_key or known_fingerprint(session, name) != request.fingerprint
    }
    return plan_issuance(session, STAGE, new, "its key is on the robot"), requests


def _package(session: Session, request: CertificationRequest, where: Origin, fingerprints: Mapping[str, str]) -> str:
    """Return the package that a request is for, which somebody or its own key must confirm."""
    named = [name for name in session.packages() if common_name(subject_of(name)) == request.common_name]
    if not named:
        raise _refused(
            f"is for {request.common_name}, and no package has that name",
            where,
            did_you_mean(
                request.common_name, [subject_of(name) for name in session.packages()], "'keymint create' makes it"
            ),
            "request-unknown",
        )
    if confirmed := [name for name in named if fingerprints.get(name) == request.fingerprint]:
        return confirmed[0]
    if asked := [name for name in named if name in fingerprints]:
        raise _refused(
            f"has the key {request.fingerprint}, not the one whose fingerprint is given for /{asked[0]}: somebody may "
            "have exchanged it on its way",
            where,
            "read the fingerprint at the robot again, where 'keymint request' prints it",
            "request-exchanged",
        )
    for name in named:
        # The key that the package has may sign the request, for itself or for another key.
        current = current_fingerprint(session, name)
        if current and current in {request.fingerprint, request.signer} and not register_of(session).barred(current):
            return name
    why = ", and the key that signs it is not the one that the package has" if request.signer else ""
    raise _refused(
        f"nobody confirms that its key is that of {subject_of(named[0])}{why}",
        where,
        f"read the fingerprint at the robot and give it: --fingerprint {subject_of(named[0])}=…",
        "request-unconfirmed",
    )


def current_fingerprint(session: Session, name: str) -> str:
    """Return the fingerprint of the key that a package has, wherever it is; empty if it has none yet."""
    if public := session.issuance(name).public_key:
        return keys.fingerprint(keys.public_from_pem(public, place_of(session, name)))
    return known_fingerprint(session, name)


def _refused(message: str, where: Origin, help_: str, code: str) -> KeymintError:
    return KeymintError(message, where=where, help=help_, code=code)
