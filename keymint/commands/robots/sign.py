# SPDX-License-Identifier: Apache-2.0
"""``keymint sign``: certify the keys that robots made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from comarmor.errors import Origin
from keymint.authority.authorities import plan_authorities
from keymint.command_line.named_files import read_input
from keymint.command_line.options import prove_option
from keymint.command_line.verb import FILE, Report, Run, argument, option, verb
from keymint.commands.robots.accept import fingerprint
from keymint.commands.robots.bundle import bundle_output_option, require_output, write_bundles
from keymint.errors import usage_error
from keymint.names import package_name
from keymint.robots import certification_request as requests
from keymint.robots.bundle_making import MadeBundle, plan_bundles
from keymint.robots.request_decisions import plan_requests
from keymint.stages.pipeline import Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Plan
from keymint.workspace.session import Session


@verb(dry_run=True)
def sign(
    run: Run,
    files: tuple[Path, ...] = argument(nargs=-1, required=True, type=FILE, metavar="REQUEST..."),
    typed: tuple[str, ...] = option(
        "--fingerprint",
        multiple=True,
        metavar="NAME=SHA256",
        help="The fingerprint of the key, as read at the robot; 'keymint request' prints it there. May be repeated.",
    ),
    output: Path | None = bundle_output_option,
    prove: bool = prove_option,
) -> Report:
    """Certify keys that robots made ('keymint request'), and write the bundles that they take ('keymint accept').

    Only the public key is taken from a request; the name, the validity and the rights are those of the package here.
    Whoever carried the request may have exchanged the key in it. So its fingerprint, as it was read at the robot, must
    be given, unless the key that the package has signed the request.
    """
    fingerprints = _fingerprints(typed)
    given = [
        (requests.read(read_input(run, file, requests.MAX_BYTES), Origin(str(file))), Origin(str(file)))
        for file in files
    ]
    require_output(run, output, len(given))

    def make_plan(session: Session) -> tuple[Plan, Sequence[MadeBundle]]:
        decided, chosen = plan_requests(session, given, fingerprints)
        request = Request(list(chosen), options=InstallRequest(prove=prove), change=decided)
        work = conduct(Work(session), request, run.crew)
        _, authorities = plan_authorities(work.session)
        numbered, made = plan_bundles(work.session, chosen, authorities)
        return work.then(numbered).plan, made

    report, made = run.made(make_plan)
    return replace(report, result={"bundles": write_bundles(run, output, made)})


def _fingerprints(typed: tuple[str, ...]) -> Mapping[str, str]:
    """Return the fingerprints that the user typed, by package.

    Raises:
        KeymintError: one has no name, or is none; a usage error.
    """
    result: dict[str, str] = {}
    for each in typed:
        name, equals, digits = each.rpartition("=")
        if not equals:
            raise usage_error(f"--fingerprint {each!r} does not say which enclave it is of", "write NAME=SHA256")
        result[package_name(name)] = fingerprint(digits)
    return result
