# SPDX-License-Identifier: Apache-2.0
"""``keymint transports``: usable transports on this machine, and how to install the others."""

from __future__ import annotations

from dataclasses import asdict

from keymint.command_line.verb import verb
from keymint.output.report import Report
from keymint.run.run import Run


@verb(workspace=False)
def transports(run: Run) -> Report:
    """List the transports, simulated and real: which are usable here, and how to install the others."""
    listed = [(name, transport.usable()) for name, transport in run.plugins.transports().items()]
    reads = {name: run.plugins.read_by(name) for name, _ in listed}
    run.console.table(
        ["TRANSPORT", "USABLE", "VERSION", "TIERS", "BUILD TYPE"],
        [
            [name, "yes" if usable.usable else "no", usable.version or "-", " ".join(usable.tiers) or "-", reads[name]]
            for name, usable in listed
        ],
    )
    named = [name for name, usable in listed if usable.usable and not usable.by_default]
    if named:
        run.console.line(f"used only when named by -t: {', '.join(named)}")
    others = [(name, usable) for name, usable in listed if not usable.usable]
    run.console.lines(f"{name}: {each.reason}" + (f" ({each.help})" if each.help else "") for name, each in others)
    result = {"transports": [{"name": name, "build_type": reads[name], **asdict(usable)} for name, usable in listed]}
    return run.report(result)
