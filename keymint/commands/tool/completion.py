# SPDX-License-Identifier: Apache-2.0
"""``keymint completion``: print the completion script for a shell."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from keymint.command_line.verb import Report, Run, argument, verb


@verb(workspace=False)
def completion(run: Run, shell: str = argument(type=click.Choice(["bash", "zsh", "fish"]))) -> Report:
    """Print the completion script for SHELL.

    \b
    bash:  eval "$(keymint completion bash)"      in ~/.bashrc
    zsh:   eval "$(keymint completion zsh)"       in ~/.zshrc
    fish:  keymint completion fish > ~/.config/fish/completions/keymint.fish
    """
    shell_class = get_completion_class(shell)
    if shell_class is None:  # click supports all shells of the choice above
        raise click.UsageError(f"no completion for {shell}")
    cli = click.get_current_context().find_root().command
    source = shell_class(cli, {}, "keymint", "_KEYMINT_COMPLETE").source()
    run.console.document(source.encode())
    return run.report({"shell": shell, "script": source})
