# SPDX-License-Identifier: Apache-2.0
"""``keymint authority``: the verbs about certificate authorities."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType

import click

from keymint.process import held_signals

VERBS: Mapping[str, str] = MappingProxyType(
    {
        "show": "Show each authority: its certificate, where its key is, and whom it serves.",
        "renew": "Issue an authority's certificate again for the same key, with later dates.",
        "replace": "Replace an authority's key, phase by phase.",
        "import": "Use an authority's certificate that somebody else issued.",
        "export": "Write an authority's certificate, or its key, to a file.",
    }
)


class _Verbs(click.Group):
    """A group that imports a verb on first use, so that ``--help`` is fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in VERBS:
            return None
        with held_signals():
            module = importlib.import_module(f"keymint.commands.authority_{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=_Verbs)
def authority() -> None:
    """Show, renew, replace, import or export the certificate authorities of a workspace.

    An authority signs with its private key in private/, or where that key is; enclaves only have its certificate.
    docs/keystore-life.md says what each change costs a running fleet.
    """
