# SPDX-License-Identifier: Apache-2.0
"""Choose the plugin that observes running systems and reads captures."""

from __future__ import annotations

from keymint.api import GraphSource
from keymint.errors import usage_error
from keymint.run.run import Run

_GROUP = "keymint.graph_sources"


def graph_source(run: Run, name: str | None, option: str) -> GraphSource:
    """Return the graph source of a name; without a name the only installed one.

    Args:
        run: the run.
        name: what the command line names, or None.
        option: the option that names it, for the message.

    Raises:
        KeymintError: no name is given, and several graph sources are installed, or none; or it cannot be loaded.
    """
    if name is not None:
        return run.plugins.graph_source(name)
    installed = run.plugins.names(_GROUP)
    if len(installed) == 1:
        return run.plugins.graph_source(installed[0])
    if not installed:
        raise usage_error("no graph source is installed", "'keymint plugins' lists the installed plugins")
    raise usage_error(f"several graph sources are installed: {', '.join(installed)}", f"choose one: {option} NAME")
