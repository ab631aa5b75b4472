"""The command line: finds the verbs, and is the only place that reads the clock, the environment and the umask."""

from __future__ import annotations

import gc
import importlib
import os
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from keymint import __version__
from keymint.errors import ExitCode

VERBS: Mapping[str, str] = {
    "init": "Make a workspace.",
    "create": "Make source packages from the policy.",
    "build": "Build unsigned documents.",
    "install": "Sign them, and stage enclaves for deployment.",
    "check": "Hold what is installed against what it should be.",
    "prove": "Prove that what is installed permits exactly what the policy says, over all names.",
    "status": "Show how far every package has come, and when it expires.",
    "verify": "Compare what transports decide with what the policy says, edge by edge.",
    "why": "Explain one decision through all layers.",
    "lint": "Find what in a policy is in vain, or is likely not meant.",
    "diff": "Compare two policies by meaning: who gains, and who loses what.",
    "query": "Ask a policy who can do what, also of subjects that it does not name.",
    "test": "Run a policy's own unit tests.",
    "provision": "All of it in one go: what a CI job calls.",
    "discover": "Find the graph of a running system, or of captures of one.",
    "learn": "Make the smallest policy that a graph needs.",
    "graph": "Draw a policy, or the graph of a system.",
    "plugins": "List the plugins that are found.",
    "transports": "List the transports: which can be used here, and how to install the rest.",
    "completion": "Print the completion script of a shell.",
}


class _Verbs(click.Group):
    """A group whose verbs are imported when they are used, so that ``--help`` is fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in VERBS:
            return None
        command: click.Command = getattr(importlib.import_module(f"keymint.commands.{cmd_name}"), cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in VERBS and not args[0].startswith("-"):
            import difflib  # noqa: PLC0415 - only for the message

            near = difflib.get_close_matches(args[0], VERBS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else "'keymint --help' lists the verbs"
            ctx.fail(f"no verb {args[0]!r} ({hint})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Verbs"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="keymint")
def cli() -> None:
    """Mint keys and notarize access control for robots: from a ComArmor policy to a DDS Security keystore.

    \b
    keymint provision POLICY -w WORKSPACE     all in one go; or stage by stage:
    keymint init my_ws && cd my_ws            a workspace with its authorities
    keymint create --all                      profile/comarmor.d/ -> src/
    keymint build                             src/ -> build/     (unsigned)
    keymint install                           build/ -> install/ (signed)
    export ROS_SECURITY_KEYSTORE=$PWD/install

    Exit codes: 0 done, 1 failure, 2 usage, 3 findings, 130 interrupted.
    """


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    gc.set_threshold(50_000, 20, 50)  # a run makes many objects, few of them in cycles
    os.umask(0o022)  # secrets are 0600 and public files 0644, whatever the user's umask
    given = sys.argv[1:] if arguments is None else arguments
    if not sys.warnoptions:  # a library's advice to its programmers is no message to a user
        warnings.simplefilter("ignore")
    try:
        result: Any = cli.main(given, prog_name="keymint", standalone_mode=False, obj=_setting)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.ClickException as error:
        return _fail(given, "usage", error.format_message(), ExitCode.USAGE, error.show)
    except (KeyboardInterrupt, click.Abort):
        sys.stderr.write("keymint: interrupted; every file is whole, run again to go on\n")
        return int(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return int(ExitCode.FAILURE)
    except Exception as error:  # the user gets one line for our bugs as well
        # A path that the system does not even look at, e.g. since it is too long, is no bug of ours.
        of_system = isinstance(error, OSError) and error.filename is not None and error.strerror is not None
        if os.environ.get("KEYMINT_TRACEBACK") and not of_system:
            raise
        if isinstance(error, OSError) and of_system:
            code, message, shown = (
                "system",
                f"{error.filename}: {error.strerror}",
                f"{error.filename}: error: {error.strerror}",
            )
        else:
            code = "internal"
            message = (
                f"internal error: {type(error).__name__}: {error} (KEYMINT_TRACEBACK=1 shows where; please report)"
            )
            shown = f"keymint: {message}"
        return _fail(given, code, message, ExitCode.FAILURE, lambda: sys.stderr.write(f"{shown}\n"))
    return result if isinstance(result, int) else int(ExitCode.DONE)


def _fail(arguments: list[str], code: str, message: str, exit_code: ExitCode, in_words: Callable[[], object]) -> int:
    """Say what went wrong before a verb could, in the shape that was asked for."""
    if "--json" not in arguments:
        in_words()
        return int(exit_code)
    from keymint.console import Console, Streams  # noqa: PLC0415 - not needed for --help
    from keymint.errors import Diagnostic, Severity  # noqa: PLC0415
    from keymint.report import Report  # noqa: PLC0415

    verb = next((argument for argument in arguments if argument in VERBS), "keymint")
    said = (Diagnostic(code, Severity.ERROR, message),)
    Console(Streams(sys.stdout, sys.stderr), as_json=True).show(Report(verb, None, (), said, exit_code=exit_code))
    return int(exit_code)


def _setting() -> Any:
    """Return what only the command line knows; called when a verb runs, so that ``--help`` needs none of it."""
    from keymint.commands.common import Setting  # noqa: PLC0415 - not needed for --help
    from keymint.console import Streams  # noqa: PLC0415

    plain = bool(os.environ.get("NO_COLOR")) or os.environ.get("TERM") == "dumb"
    err_tty = sys.stderr.isatty()
    return Setting(
        now=_now(),
        monotonic=time.monotonic,
        environment=os.environ,
        cwd=_current_folder(),
        cache=_cache(),
        cores=os.cpu_count() or 1,
        streams=Streams(
            sys.stdout,
            sys.stderr,
            colour_out=sys.stdout.isatty() and not plain,
            colour_err=err_tty and not plain,
            progress=err_tty and os.environ.get("TERM") != "dumb",
        ),
    )


def _cache() -> Path:
    """Return the folder of this user for what can be made again (XDG Base Directory Specification)."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(named) if named.startswith("/") else Path("~/.cache").expanduser()) / "keymint"


def _current_folder() -> Path:
    try:
        return Path.cwd()
    except OSError as error:
        raise click.UsageError(f"the current folder cannot be used: {error.strerror}; go to another one") from None


def _now() -> datetime:
    """Return the time in UTC: that of ``SOURCE_DATE_EPOCH`` (reproducible-builds.org) if it is set."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if not epoch:
        return datetime.now(UTC).replace(microsecond=0)
    try:
        return datetime.fromtimestamp(int(epoch), UTC)
    except (ValueError, OverflowError, OSError):
        raise click.UsageError(
            f"SOURCE_DATE_EPOCH is {epoch!r}, expected seconds since 1970 as a whole number"
        ) from None
