# SPDX-License-Identifier: Apache-2.0
"""Select transports: those to test, and those that name the rule that decides."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import Availability, Tier, Transport
from keymint.errors import ExitCode, KeymintError
from keymint.plugins import Plugins


def choose(plugins: Plugins, chosen: Sequence[str], tier: Tier) -> dict[str, Transport]:
    """Return the transports to test, by name: the chosen ones, or all that are usable at a tier.

    Raises:
        KeymintError: a chosen transport is unknown or unusable, or none is chosen and none is usable.
    """
    if not chosen:
        known = plugins.transports().items()
        usable_here = {name: each for name, each in known if usable_by_default(each.usable(), tier)}
        if not usable_here:
            raise KeymintError(
                f"no transport supports the tier {tier} on this machine",
                help="'keymint transports' shows how to install one",
                code="transport-none",
            )
        return usable_here
    named = {name: plugins.transport(name) for name in dict.fromkeys(chosen)}
    for name, transport in named.items():
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


def models(plugins: Plugins) -> dict[str, Transport]:
    """Return the transports that name the rule that decides; the standard, which has no version, comes first."""
    transports = {name: each for name, each in plugins.transports().items() if names_rules(each.usable())}
    transports = {name: each for name, each in transports.items() if usable_by_default(each.usable(), Tier.DECISION)}
    return {name: transports[name] for name in sorted(transports, key=lambda name: ("-" in name, name))}
