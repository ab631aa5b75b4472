"""The option that names the transports to ask."""

from __future__ import annotations

import click

transport_option = click.option(
    "-t",
    "--transport",
    "chosen",
    multiple=True,
    metavar="NAME",
    help="Ask this transport; may be given again. By default all that 'keymint transports' says are usable.",
)
