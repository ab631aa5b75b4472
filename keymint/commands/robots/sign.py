# SPDX-License-Identifier: Apache-2.0
"""``keymint sign``: certify the keys that robots made. For which package is a key, and may it be certified?

Possession of a key proves nothing about a robot: whoever carries a request may put one of his own in its place. So a
key is taken if its fingerprint was read at the robot, or if the key that the package has vouches for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from comarmor.text import did_you_mean
from comarmor.values import replace
from keymint.authority.authorities import plan_authorities
from keymint.command_line.named_files import read_input
from keymint.command_line.options import bundle_output_option, prove_option
from keymint.command_line.verb import FILE, Report, Run, argument, option, verb
from keymint.commands.robots.accept import fingerprint
from keymint.commands.robots.bundle import MadeBundle, plan_bundles, require_output, write_bundles
from keymint.errors import Defects, KeymintError, Origin, usage_error
from keymint.life.examine import Keyring
from keymint.life.package_issuance import plan_issuance
from keymint.life.workspace_register import register_of
from keymint.names import package_name, subject_of
from keymint.pki import keys
from keymint.pki.distinguished_names import common_name
from keymint.robots import certification_request as requests
from keymint.robots.certification_request import CertificationRequest
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import known_fingerprint

STAGE = "sign"


@verb(dry_run=True)
def sign(
    run: Run,
    files: tuple[Path, ...] = argument(nargs=-1, required=True, type=FILE, metavar="REQUEST..."),
    typed: tuple[str, ...] = option("--fingerprint", multiple=True, metavar="NAME=SHA256"),
    output: Path | None = bundle_output_option,
    prove: bool = prove_option,
) -> Report:
    """Certify keys that robots made ('keymint request'), and write the bundles that they take ('keymint accept').

    Only the public key is taken from a request; the name, the validity and the rights are those of the package
    here. Whoever carried the request may have exchanged the key in it. So give its fingerprint, as read at the
    robot, unless the package's present key signed the request.

    Options:
        typed: The fingerprint of the key, as read at the robot; 'keymint request' prints it there. May be repeated.
    """
    fingerprints: dict[str, str] = {}
    for each in typed:
        name, equals, digits = each.rpartition("=")
        if not equals:
            raise usage_error(f"--fingerprint {each!r} does not say which enclave it is of", "write NAME=SHA256")
        fingerprints[package_name(name)] = fingerprint(digits)
    given = [
        (requests.read(read_input(run, file, requests.MAX_BYTES), Origin(str(file))), Origin(str(file)))
        for file in files
    ]
    require_output(run, output, len(given))

    made: list[MadeBundle] = []

    def make_plan(session: Session) -> Plan:
        decided, chosen = plan_requests(session, given, fingerprints)
        request = Request(list(chosen), options=InstallRequest(prove=prove), change=decided)
        work = conduct(Work(session), request, run.crew)
        _, authorities = plan_authorities(work.session)
        numbered, made[:] = plan_bundles(work.session, chosen, authorities)
        return work.then(numbered).plan

    report = run.change(make_plan)
    return replace(report, result={"bundles": write_bundles(run, output, made)})


# -- decisions ---------------------------------------------------------------------------------------------------


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
    known, folder = session.packages(), session.workspace.shown(session.workspace.src)
    for name in fingerprints:
        if name not in known:
            message = f"no package {name!r} in {folder}, although its fingerprint is given"
            help_ = did_you_mean(name, known, f"'keymint create {name}' makes it")
            raise KeymintError(message, help=help_, code="package-unknown")
    requests: dict[str, CertificationRequest] = {}
    defects, keyring = Defects(), Keyring(session)
    for request, where in given:
        with defects:
            name = _package(session, request, where, fingerprints)
            if name in requests:
                message = f"is for {subject_of(name)}, as another request is"
                raise KeymintError(message, where=where, help="sign the later one", code="request-twice")
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
        message = f"is for {request.common_name}, and no package has that name"
        known = [subject_of(name) for name in session.packages()]
        help_ = did_you_mean(request.common_name, known, "'keymint create' makes it")
        raise KeymintError(message, where=where, help=help_, code="request-unknown")
    if confirmed := [name for name in named if fingerprints.get(name) == request.fingerprint]:
        return confirmed[0]
    if asked := [name for name in named if name in fingerprints]:
        wrong = f"not the one whose fingerprint is given for /{asked[0]}: somebody may have exchanged it on its way"
        message = f"has the key {request.fingerprint}, {wrong}"
        help_ = "read the fingerprint at the robot again, where 'keymint request' prints it"
        raise KeymintError(message, where=where, help=help_, code="request-exchanged")
    for name in named:
        # The key that the package has may sign the request, for itself or for another key.
        current = current_fingerprint(session, name)
        if current and current in {request.fingerprint, request.signer} and not register_of(session).barred(current):
            return name
    why = ", and the key that signs it is not the one that the package has" if request.signer else ""
    message = f"nobody confirms that its key is that of {subject_of(named[0])}{why}"
    help_ = f"read the fingerprint at the robot and give it: --fingerprint {subject_of(named[0])}=…"
    raise KeymintError(message, where=where, help=help_, code="request-unconfirmed")


def current_fingerprint(session: Session, name: str) -> str:
    """Return the fingerprint of the key that a package has, wherever it is; empty if it has none yet."""
    if public := session.issuance(name).public_key:
        return keys.fingerprint(keys.public_from_pem(public, session.issuance_place(name)))
    return known_fingerprint(session, name)
