# SPDX-License-Identifier: Apache-2.0
"""Select transports: those to test, and those that name the rule that decides, which explain mismatches of others."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from comarmor.values import Data, replace
from keymint.api import Availability, InstalledEnclave, Tier, Transport, Verdict
from keymint.api.graph import Edge
from keymint.api.plugin_loader import Plugins
from keymint.errors import ExitCode, KeymintError, Origin
from keymint.verify.compare import Mismatch, label_enclave
from keymint.verify.copies import Copies
from keymint.verify.endpoint_policy import EndpointPolicy


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
        message = f"no transport supports the tier {tier} on this machine"
        raise KeymintError(message, help="'keymint transports' shows how to install one", code="transport-none")
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
            here = " and ".join(build_types)
            message = f"the transport {name!r} reads what {needed} builds, but the build type here is {here}"
            help_ = f"use {' or '.join(f'-i {other}' for other in fitting)}" if fitting else ""
            raise KeymintError(message, help=help_, code="transport-foreign", exit_code=ExitCode.USAGE)
        usable = transport.usable()
        if not usable.usable:
            message = f"the transport {name!r} cannot be used here: {usable.reason}"
            raise KeymintError(message, help=usable.help, code="transport-unusable")
        if tier not in usable.tiers:
            message = f"the transport {name!r} does not support the tier {tier}"
            help_ = f"it supports {', '.join(usable.tiers)}"
            raise KeymintError(message, help=help_, code="transport-tier", exit_code=ExitCode.USAGE)
    return named


def usable_by_default(usable: Availability, tier: Tier) -> bool:
    """Return whether a transport is tested when none is chosen."""
    return usable.usable and usable.by_default and tier in usable.tiers


def models(plugins: Plugins, build_type: str, *, distro: str = "") -> dict[str, Transport]:
    """Return the transports of a build type that name the rule that decides; one without a version comes first."""
    names = sorted(plugins.transports_of(build_type, distro), key=lambda name: ("-" in name, name))
    usable = {name: plugins.transport(name).usable() for name in names}
    named = [name for name, each in usable.items() if each.names_rules and usable_by_default(each, Tier.DECISION)]
    return {name: plugins.transport(name) for name in named}


_VERSION = re.compile(r"-[\d.]+$")


class Explainer(Data):
    """Explains the labels of transports; a real one is explained by its simulation.

    Attributes:
        policy: the policy on endpoints.
        transports: the transports to explain, by name.
        models: returns simulated transports by name, whose verdicts have the place of a rule; ``name-1.2`` simulates
            ``name`` from that version on. The first one explains what has no simulation.
        copies: the copies that the transports read; mismatches name the originals.
    """

    policy: EndpointPolicy
    transports: Mapping[str, Transport]
    models: Callable[[], Mapping[str, Transport]]
    copies: Copies

    def __call__(self, transport: str, enclave: InstalledEnclave, wrong: list[tuple[Edge, Verdict]]) -> list[Mismatch]:
        """Return the mismatches of one enclave with their reasons."""
        name = "" if self.transports[transport].usable().names_rules else self.model_of(transport)
        models = [verdict for _, verdict in wrong]
        if name:
            edges = [edge for edge, _ in wrong]
            try:
                models = [verdict for _, verdict in label_enclave(self.models()[name], enclave, edges, Tier.DECISION)]
            except KeymintError:
                name = ""
        found: list[Mismatch] = []
        for (edge, verdict), model in zip(wrong, models, strict=True):
            # The simulation explains what decides the same; a partial one counts as the opposite of the policy.
            alike = model.partial == verdict.partial and (model.partial or model.allowed == verdict.allowed)
            modelled = self.copies.original(model if alike else verdict)
            own = replace(self.copies.original(verdict), where=modelled.where, deviation=modelled.deviation)
            document = modelled.where or Origin(self.copies.back(str(enclave.folder)))
            by = name if alike else ""
            found.append(Mismatch(edge, self.policy.decide(edge), own, modelled.reason, document, by))
        return found

    def model_of(self, transport: str) -> str:
        """Return the name of the simulation that explains a transport, or an empty text.

        Of those of its software, that is the latest one that is not newer than the transport, else the oldest.
        """
        software = _VERSION.sub("", transport)
        own = [name for name in self.models() if _VERSION.sub("", name) == software != name]
        version = _number(self.transports[transport].usable().version)
        known = [name for name in own if _number(name) <= version]
        oldest = min(own, key=_number, default=next(iter(self.models()), ""))
        return max(known, key=_number, default=oldest)


def _number(text: str) -> tuple[int, ...]:
    """Return the version at the end of a name, or that a text is, to compare it with others."""
    return tuple(map(int, re.findall(r"\d+", text.rpartition("-")[2])))
