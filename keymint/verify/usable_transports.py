"""Which transports are asked, and which can name the rule that decides."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import Availability, Tier, Transport
from keymint.errors import ExitCode, KeymintError
from keymint.plugins import Plugins


def choose(plugins: Plugins, chosen: Sequence[str], tier: Tier) -> dict[str, Transport]:
    """Return the transports to ask, by name: those that are named, or all that can be asked this way here.

    Raises:
        KeymintError: one that is named is not known or not usable, or none is named and none is usable.
    """
    if not chosen:
        known = plugins.transports().items()
        found = {name: each for name, each in known if usable_by_default(each.usable(), tier)}
        if not found:
            raise KeymintError(
                f"no transport can be asked at the tier {tier} on this machine",
                help="'keymint transports' says how to install one",
                code="transport-none",
            )
        return found
    asked = {name: plugins.transport(name) for name in dict.fromkeys(chosen)}
    for name, transport in asked.items():
        usable = transport.usable()
        if not usable.usable:
            raise KeymintError(
                f"the transport {name!r} cannot be used here: {usable.reason}",
                help=usable.help,
                code="transport-unusable",
            )
        if tier not in usable.tiers:
            raise KeymintError(
                f"the transport {name!r} cannot be asked at the tier {tier}",
                help=f"it has {', '.join(usable.tiers)}",
                code="transport-tier",
                exit_code=ExitCode.USAGE,
            )
    return asked


def usable_by_default(usable: Availability, tier: Tier) -> bool:
    """Tell whether a transport is asked where none is named."""
    return usable.usable and usable.by_default and tier in usable.tiers


def names_rules(usable: Availability) -> bool:
    """Tell whether a transport decides by the text of the documents only, and so can name the rule that decides."""
    return usable.tiers == (Tier.DECISION,)


def models(plugins: Plugins) -> dict[str, Transport]:
    """Return the transports that name the rule that decides; a standard, which names no version, comes first."""
    found = {name: each for name, each in plugins.transports().items() if names_rules(each.usable())}
    found = {name: each for name, each in found.items() if usable_by_default(each.usable(), Tier.DECISION)}
    return {name: found[name] for name in sorted(found, key=lambda name: ("-" in name, name))}
