# SPDX-License-Identifier: Apache-2.0
"""``keymint transports``: usable transports on this machine, and how to install the others."""

from __future__ import annotations

from dataclasses import asdict

from keymint.command_line.verb import Report, Run, verb


@verb(workspace=False)
def transports(run: Run) -> Report:
    """List the implementations of transports, simulated and real: which are usable, and how to install others."""
    listed = [(name, transport.usable()) for name, transport in run.plugins.transports().items()]
    documents = [{"name": name, "build_type": run.plugins.read_by(name), **asdict(usable)} for name, usable in listed]
    columns = {
        "IMPLEMENTATION": "name",
        "USABLE": "usable",
        "VERSION": "version",
        "TIERS": "tiers",
        "BUILD TYPE": "build_type",
    }
    run.console.table(columns, documents)
    named = [name for name, usable in listed if usable.usable and not usable.by_default]
    if named:
        run.console.line(f"used only when named by -i: {', '.join(named)}")
    others = [(name, usable) for name, usable in listed if not usable.usable]
    run.console.lines(f"{name}: {each.reason}" + (f" ({each.help})" if each.help else "") for name, each in others)
    return run.report({"transports": documents})
