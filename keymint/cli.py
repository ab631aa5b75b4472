# SPDX-License-Identifier: Apache-2.0
"""The command line: finds the verbs. The only module that reads the clock, the environment and the umask."""

from __future__ import annotations

import functools
import os
import re
import signal
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, cast

import click

from comarmor.text import lazy_regex, one_line
from keymint import __version__
from keymint.command_line.verb_group import VerbGroup
from keymint.errors import ExitCode
from keymint.host.streams_and_signals import Output, OutputError, StoppedError, received_signal, settle

if TYPE_CHECKING:
    from keymint.output.console import Streams
    from keymint.run.run import Setting
    from keymint.view.recorded_answers import Call

GROUPS: Mapping[str, Mapping[str, str]] = {
    "Start": {
        "provision": "Run init, create, build and install in one step, e.g. in CI.",
        "init": "Create a workspace.",
        "create": "Create source packages from the policy.",
        "build": "Build unsigned documents.",
        "install": "Sign documents and stage enclaves for deployment.",
    },
    "Understand": {
        "lint": "Report unreachable, redundant and suspicious rules of a policy.",
        "diff": "Compare two policies: which subject gains or loses which permission.",
        "query": "Ask a policy who can do what, including subjects that it does not name.",
        "why": "Explain one decision, from policy to transport.",
        "graph": "Draw a policy, or the graph of a system.",
        "test": "Run the unit tests of a policy.",
        "fmt": "Bring policy files into their canonical form.",
    },
    "Assure": {
        "check": "Compare the installed keystore with its expected state.",
        "status": "Show the stage and the expiry of every package.",
        "verify": "Ask implementations of transports what they permit, and compare with the policy.",
        "prove": "Prove that installed documents permit exactly what the policy allows, for all names.",
        "report": "Write evidence for an audit: rights by risk, certificates, changes, proofs, findings, runs.",
    },
    "Life": {
        "renew": "Renew certificates and permissions that are due.",
        "revoke": "Revoke certificates, and issue new ones that old permissions do not match.",
        "remove": "Remove packages for good: sources, key and enclave; revoke their certificates.",
        "authority": "Show, renew, replace, import or export the certificate authorities.",
        "set": "Change a setting of the workspace: domain, distribution, form of names, length of validity.",
        "issued": "List the certificates that were issued, and which are revoked.",
        "crl": "Show the revocation lists, or issue them again.",
        "harden": "Add what an adopted keystore lacks, step by step, each with its cost.",
    },
    "Robots": {
        "env": "Print the environment variables of a process that uses an enclave.",
        "bundle": "Write installed enclaves into signed files for robots.",
        "request": "Ask for a certificate, on the robot: its key never leaves it.",
        "sign": "Certify keys that robots made.",
        "accept": "Accept bundles that an authority made for this robot.",
    },
    "Exchange": {
        "import": "Translate a policy of another tool, and prove that both mean the same.",
        "adopt": "Examine a keystore that another tool made, and take it over.",
        "learn": "Generate the smallest policy that allows a graph.",
        "discover": "Record the graph of a running system, or read captures of one.",
        "export": "Write a policy in the language of another tool, proven to mean the same.",
    },
    "Tool": {
        "explain": "Explain a code in a message: cause, effect and remedy.",
        "completion": "Print the completion script for a shell.",
        "plugins": "List the installed plugins.",
        "transports": "List the implementations of transports: which are usable here, and how to install the others.",
    },
}
"""The verbs with their help, in groups; each is a folder of :mod:`keymint.commands`."""
VERBS = {verb: help_ for group in GROUPS.values() for verb, help_ in group.items()}


_JSON_FORMAT = lazy_regex(r"-f ?json|--format[ =]json")
_DEFAULTS = {"COLOR", "FORMAT", "JOBS", "QUIET", "THRESHOLD", "VERBOSE", "WITHIN"}
"""Ends of the environment variables that may be defaults of options; see :mod:`keymint.command_line.defaults`."""
_LAST = datetime(9900, 1, 1, tzinfo=UTC)
"""A later clock is an error: authorities are valid for ten years, and certificates end in the year 9999 (RFC 5280)."""


@click.group(
    cls=VerbGroup, groups=GROUPS, module="keymint.commands.{group}.{verb}",
    others={"import": "import_policy", "set": "set_setting"},
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)  # fmt: skip
@click.version_option(__version__, prog_name="keymint")
@click.option("--color", type=click.Choice(("auto", "always", "never")), help="Colours; auto: on a terminal [auto].")
def cli(color: str | None) -> None:
    """Mint keys and notarize access control for robots: from a ComArmor policy to a keystore.

    \b
    keymint provision POLICY -w WORKSPACE     everything in one step; or stage by stage:
    keymint init my_ws && cd my_ws            a workspace with its authorities
    keymint create --all                      profile/comarmor.d/ -> src/
    keymint build                             src/ -> build/     (unsigned)
    keymint install                           build/ -> install/ (signed)
    source install/keystore.bash              ROS 2 finds the keystore

    'keymint VERB --help' describes a verb; with --help-all also its options that few users need. 'keymint explain CODE'
    says more about an error or a finding.

    Exit codes: 0 done, 1 failure, 2 usage, 3 findings, 130 interrupted, 143 terminated.
    """


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    out, err = Output(sys.stdout), Output(sys.stderr, required=False)
    # Libraries that print use these streams, which report failures, too.
    with redirect_stdout(cast("TextIO", out)), redirect_stderr(cast("TextIO", err)):
        try:
            try:
                recalled = _recalled(given)
                code = _carried_out(given) if recalled is None else recalled
                out.flush()
            except StoppedError as stop:
                code = report_signal(given, stop.number)
            if code and "--json" not in given and next(filter(VERBS.__contains__, given), "") == "env":
                out.write("false\n")  # a shell that evaluates the output must not go on without the variables
            out.flush()
        except OutputError as error:
            out.give_up()
            err.write(f"keymint: error: standard output: {error} [write-failed]\n")
            code = int(ExitCode.FAILURE)
        settle()
        err.flush()
        return code


def _carried_out(given: Sequence[str]) -> int:
    os.umask(0o022)  # secrets are 0600 and public files 0644, whatever the user's umask
    if not sys.warnoptions:  # warnings of libraries are for programmers, not for users
        warnings.simplefilter("ignore")
    try:
        of_run = functools.partial(_setting, given)
        result: Any = cli.main(list(given), prog_name="keymint", standalone_mode=False, obj=of_run)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.UsageError as error:
        message = " ".join(error.format_message().split()).removesuffix(".")
        if error.ctx and message.startswith(("Got unexpected", "Missing argument")):
            message += f"; expected: {' '.join(error.ctx.get_usage().split()).removeprefix('Usage: ')}"
            extra = message.partition("extra argument (")[2].partition(")")[0]
            if extra and any(each.name == "workspace" for each in error.ctx.command.params):
                message += f" (a workspace is named by -w: -w {extra})"
        return _fail(given, "usage", message, ExitCode.USAGE, one_line(f"error: {message}"))
    except (KeyboardInterrupt, click.Abort):
        return report_signal(given, signal.SIGINT)
    except OutputError:
        raise
    except Exception as error:  # noqa: BLE001 - the user gets one line for our bugs too
        if received_signal():  # a signal that arrived in C code, which raised another exception
            return report_signal(given, received_signal())
        return _failed(given, error)
    return result if isinstance(result, int) else int(ExitCode.DONE)


def _failed(given: Sequence[str], error: Exception) -> int:
    """Report an exception that no verb handled, on one line: a system error, or a bug."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        # The system refuses a path, e.g. one that is too long: not a bug.
        place = one_line(os.fsdecode(error.filename) if isinstance(error.filename, bytes) else str(error.filename))
        shown = f"{place}: error: {error.strerror}"
        return _fail(given, "system", f"{place}: {error.strerror}", ExitCode.FAILURE, shown)
    if os.environ.get("KEYMINT_TRACEBACK"):
        raise error
    what = one_line(f"internal error: {type(error).__name__}: {error}")
    message = f"{what} (KEYMINT_TRACEBACK=1 shows where; please report)"
    return _fail(given, "internal", message, ExitCode.FAILURE, f"keymint: {message}")


def report_signal(arguments: Sequence[str], number: int) -> int:
    """Report that a signal ended the run, and return the exit code.

    Args:
        arguments: arguments of the command line.
        number: number of the signal.
    """
    exit_code = ExitCode.TERMINATED if number == signal.SIGTERM else ExitCode.INTERRUPTED
    message = f"{exit_code.name.lower()}; no file is incomplete; run the command again to continue"
    return _fail(arguments, "interrupted", message, exit_code, f"keymint: {message}")


def _fail(arguments: Sequence[str], code: str, message: str, exit_code: ExitCode, in_words: str) -> int:
    """Report an error outside of a verb, as JSON if ``--json`` was given.

    If a JSON document was already started, a second one would make both unreadable.
    """
    as_json = "--json" in arguments or ("diff" in arguments and bool(_JSON_FORMAT.search(" ".join(arguments))))
    if not as_json or getattr(sys.stdout, "began", False):
        sys.stderr.write(f"{in_words} [{code}]\n")
        return int(exit_code)
    from comarmor.errors import Diagnostic  # noqa: PLC0415
    from keymint.output.console import Console, Streams  # noqa: PLC0415 - not needed for --help
    from keymint.output.report import Report  # noqa: PLC0415

    verb = next((argument for argument in arguments if argument in VERBS), "keymint")
    report = Report(verb, None, (), (Diagnostic.error(code, message),), exit_code=exit_code)
    Console(Streams(sys.stdout, sys.stderr), as_json=True).show(report)
    return int(exit_code)


def call_of(given: Sequence[str]) -> Call:
    """Return the command with all that its answer may depend on."""
    from keymint.view.recorded_answers import DEFAULTS_FILE, Call, Consulted  # noqa: PLC0415 - not needed for --help

    try:
        folder = str(Path.cwd())
    except OSError as error:
        raise click.UsageError(f"the current directory is unusable: {error.strerror}; change to another one") from None
    colours = _may_have_colours(sys.stdout), _may_have_colours(sys.stderr)
    config = _own_folder("XDG_CONFIG_HOME", "~/.config")
    user_defaults = config and f"{config}/{DEFAULTS_FILE}"
    named = [each for each in os.environ if each.startswith("KEYMINT_") and each.rpartition("_")[2] in _DEFAULTS]
    variables = tuple((name, os.environ[name]) for name in sorted(named))
    consulted = Consulted(os.environ)
    return Call(
        given, folder, colours, _now().timestamp(), time.time_ns(), consulted, _width(), variables, user_defaults
    )


def _width() -> int | None:
    """Return COLUMNS, that of the terminal, or None, as :mod:`shutil` would, which loads compressions for archives."""
    try:
        if (columns := int(os.environ.get("COLUMNS", ""))) > 0:
            return columns
    except ValueError:
        pass
    try:
        return os.get_terminal_size().columns or None
    except OSError:
        return None


def _may_have_colours(stream: TextIO) -> bool:
    """Tell whether a stream has colours without ``--color``: no-color.org, force-color.org; the former is stronger."""
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR", "0") not in ("", "0"):
        return True
    return stream.isatty() and os.environ.get("TERM") != "dumb"


def _recalled(given: Sequence[str]) -> int | None:
    """Answer a command that was carried out before, and return its exit code."""
    if not given or given[0].startswith("-") or "-h" in given or "--help" in given:
        return None
    from keymint.view import recorded_answers  # noqa: PLC0415 - not needed for --help

    try:
        answer = recorded_answers.recall(call_of(given)) if given[0] in recorded_answers.VERBS else None
    except click.UsageError:
        return None  # there is no usable clock or current directory, which the command reports if it needs one
    if answer is None:
        return None
    sys.stderr.write(answer.err)
    sys.stdout.write(answer.out)
    return answer.exit_code


def _setting(given: Sequence[str]) -> Any:
    """Return the environment of the run; called when a verb runs, so that ``--help`` needs none of it."""
    from keymint.output.console import Streams  # noqa: PLC0415 - not needed for --help

    call = call_of(given)
    progress = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    ask = _ask if sys.stdin is not None and sys.stdin.isatty() else None
    agrees = _agrees if ask and sys.stderr.isatty() else None
    streams = Streams(sys.stdout, sys.stderr, *call.colours, progress=progress, width=call.width)
    # The process may have been started without standard input.
    return setting(call, streams, ask, agrees, lambda most: b"" if sys.stdin is None else sys.stdin.buffer.read(most))


def setting(
    call: Call,
    streams: Streams,
    ask: Callable[[str], str] | None = None,
    agrees: Callable[[str], bool] | None = None,
    read: Callable[[int], bytes] = lambda _most: b"",
) -> Setting:
    """Return the environment of a run: the clock, the folders and the processors of this machine.

    Args:
        call: the command; see :func:`call_of`.
        streams: where output goes.
        ask: shows a text and returns what the user types, unseen; None if there is no terminal.
        agrees: shows a question and returns whether the user types yes; None if there is no terminal for it.
        read: returns at most so many bytes of standard input.
    """
    from keymint.run.run import Setting  # noqa: PLC0415 - not needed for --help

    return Setting(
        now=datetime.fromtimestamp(call.now, UTC),
        monotonic=time.monotonic,
        environment=call.environment,
        cwd=Path(call.cwd),
        cache=_cache(),
        cores=os.cpu_count() or 1,
        streams=streams,
        call=call,
        ask=ask,
        agrees=agrees,
        read=read,
        who=_who,
    )


def _who() -> tuple[str, str]:
    """Return the names of the user and of this host; of a user that ``sudo`` made another one, both names."""
    import pwd  # noqa: PLC0415 - only runs that write need it

    try:
        user = pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:  # e.g. in a container
        user = str(os.geteuid())
    before = os.environ.get("SUDO_USER", "")
    return (f"{user} (sudo of {before})" if before and before != user else user), os.uname().nodename


def _ask(text: str) -> str:
    """Show a text on the terminal, and return what the user types, which is not shown; empty at the end of input."""
    import getpass  # noqa: PLC0415 - few runs need it

    try:
        return getpass.getpass(text)
    except EOFError:
        return ""


def _agrees(question: str) -> bool:
    """Show a question on the terminal, and return whether the user types yes; the end of input is no."""
    sys.stderr.write(question)
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in {"y", "yes"}


def _cache() -> Path:
    """Return the cache directory of this user; in /tmp, where its users check who owns it, if there is no home."""
    return Path(_own_folder("XDG_CACHE_HOME", "~/.cache") or f"/tmp/keymint-{os.getuid()}")  # noqa: S108


def _own_folder(variable: str, usual: str) -> str:
    """Return this user's folder for Keymint (XDG Base Directory Specification); empty if there is no home directory."""
    named = os.environ.get(variable, "")
    folder = named if named.startswith("/") else os.path.expanduser(usual)  # noqa: PTH111 - of a text
    return f"{folder}/keymint" if folder.startswith("/") else ""


def _now() -> datetime:
    """Return the time in UTC: ``SOURCE_DATE_EPOCH`` (reproducible-builds.org) if it is set, else the clock."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch and re.fullmatch("[0-9]{1,12}", epoch) and int(epoch) < _LAST.timestamp():
        return datetime.fromtimestamp(int(epoch), UTC)
    if epoch:
        raise click.UsageError(
            f"SOURCE_DATE_EPOCH is {epoch!r}, expected seconds since 1970 as a whole number, before the year {_LAST:%Y}"
        )
    seconds = time.time()
    if 0 <= seconds < _LAST.timestamp():
        return datetime.fromtimestamp(int(seconds), UTC)
    raise click.UsageError(
        f"the system clock is {seconds:.0f} seconds after 1970, expected a time before the year {_LAST:%Y}: set it"
    )
