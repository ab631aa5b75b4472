# SPDX-License-Identifier: Apache-2.0
"""The options by which the owner of a workspace accepts what ROS packages ship."""

from __future__ import annotations

from collections.abc import Mapping

import click

from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from keymint.command_line.verb import flag, option, option_group
from keymint.errors import usage_error
from keymint.stages.work import Work
from keymint.workspace.policy_loading import plan_acceptance

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

    accept_package: Mapping[str, str] = option(
        multiple=True,
        callback=_named,
        metavar="NAME[=SHA256]",
        help="Accept the profiles that this ROS package ships, as they are now (docs/packages.md). May be repeated.",
    )
    trust_links: bool = flag(
        "Follow symbolic links out of the accepted packages, as 'colcon build --symlink-install' makes."
    )


acceptance_options = option_group(AcceptanceOptions)


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
