# SPDX-License-Identifier: Apache-2.0
"""Issue the certificates and documents of some packages again, after their sources changed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import datetime

from keymint.api import BuildOptions, LoadedPolicy, Role
from keymint.changes import Action, Plan
from keymint.commands.proof_gate import proof_stage, proven
from keymint.commands.run import Run
from keymint.names import name_of
from keymint.plan.authorities import plan_authorities
from keymint.plan.authority_files import bundled
from keymint.plan.build import BuildStage, is_current, options_as_built
from keymint.plan.distribution import plan_distribution
from keymint.plan.enclaves import INSTALLED, with_sources
from keymint.plan.install import RIGHTS_OUTLIVE, InstallStage
from keymint.plan.policy import policy_in_force
from keymint.plan.register import complete_register
from keymint.plan.revocation import plan_lists
from keymint.session import Session


def reissued(
    run: Run,
    session: Session,
    first: Plan,
    names: Sequence[str],
    *,
    rekey: Collection[str] = (),
    prove: bool = True,
    refresh: Collection[str] = (),
    list_end: datetime | None = None,
    new_authority: Sequence[str] = (),
    options: BuildOptions | None = None,
    policy: LoadedPolicy | None = None,
) -> Plan:
    """Return a plan followed by what builds, signs and installs some packages, and the revocation lists for all others.

    Nothing else changes: the other enclaves get new revocation lists only.

    Args:
        run: the run.
        session: the workspace before the plan, and its profile.
        first: what changes the sources, the register or the authorities.
        names: the packages to issue again.
        rekey: those of them that get a new key.
        prove: require that the documents permit what the policy says.
        refresh: authorities whose revocation list is issued again in any case.
        list_end: nextUpdate of new revocation lists, UTC; the end of the authority's certificate by default.
        new_authority: authorities that get a new key and certificate.
        options: options of the build; by default those that each package was built with last.
        policy: what the documents are proven against; by default the policy of the workspace, with what ROS
            packages ship as it was accepted.

    Raises:
        KeymintError: a package cannot be built, signed or proven, or an authority cannot sign; with all defects.
    """
    before, session = session, session.after(first)
    if any(session.role(name) is Role.INFRASTRUCTURE for name in names):
        # All others name it, so they follow its generation; those whose own sources changed wait for their build.
        built_of = [name for name in session.packages() if is_current(before, name) and not is_current(session, name)]
        names = tuple(dict.fromkeys((*names, *built_of)))
    minted, authorities = plan_authorities(session, new_authority)
    session = session.after(minted)
    revoked = plan_lists(session, authorities, register=complete_register(session), refresh=refresh, end=list_end)
    session = session.after(revoked)
    if revoked.writes() and any(map(bundled, session.profile.authorities)):
        names = tuple(dict.fromkeys((*names, *with_sources(session))))  # their authorities' file has the lists
    of_package = {name: options or options_as_built(session, name) for name in names}
    packages = [BuildStage(session, of_package[name], renew=name in rekey).package(name) for name in names]
    shared = options or next(iter(of_package.values()), BuildOptions())
    built = BuildStage(session, shared).plan(packages)
    session = session.after(built)
    install = InstallStage(session, authorities, prune=False)
    planned = [install.package(name) for name in names]
    installed = install.plan(planned)
    others = plan_distribution(before, session.after(installed), names)
    plan = first.then(minted).then(revoked).then(built).then(installed).then(others)
    issued = [each.name for each in planned if not each.withdrawn]
    if not prove or not issued:
        return plan
    standard_only = any(of_package[name].allow_vendor_specific for name in issued)
    in_force, warnings = (policy, ()) if policy else policy_in_force(session)
    proof = proof_stage(run, in_force, standard_only=standard_only)
    return proven(run, session, installed.then(others), issued, proof, plan.noting(*warnings))


def reissued_by_profile(run: Run, session: Session, first: Plan, names: Sequence[str]) -> Plan:
    """Return a plan that changes the profile, followed by what issues packages again as the changed profile says.

    Args:
        run: the run.
        session: the workspace before the plan, and its profile.
        first: what changes the profile.
        names: the packages to issue again.

    Raises:
        KeymintError: as :func:`reissued`.
    """
    after = session.after(first).session()
    return first.then(reissued(run, after, Plan((), after.state), names))


def updated(plan: Plan) -> list[str]:
    """Return the packages whose enclave a plan writes."""
    changing = {Action.UPDATED, Action.CREATED}
    steps = (step for step in plan.steps if step.stage == INSTALLED and step.action in changing)
    return [step.package for step in steps if step.package]


def superseded(session: Session, installed: Plan, *, asked: bool) -> tuple[str, ...]:
    """Return the packages whose certificate is to be revoked because their new signed rights are narrower.

    Args:
        session: its profile may ask for it.
        installed: the plan of an installation.
        asked: the user asks for it.
    """
    if not asked and not session.profile.revoke_superseded:
        return ()
    found = (each for each in installed.diagnostics if each.code == RIGHTS_OUTLIVE)
    return tuple(dict.fromkeys(name_of(each.subject) for each in found))
