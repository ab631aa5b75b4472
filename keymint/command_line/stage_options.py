# SPDX-License-Identifier: Apache-2.0
"""What ``keymint provision`` shares with the verbs of single stages: options, what they ask for, and what is told."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import click

from comarmor.text import did_you_mean, lazy_regex
from comarmor.values import Data, values_of
from keymint.analysis.attachment_mistakes import attachment_mistakes
from keymint.api import Bootstrap, Hint, LoadedPolicy, WorkspaceProfile
from keymint.api.plugin_loader import Plugins
from keymint.command_line.options import DEFAULT_DISTRO, DEFAULT_PROFILE_TYPE, distro_option, valid_for_option
from keymint.command_line.verb import Run, flag, option, option_group, plugin
from keymint.errors import Diagnostic, KeymintError, Origin, usage_error
from keymint.names import subject_of
from keymint.stages.create import policy_path
from keymint.stages.work import Work
from keymint.store.changes import Action, Step
from keymint.workspace.policy_loading import foreign_policy, load_policy, plan_acceptance
from keymint.workspace.session import Session
from keymint.workspace.workspace import PROFILE_MARKER, Workspace

# -- new workspaces --------------------------------------------------------------------------------------------------


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
    options = {**values_of(given), "transports": None, "policy": policy}
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


# -- what is accepted ------------------------------------------------------------------------------------------------

_DIGEST = lazy_regex("[0-9a-f]{64}")


def _named(_context: click.Context, _parameter: click.Parameter, given: tuple[str, ...]) -> Mapping[str, str]:
    """Return the digest, or an empty text, by the package that an option names."""
    named: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if equals and not _DIGEST.fullmatch(value):
            raise click.BadParameter(f"{text!r} has no SHA-256 after '=', expected 64 digits and letters a to f.")
        if named.setdefault(name, value) != value:
            raise click.BadParameter(f"{name!r} is named twice, with and without a digest, or with two.")
    return named


class AcceptanceOptions(Data):
    """What the owner of a workspace accepts of the profiles that ROS packages ship.

    Attributes:
        trust_package: packages whose profiles are accepted as they are now, each with the digest that it must have, or
            an empty text.
        trust_links: symbolic links of these packages may lead out of them.

    Options:
        trust_package: Trust the profiles that this ROS package ships, as they are now (docs/packages.md). May be
            repeated.
        trust_links: Follow symbolic links out of the trusted packages, as 'colcon build --symlink-install' makes.
    """

    trust_package: Mapping[str, str] = option(multiple=True, callback=_named, metavar="NAME[=SHA256]")
    trust_links: bool = flag()


acceptance_options = option_group(AcceptanceOptions)


def accept(work: Work, options: AcceptanceOptions) -> Work:
    """Return the work followed by the acceptance of the packages that the command line names, if it names any.

    Raises:
        KeymintError: the policy includes nothing of a package, or has defects, or links are to be followed in none.
    """
    if options.trust_package:
        return work.then(plan_acceptance(work.session, options.trust_package, trust_links=options.trust_links))
    if options.trust_links:
        raise usage_error("--trust-links needs --trust-package", "name the package whose links are to be followed")
    return work


# -- builds ----------------------------------------------------------------------------------------------------------


def unknown_hints(hints: Sequence[Hint], file: Path | None, names: Iterable[str]) -> tuple[Diagnostic, ...]:
    """Return a warning for each subject of the hints in a file without a package."""
    known = [subject_of(name) for name in names] if hints else []  # few builds have hints
    return tuple(
        Diagnostic.warning(
            "hints-subject",
            f"the hints name {subject}, which is not a subject of this workspace",
            Origin(str(file)),
            did_you_mean(subject, known),
        )
        for subject in sorted({each.edge.subject for each in hints}.difference(known))
    )


def policy_slips(session: Session, steps: Iterable[Step], policy: LoadedPolicy | None = None) -> tuple[Diagnostic, ...]:
    """Return likely slips in the policy of a workspace, if any step does something.

    Args:
        session: the workspace and its profile.
        steps: what is planned.
        policy: the policy; loaded if it is not given.
    """
    if all(step.action is Action.UNCHANGED for step in steps):
        return ()
    try:
        written = (policy or load_policy(session)).structure()
    except KeymintError:
        return ()  # 'create' reads the policy, and says what is wrong with it; a build takes what was created
    return tuple(attachment_mistakes(written)) if written else ()
