# SPDX-License-Identifier: Apache-2.0
"""Accept what ROS packages ship, and show what is not accepted yet: who would gain and who would lose what."""

from __future__ import annotations

from collections.abc import Mapping

import click

from comarmor.errors import Diagnostic
from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from keymint.command_line.options import option_group
from keymint.errors import KeymintError, usage_error
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.stages.work import Work
from keymint.workspace.policy_loading import plan_acceptance
from keymint.workspace.shipped_profiles import UnacceptedPackagesError

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


@dataclass(frozen=True, slots=True)
class AcceptanceOptions:
    """What the owner of a workspace accepts of the profiles that ROS packages ship.

    Attributes:
        accept_package: packages whose profiles are accepted as they are now, each with the digest that it must have, or
            an empty text.
        trust_links: symbolic links of these packages may lead out of them.
    """

    accept_package: Mapping[str, str]
    trust_links: bool


acceptance_options = option_group(
    "acceptance",
    AcceptanceOptions,
    click.option(
        "--accept-package",
        multiple=True,
        callback=_named,
        metavar="NAME[=SHA256]",
        help="Accept the profiles that this ROS package ships, as they are now (docs/packages.md). May be repeated.",
    ),
    click.option(
        "--trust-links",
        is_flag=True,
        help="Follow symbolic links out of the accepted packages, as 'colcon build --symlink-install' makes.",
    ),
)


def accept(work: Work, options: AcceptanceOptions) -> Work:
    """Return the work followed by the acceptance of the packages that the command line names, if it names any.

    Raises:
        KeymintError: the policy includes nothing of a package, or has defects, or links are to be followed in none.
    """
    if options.accept_package:
        return work.then(plan_acceptance(work.session, options.accept_package, trust_links=options.trust_links))
    if options.trust_links:
        raise usage_error("--trust-links needs --accept-package", "name the package whose links are to be followed")
    return work


def unaccepted_report(run: Run, error: UnacceptedPackagesError) -> Report:
    """Return the report of a verb that met files of packages that nobody accepted, and show what they change."""
    # Few runs need the comparison, and it takes time to import.
    from keymint.analysis.policy_diff import diff_policies  # noqa: PLC0415
    from keymint.output.differences import as_text, summary  # noqa: PLC0415
    from keymint.output.json import differences_json  # noqa: PLC0415

    files = [
        {"package": each.package, "path": each.path, "accepted": accepted or None, "shipped": each.sha256}
        for each, accepted in error.files.items()
    ]
    result: dict[str, object] = {"unaccepted": files, "subjects": None}
    diagnostics = error.diagnostics
    try:
        differences = diff_policies(error.before(), error.after)
    except KeymintError as reason:
        why = f"what that changes cannot be shown, since the accepted files do not fit the policy: {reason}"
        diagnostics = (*diagnostics, Diagnostic.warning("package-diff", why, None, "read the files"))
    else:
        run.console.lines((*as_text(differences, run.place), summary(differences)))
        result["subjects"] = differences_json(differences, run.typed)
    return run.report(result, diagnostics, error.exit_code, workspace=run.known_workspace)
