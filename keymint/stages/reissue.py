# SPDX-License-Identifier: Apache-2.0
"""Issue the certificates and documents of some packages again, after their sources changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from datetime import datetime

from keymint.api import BuildOptions, LoadedPolicy, Role
from keymint.authority.authorities import plan_authorities
from keymint.authority.authority_files import bundled
from keymint.life.earlier_rights import RIGHTS_OUTLIVE
from keymint.life.issued_certificates import SUPERSEDED
from keymint.life.revocation_lists_in_force import plan_lists
from keymint.life.revoking import plan_revocation
from keymint.life.workspace_register import complete_register
from keymint.names import name_of
from keymint.stages.build import BuildStage, options_as_built
from keymint.stages.distribution import plan_distribution
from keymint.stages.install import InstallStage
from keymint.stages.install_request import InstallRequest
from keymint.stages.package_stage import Crew
from keymint.stages.proof.proof_gate import proof_stage, proven
from keymint.store.changes import Action, Plan
from keymint.workspace.installed_enclaves import INSTALLED, with_sources
from keymint.workspace.package_build_types import is_build_current
from keymint.workspace.policy_loading import policy_in_force
from keymint.workspace.session import Session


def reissued(
    crew: Crew,
    session: Session,
    first: Plan,
    names: Sequence[str],
    *,
    request: InstallRequest = InstallRequest(),  # noqa: B008 - frozen
    rekey: Collection[str] = (),
    refresh: Collection[str] = (),
    list_end: datetime | None = None,
    policy: LoadedPolicy | None = None,
) -> Plan:
    """Return a plan followed by what builds, signs and installs some packages, and the revocation lists for all others.

    Nothing else changes: the other enclaves get new revocation lists only.

    Args:
        crew: who plans packages.
        session: the workspace before the plan, and its profile.
        first: what changes the sources, the register or the authorities.
        names: the packages to issue again.
        request: what the user asks for.
        rekey: those of them that get a new key.
        refresh: authorities whose revocation list is issued again in any case.
        list_end: nextUpdate of new revocation lists, UTC; the end of the authority's certificate by default.
        policy: what the documents are proven against; by default the policy of the workspace, with what ROS
            packages ship as it was accepted.

    Raises:
        KeymintError: a package cannot be built, signed or proven, or an authority cannot sign; with all defects.
    """
    before, start = session, session.after(first)
    minted, authorities = plan_authorities(start, request.new_authority)
    session = start.after(minted)
    revoked = plan_lists(session, authorities, register=complete_register(session), refresh=refresh, end=list_end)
    session = session.after(revoked)
    names = following(before, session, names, revoked)
    built, as_built = rebuilt(session, names, request, rekey)
    session = session.after(built)
    install = InstallStage(session, authorities, prune=request.prune)
    planned = [install.package(name) for name in names]
    installed = install.plan(planned)
    if narrower := superseding(start, installed, request):
        return reissued(
            crew, before, first.then(narrower), names, request=request, rekey=rekey, refresh=refresh,
            list_end=list_end, policy=policy,
        )  # fmt: skip
    others = plan_distribution(before, session.after(installed), names)
    plan = first.then(minted).then(revoked).then(built).then(installed).then(others)
    issued = [each.name for each in planned if not each.withdrawn]
    if not request.prove or not issued:
        return plan
    vendor_specific = any(as_built[name].allow_vendor_specific for name in issued)
    request = replace(request, allow_vendor_specific=request.allow_vendor_specific or vendor_specific)
    in_force, warnings = (policy, ()) if policy else policy_in_force(session)
    plan, proof = plan.noting(*warnings), proof_stage(crew, in_force, request)
    return proven(crew, session, installed.then(others), issued, proof, plan, request)


def following(before: Session, session: Session, names: Sequence[str], revoked: Plan) -> tuple[str, ...]:
    """Return packages that are issued again, and those that must follow them.

    Args:
        before: the workspace before the sources changed.
        session: the workspace with the changed sources.
        names: the packages.
        revoked: the plan of the revocation lists.
    """
    if any(session.role(name) is Role.INFRASTRUCTURE for name in names):
        # All others name it, so they follow its generation; those whose own sources changed wait for their build.
        built_of = [
            name
            for name in session.packages()
            if is_build_current(before, name) and not is_build_current(session, name)
        ]
        names = tuple(dict.fromkeys((*names, *built_of)))
    if revoked.writes() and any(map(bundled, session.profile.authorities)):
        names = tuple(dict.fromkeys((*names, *with_sources(session))))  # their authorities' file has the lists
    return tuple(names)


def rebuilt(
    session: Session, names: Sequence[str], request: InstallRequest, rekey: Collection[str] = ()
) -> tuple[Plan, Mapping[str, BuildOptions]]:
    """Return the plan that builds some packages, and the options of each.

    Args:
        session: the workspace and its profile.
        names: the packages.
        request: what the user asks for.
        rekey: those of them that get a new key.

    Raises:
        KeymintError: the errors of all packages.
    """
    of_package = {name: request.build or options_as_built(session, name) for name in names}
    packages = [BuildStage(session, of_package[name], renew=name in rekey).package(name) for name in names]
    shared = next(iter(of_package.values()), BuildOptions())
    return BuildStage(session, shared).plan(packages), of_package


def reissued_by_profile(crew: Crew, session: Session, first: Plan, names: Sequence[str]) -> Plan:
    """Return a plan that changes the profile, followed by what issues packages again as the changed profile says.

    Args:
        crew: who plans packages.
        session: the workspace before the plan, and its profile.
        first: what changes the profile.
        names: the packages to issue again.

    Raises:
        KeymintError: as :func:`reissued`.
    """
    after = session.after(first).session()
    return first.then(reissued(crew, after, Plan((), after.state), names))


def updated(plan: Plan) -> list[str]:
    """Return the packages whose enclave a plan writes."""
    changing = {Action.UPDATED, Action.CREATED}
    steps = (step for step in plan.steps if step.stage == INSTALLED and step.action in changing)
    return [step.package for step in steps if step.package]


def superseding(session: Session, installed: Plan, request: InstallRequest) -> Plan | None:
    """Return the plan that revokes the certificates of packages whose new signed rights are narrower, or None.

    What is planned so far is then planned again after it: each package gets a certificate of a new generation.

    Args:
        session: the workspace before its authorities and the stages; its profile may ask for it.
        installed: the plan of an installation.
        request: the user may ask for it.

    Raises:
        KeymintError: the register is missing and cannot be restored.
    """
    asked = request.revoke_superseded or session.profile.revoke_superseded
    found = dict.fromkeys(name_of(each.subject) for each in installed.diagnostics if each.code == RIGHTS_OUTLIVE)
    if not asked or not found:
        return None
    revoking = plan_revocation(session, tuple(found), SUPERSEDED)
    return revoking.plan.noting(*revoking.diagnostics) if revoking.plan.writes() else None
