# SPDX-License-Identifier: Apache-2.0
"""``keymint create``: source packages from the policy, and what the owner accepts of what ROS packages ship."""

from __future__ import annotations

from collections.abc import Mapping

import click

from comarmor.text import lazy_regex
from comarmor.values import Data, replace
from keymint.command_line.options import Names, names_group, valid_for_option
from keymint.command_line.verb import Report, Run, flag, option, option_group, verb
from keymint.errors import usage_error
from keymint.names import no_subject
from keymint.stages.create import packages_to_create
from keymint.stages.pipeline import CREATE, Request, conduct
from keymint.stages.work import InstallRequest, Work
from keymint.store.changes import Action, Plan
from keymint.workspace.policy_loading import lazy_policy, plan_acceptance
from keymint.workspace.session import Session
from keymint.workspace.shipped_profiles import plan_release

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


@verb(jobs=True, dry_run=True, yes=True, former={"trust_package": "--accept-package"})
def create(
    run: Run,
    names: Names = names_group(state=False),
    all_subjects: bool = flag("--all"),
    force: bool = flag("-f"),
    valid_for: str | None = valid_for_option,
    acceptance: AcceptanceOptions = acceptance_options,
) -> Report:
    """Create source packages in src/, one per subject, or update their rules from the policy.

    If a transport of the workspace needs further identities, their packages are created as well.

    NAME is a subject, e.g. /robot1/talker. Any subject that a profile applies to is allowed, even if the policy
    names it only by a wildcard. Manual edits of other documents are preserved.

    With --trust-package and without NAME and --all it only records what was accepted.

    Options:
        all_subjects: Create every subject that the policy names exactly.
        force: Replace the rules of a package even if they were edited manually.
    """
    if not names and not all_subjects and not acceptance.trust_package:
        raise usage_error("no subject is named", "name some, or use --all")
    run.workspace()

    def make_plan(session: Session) -> Plan:
        work = accept(Work(session), acceptance)
        if not names and not all_subjects:
            return work.plan
        policy = lazy_policy(work.session)
        work = work.then(plan_release(work.session, policy))
        every = packages_to_create(work.session, policy)
        named = names.packages(run, work.session, None, every, "name a subject of the policy") if names else ()
        subjects = dict.fromkeys([*named, *(every if all_subjects else ())])
        if not subjects:
            raise no_subject("name the subjects: keymint create /robot1/talker")
        asked = InstallRequest(force=force)
        request = Request(tuple(subjects), (CREATE,), asked, policy=policy, valid_for=valid_for or "")
        work = conduct(work, request, run.crew)
        from keymint.command_line.agreement import another_policy, confirmed_plan  # noqa: PLC0415 - not for 'provision'
        from keymint.stages.changed_rights import rights_of_sources  # noqa: PLC0415 - as above

        changed = work.of(CREATE).of_action(Action.UPDATED)
        work = replace(work, rights=tuple(rights_of_sources(work.session, sorted(changed))))
        return confirmed_plan(run, work, another_policy(run, session, policy), policy)

    return run.change(make_plan)


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
