# SPDX-License-Identifier: Apache-2.0
"""Select transports: those to test, and those that name the rule that decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from keymint.api import Availability, Tier, Transport
from keymint.api.plugin_loader import Plugins
from keymint.errors import ExitCode, KeymintError


def choose(
    plugins: Plugins, chosen: Sequence[str], tier: Tier, build_types: Sequence[str], distro: str = ""
) -> Mapping[str, Mapping[str, Transport]]:
    """Return the transports to test by build type, then name: the chosen ones, or all that are usable at a tier.

    Args:
        plugins: the installed plugins.
        chosen: names of transports; empty to choose all that are usable.
        tier: the tier of the test.
        build_types: those of the packages; transports that read what other ones build are not used.
        distro: ROS 2 distribution; models of what it does not ship are used only if they are chosen; empty for all.

    Returns:
        The build types with a transport, in the given order.

    Raises:
        KeymintError: a chosen transport is unknown, unusable or of another build type, or none is chosen and none is
            usable.
    """
    if chosen:
        used = _named(plugins, chosen, tier, build_types)
    else:
        known = {name: plugins.transport(name) for each in build_types for name in plugins.transports_of(each, distro)}
        used = {name: each for name, each in known.items() if usable_by_default(each.usable(), tier)}
    if not used:
        raise KeymintError(
            f"no transport supports the tier {tier} on this machine",
            help="'keymint transports' shows how to install one",
            code="transport-none",
        )
    groups = {each: {name: used[name] for name in used if plugins.read_by(name) == each} for each in build_types}
    return {build_type: group for build_type, group in groups.items() if group}


def _named(plugins: Plugins, chosen: Sequence[str], tier: Tier, build_types: Sequence[str]) -> dict[str, Transport]:
    """Return transports that the user names.

    Raises:
        KeymintError: one is unknown, unusable or of another build type.
    """
    named = {name: plugins.transport(name) for name in dict.fromkeys(chosen)}
    for name, transport in named.items():
        if (needed := plugins.read_by(name)) not in build_types:
            fitting = [other for each in build_types for other in plugins.transports_of(each)]
            raise KeymintError(
                f"the transport {name!r} reads what {needed} builds, but the build type here is "
                f"{' and '.join(build_types)}",
                help=f"use {' or '.join(f'-t {other}' for other in fitting)}" if fitting else "",
                code="transport-foreign",
                exit_code=ExitCode.USAGE,
            )
        usable = transport.usable()
        if not usable.usable:
            raise KeymintError(
                f"the transport {name!r} cannot be used here: {usable.reason}",
                help=usable.help,
                code="transport-unusable",
            )
        if tier not in usable.tiers:
            raise KeymintError(
                f"the transport {name!r} does not support the tier {tier}",
                help=f"it supports {', '.join(usable.tiers)}",
                code="transport-tier",
                exit_code=ExitCode.USAGE,
            )
    return named


def usable_by_default(usable: Availability, tier: Tier) -> bool:
    """Return whether a transport is tested when none is chosen."""
    return usable.usable and usable.by_default and tier in usable.tiers


def names_rules(usable: Availability) -> bool:
    """Return whether a transport decides by the documents alone, so it can name the rule that decides."""
    return usable.tiers == (Tier.DECISION,)


def models(plugins: Plugins, build_type: str, *, distro: str = "") -> dict[str, Transport]:
    """Return the transports of a build type that name the rule that decides; one without a version comes first."""
    names = sorted(plugins.transports_of(build_type, distro), key=lambda name: ("-" in name, name))
    usable = {name: plugins.transport(name).usable() for name in names}
    named = [name for name, each in usable.items() if names_rules(each) and usable_by_default(each, Tier.DECISION)]
    return {name: plugins.transport(name) for name in named}
