# SPDX-License-Identifier: Apache-2.0
"""``keymint authority replace``: a new key for an authority, phase by phase."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from keymint.api import Phase
from keymint.authority import rollover
from keymint.command_line.options import authority_argument
from keymint.command_line.verb import FILE, Report, Run, flag, option, path_option, verb
from keymint.commands.life.authority_change import given_authority
from keymint.errors import Diagnostic, usage_error
from keymint.stages.rollover_phases import PhaseRequest, phase_plan
from keymint.store.changes import Plan
from keymint.workspace.session import Session


@verb(dry_run=True, of="authority")
def authority_replace(
    run: Run,
    name: str = authority_argument,
    phase: str | None = option(type=click.Choice([phase.value for phase in Phase])),
    cancel: bool = flag(),
    vendors: tuple[str, ...] = option("--vendor", multiple=True, metavar="NAME"),
    certificate: Path | None = path_option(kind=FILE),
    key_file: Path | None = path_option("--key", kind=FILE),
) -> Report:
    """Replace the key of an authority, phase by phase.

    Where subjects may trust two authorities: all enclaves get both certificates (distribute), then certificates by
    the next one (reissue), then it alone (end). Elsewhere a second keystore by the next authority is made in
    install.next/ (stage), all robots switch to it (ROS_SECURITY_KEYSTORE) at a common restart, and it becomes
    install/ (end). profile/authority_issuance.xml records the current phase; the same command again completes it.
    --dry-run says what each phase does.

    Options:
        phase: Go on to this phase: all robots have the keystore of the one before it.
        cancel: Give up: the present authority stays. Only before the next one issues.
        vendors: The fleet has only this implementation of its transport; may be repeated [all]. If all of them accept
            two authorities at once, no robot must wait for another one.
        certificate: The next authority is this one, made elsewhere.
        key_file: Its private key.
    """
    if (cancel and (phase or vendors or certificate)) or (key_file and not certificate):
        message = "these options do not go together"
        raise usage_error(message, "give --phase, --cancel, or what begins it (--vendor, --certificate, --key)")
    given = given_authority(run, certificate, key_file) if certificate else None
    request = PhaseRequest(Phase(phase) if phase else None, cancel, vendors, given)

    def make_plan(session: Session) -> Plan:
        before = rollover.phase_of(session, name)
        plan = phase_plan(run.crew, session, name, request)
        reached = rollover.phase_of(session.after(plan).session(), name)
        if run.dry_run and not cancel:
            run.console.lines(_outline(session, name, before, reached))
        told = _told(session, name, before, reached, cancelled=cancel)
        run.outcome = {"authority": name, "phase": (reached or Phase.END).value}
        return plan.noting(told)

    return run.change(make_plan)


# -- messages --------------------------------------------------------------------------------------------------------


def _outline(session: Session, name: str, before: Phase | None, reached: Phase | None) -> Iterator[str]:
    """Yield the phases, with a mark at the one that a run would carry out."""
    shown = session.workspace.shown(session.workspace.next_install)
    if Phase.STAGE in {before, reached}:
        steps = {
            Phase.STAGE: f"a second keystore by the next authority in {shown}/; copy it to all robots, "
            "beside the present",
            Phase.END: "all robots restart together with it (ROS_SECURITY_KEYSTORE); "
            "then --phase end makes it install/",
        }
    else:
        steps = {
            Phase.DISTRIBUTE: "all enclaves trust both authorities; copy them to all robots and restart these, "
            "in any order",
            Phase.REISSUE: "certificates by the next authority; copy them to all robots and restart these",
            Phase.END: "enclaves trust the next authority alone; copy them to all robots and restart these",
        }
    yield f"replacing the key of {name}:"
    for number, (each, text) in enumerate(steps.items(), 1):
        yield f"  {'>' if each is (reached or Phase.END) else ' '} {number}. {each}: {text}"


def _told(session: Session, name: str, before: Phase | None, reached: Phase | None, *, cancelled: bool) -> Diagnostic:
    """Return what is to be done on the robots before the next phase."""
    following = Phase.REISSUE if reached is Phase.DISTRIBUTE else Phase.END
    go_on = f"then 'keymint authority replace {name} --phase {following}'"
    workspace = session.workspace
    install_space, second = workspace.shown(workspace.install), workspace.shown(workspace.next_install)
    if reached is Phase.STAGE:
        text = f"{name!r}: a second keystore by the next authority is ready: copy {second}/ to all robots"
        help_ = f"set ROS_SECURITY_KEYSTORE to it, and restart all of them together; {go_on}"
    elif reached is not None:
        both = "all enclaves trust the present and the next authority"
        what = both if reached is Phase.DISTRIBUTE else "the next authority issues"
        text, help_ = f"{name!r}: {what}: copy {install_space}/ to all robots", f"restart them, in any order; {go_on}"
    elif cancelled:
        text, help_ = f"{name!r}: its key stays", f"copy {install_space}/ to the robots that got another one"
    elif before is None:
        text, help_ = f"the key of the authority {name!r} is not being replaced", f"copy {install_space}/ to all robots"
    elif before is Phase.STAGE:
        text = f"{name!r} is replaced: {install_space}/ is the keystore that all robots have"
        help_ = "the former one no longer works with any of them"
    else:
        text = f"{name!r} is replaced: nobody trusts the former authority any more"
        help_ = f"copy {install_space}/ to all robots and restart them, in any order"
    return Diagnostic.warning("rollover-phase", text, None, help_)
