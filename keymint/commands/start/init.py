# SPDX-License-Identifier: Apache-2.0
"""``keymint init``: create a workspace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import click

from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint.api import Bootstrap, WorkspaceProfile
from keymint.api.plugin_loader import Plugins
from keymint.authority.authorities import plan_authorities
from keymint.command_line.options import DEFAULT_DISTRO, DEFAULT_PROFILE_TYPE, distro_option, valid_for_option
from keymint.command_line.verb import PATH, Report, Run, argument, option, option_group, path_option, plugin, verb
from keymint.errors import KeymintError, Origin, usage_error
from keymint.stages.create import plan_init, policy_path, refuse_unsupported
from keymint.stages.work import Work
from keymint.store.changes import Action, Plan, Step
from keymint.workspace.policy_loading import foreign_policy
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import PROFILE_MARKER, Workspace


class ProfileOptions(Data):
    """What shapes the profile of a new workspace; None for an option that was not given.

    Options:
        transports: Transport to provision for; may be repeated [that of the profile type].
        domain: Domain id [0].
        layout: Layout of install/, of those that the transport has [the one that the distribution reads].
        subject_format: Form of subject names in certificates, of those that the profile type has [unique].
    """

    profile_type: str | None = plugin(
        "keymint.profile_types",
        help=f"Plugin that makes the profile; 'keymint plugins' lists them [{DEFAULT_PROFILE_TYPE}].",
    )
    distro: str | None = distro_option
    transports: tuple[str, ...] = option("--transport", multiple=True, metavar="NAME")
    domain: int | None = option(type=click.IntRange(0, 230), metavar="N")
    layout: str | None = option(metavar="NAME")
    subject_format: str | None = option(metavar="NAME", hidden=True)
    valid_for: str | None = valid_for_option


profile_options = option_group(ProfileOptions)


@verb(jobs=True, dry_run=True)
def init(
    run: Run,
    folder: Path | None = argument(metavar="[WORKSPACE]", required=False, type=PATH),
    policy: Path | None = path_option(metavar="PATH"),
    profile: ProfileOptions = profile_options,
) -> Report:
    """Create a workspace: a profile with conservative defaults, and two certificate authorities.

    \b
    Then write your policy in profile/comarmor.d/, where talker_listener.xml is an example, and run
        keymint create --all && keymint build && keymint install

    Options:
        policy: ComArmor file or directory that becomes the policy of the workspace [the talker/listener example].
    """
    workspace = run.workspace_at(folder)
    if workspace.exists():
        refuse_contradiction(run, workspace, profile, policy)
        return run.carry_out(workspace, _again)
    request = bootstrap_request(run, workspace, policy, profile)
    foreign = foreign_policy(run.plugins, [run.setting.cwd / policy]) if policy is not None else None
    if foreign is not None and foreign.imported:
        raise foreign.refusal(run.typed(str(foreign.path)))

    def make_plan(inputs: Inputs) -> Plan:
        profile_type = profile.profile_type or DEFAULT_PROFILE_TYPE
        work = Work.after(inputs, plan_init(inputs, profile_type, request, profile.distro, run.setting.cwd))
        refuse_unsupported(work.session)
        return work.then(plan_authorities(work.session)[0]).plan

    return run.carry_out(workspace, make_plan)


def _again(inputs: Inputs) -> Plan:
    """Plan the missing authorities of an existing workspace."""
    plan = plan_authorities(inputs.session())[0]
    done = Step("init", "", Action.UNCHANGED, (), "workspace profile")
    return Plan((done, *plan.steps), plan.state, plan.diagnostics)


def bootstrap_request(run: Run, workspace: Workspace, policy: Path | None, profile: ProfileOptions) -> Bootstrap:
    """Return the request for a new profile.

    Raises:
        KeymintError: the policy does not exist, or no build type for a transport is installed.
    """
    path = run.setting.cwd / policy if policy else None
    if path is not None and not path.exists():
        message = "no such file or folder"
        raise KeymintError(message, where=Origin(str(policy)), help="name a ComArmor policy", code="policy-missing")
    environment, root = run.setting.environment, workspace.root
    if root == run.setting.cwd and root in {Path("/"), Path(environment.get("HOME", "/"))} and not workspace.exists():
        message = f"{root} would become a workspace, and is no folder for one"
        raise usage_error(message, "name one that is made for it: -w robot_ws")
    return Bootstrap(
        name=root.name or "workspace",
        policy=policy_path(path, workspace.profile) if path else "",
        distro=profile.distro or environment.get("ROS_DISTRO") or DEFAULT_DISTRO,
        domain=profile.domain or 0,
        layout=profile.layout or "",
        subject_format=profile.subject_format or "unique",
        now=run.setting.now,
        build_types=_build_types_for(run.plugins, profile.transports),
        valid_for=profile.valid_for or "",
        policy_type=_policy_type(run, path) if path else "",
    )


def _policy_type(run: Run, policy: Path) -> str:
    """Return the plugin for a policy that it recognises, and that need not be imported; empty for the usual one."""
    foreign = None if policy.is_dir() or policy.suffix == ".xml" else foreign_policy(run.plugins, [policy])
    return foreign.policy_type if foreign and not foreign.imported else ""


def refuse_contradiction(run: Run, workspace: Workspace, given: ProfileOptions, policy: Path | None = None) -> None:
    """Refuse an option that differs from the profile of an existing workspace.

    Args:
        run: the run.
        workspace: the existing workspace.
        given: the options of this run.
        policy: the value of ``--policy``, which only ``init`` has.

    Raises:
        KeymintError: the profile has another value, or does not have this setting.
    """
    options = {**asdict(given), "transports": None, "policy": policy}
    values = {name.replace("_", "-"): str(value) for name, value in options.items() if value is not None}
    if not values and not given.transports:
        return
    profile = run.inputs(workspace).session().profile
    _refuse_other_transports(run, workspace, profile, given.transports)
    profile_type = run.plugins.profile_type(profile.profile_type)
    if given.distro is not None:
        profile_type.library(given.distro)  # an unknown distribution is a usage error, as for a new workspace
    present = {"profile-type": profile.profile_type, **profile_type.settings(profile)}
    for setting, value in values.items():
        if present.get(setting) != value:
            places = [place for place in profile_type.PLACES.get(setting, ()) if place in profile.files]
            places = places or [PROFILE_MARKER]
            has = f"has {setting} {present[setting]!r}" if setting in present else f"exists and keeps its {setting}"
            how = f"'keymint set {setting} {value}' changes it" if setting in profile_type.SETTINGS else "change it"
            raise KeymintError(
                f"the workspace {has}, so --{setting} {value} cannot take effect",
                where=workspace.origin(workspace.profile / places[0]),
                help=f"{how} in {' and '.join(workspace.shown(workspace.profile / place) for place in places)}, "
                "or name another workspace",
                code="workspace-exists",
            )


def _refuse_other_transports(run: Run, workspace: Workspace, profile: WorkspaceProfile, given: Sequence[str]) -> None:
    wanted = _build_types_for(run.plugins, given)
    if not given or {*wanted} == {*profile.build_types}:
        return
    elements = " and ".join(f"<build_type>{name}</build_type>" for name in wanted)
    known = {names[0]: transport for transport, names in _by_transport(run.plugins).items()}
    has = " and ".join(repr(known.get(name, name)) for name in profile.build_types)
    marker = workspace.shown(workspace.profile / PROFILE_MARKER)
    raise KeymintError(
        f"the workspace has transport {has}, so {' '.join(f'--transport {each}' for each in given)} cannot take effect",
        where=Origin(marker),
        help=f"write {elements} in <export> of {marker} and of each existing package, then run 'keymint create --all', "
        "which names what else is missing; or name another workspace",
        code="workspace-exists",
    )


def _build_types_for(plugins: Plugins, transports: Sequence[str]) -> tuple[str, ...]:
    """Return the build types of transports, in the order of the command line, each once.

    Raises:
        KeymintError: no installed build type is for a transport, or several are.
    """
    known = _by_transport(plugins) if transports else {}
    for transport in transports:
        if transport not in known:
            choice = f"installed are {', '.join(known)}"
            raise usage_error(f"no build type for the transport {transport!r} is installed",
                              did_you_mean(transport, known, choice))  # fmt: skip
        if len(known[transport]) > 1:
            several = " and ".join(known[transport])
            raise usage_error(
                f"the transport {transport!r} has several build types: {several}", "uninstall all but one"
            )
    return tuple(dict.fromkeys(known[transport][0] for transport in transports))


def _by_transport(plugins: Plugins) -> Mapping[str, Sequence[str]]:
    """Return the names of build types by transport; ``keymint plugins`` reports those that fail to load."""
    known: dict[str, list[str]] = {}
    for name in plugins.names("keymint.build_types"):
        try:
            known.setdefault(plugins.build_type(name).TRANSPORT, []).append(name)
        except KeymintError:
            continue
    return dict(sorted(known.items()))
