# SPDX-License-Identifier: Apache-2.0
"""``keymint authority``: the verbs about certificate authorities."""

from __future__ import annotations

from collections.abc import Mapping

import click

from keymint.command_line.verb_group import VerbGroup

VERBS: Mapping[str, str] = {
    "show": "Show each authority: its certificate, where its key is, and whom it serves.",
    "renew": "Issue an authority's certificate again for the same key, with later dates.",
    "replace": "Replace an authority's key, phase by phase.",
    "encrypt": "Encrypt an authority's stored private key, as the profile asks.",
    "import": "Use an authority's certificate that somebody else issued.",
    "export": "Write an authority's certificate, or its key, to a file.",
}


_OTHERS = dict.fromkeys(("renew", "import", "encrypt"), "change")


@click.group(cls=VerbGroup, groups={"Verbs": VERBS}, module="keymint.commands.life.authority_{verb}", others=_OTHERS)
def authority() -> None:
    """Show, renew, replace, encrypt, import or export the certificate authorities of a workspace.

    An authority signs with its private key, in private/ or elsewhere; enclaves contain only its certificate.
    docs/keystore-life.md says what each change costs a running fleet.
    """
