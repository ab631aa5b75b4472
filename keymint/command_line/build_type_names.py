# SPDX-License-Identifier: Apache-2.0
"""Build types by the name of their transport, which ``keymint init --transport`` takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from comarmor.text import did_you_mean
from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError, usage_error


def build_types_of(plugins: Plugins, transports: Sequence[str]) -> tuple[str, ...]:
    """Return the build types of transports, in the order of the command line, each once.

    Raises:
        KeymintError: no installed build type is for a transport, or several are.
    """
    known = _by_transport(plugins)
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


def transports_of(plugins: Plugins, build_types: Iterable[str]) -> tuple[str, ...]:
    """Return the transports of build types; that of a build type which is not installed is its own name."""
    known = {names[0]: transport for transport, names in _by_transport(plugins).items()}
    return tuple(known.get(name, name) for name in build_types)


def _by_transport(plugins: Plugins) -> Mapping[str, Sequence[str]]:
    """Return the names of build types by transport; ``keymint plugins`` reports those that fail to load."""
    known: dict[str, list[str]] = {}
    for name in plugins.names("keymint.build_types"):
        try:
            known.setdefault(plugins.build_type(name).TRANSPORT, []).append(name)
        except KeymintError:
            continue
    return dict(sorted(known.items()))
