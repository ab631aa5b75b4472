"""Options whose values are names of plugins: a name that is not installed is a usage error, whatever the verb does."""

from __future__ import annotations

from collections.abc import Mapping

import click
from click.core import ParameterSource

from keymint.plugins import Plugins

_GROUPS: Mapping[str, str] = {
    "profile_type": "keymint.profile_types",
    "policy_type": "keymint.policy_types",
    "build_type": "keymint.build_types",
    "source_name": "keymint.graph_sources",
    "source_type": "keymint.graph_sources",
    "chosen": "keymint.transports",
}
"""The group of plugins that each option names, by the name of its parameter."""


def require_known(context: click.Context, plugins: Plugins) -> None:
    """Require that each plugin that is named on the command line is installed.

    Args:
        context: of the verb, with its parameters.
        plugins: what is installed.

    Raises:
        KeymintError: a plugin is not installed; the exit code is that of wrong usage.
    """
    for parameter, group in _GROUPS.items():
        if context.get_parameter_source(parameter) is not ParameterSource.COMMANDLINE:
            continue
        value = context.params[parameter]
        for name in value if isinstance(value, tuple) else (value,):
            plugins.require(group, name)
