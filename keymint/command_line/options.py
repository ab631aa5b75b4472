# SPDX-License-Identifier: Apache-2.0
"""The options that several verbs share, and lengths of time as their values.

Options:
    force: Replace an existing file with different content.
    valid_for: Length of validity of certificates and grants, which begins a day ago: 90d, 12h, 2y, P6M [1 year].
    prune: Remove installed enclaves that have no source package.
    new_authority: Replace the key and certificate of this authority at once. Deployed enclaves reject what the new one
        signs until all are redeployed; 'keymint authority replace' goes step by step. May be repeated.
    prove: Install only if each document is proven to permit exactly what the policy allows.
    standard: Prove documents by the transport's standard only; for builds with --allow-vendor-specific.
    strict: Accept no exceptions: what a claim leaves out counts as not proven.
    revoke_superseded: Where new signed rights allow less than those they replace, revoke the certificate and issue a
        new one.
    flag_day: Accept that all subjects restart together, where the old and the new certificate do not work side by side.
    kind: Kind of OBJECT; 'topic' is a raw topic of the transport [a name that begins with '/' is a ROS name].
    vendors_of: Ask for the versions of vendors that this ROS 2 distribution ships [the workspace's]. Names of the
        transport stay those of the workspace.
    implementation: Ask this implementation of a transport; may be repeated [all usable ones; 'keymint transports' lists
        them].
    bundle: File of the bundle, or folder of several, which are named NAME.bundle [the current directory].
"""

from __future__ import annotations

import math
import re
import sys
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from comarmor.rules import PERMISSIONS, RAW_PREFIXES
from comarmor.text import lazy_regex
from comarmor.values import Data
from keymint import api
from keymint.api.plugin_loader import Plugins
from keymint.command_line import named_packages
from keymint.command_line.verb import FILE, Run, argument, flag, option, option_group, option_texts, path_option, plugin
from keymint.errors import Diagnostic, usage_error
from keymint.life.terms import Threshold
from keymint.names import RAW
from keymint.stages.work import InstallRequest

_, _TEXTS = option_texts(sys.modules[__name__])
DEFAULT_PROFILE_TYPE = "keymint_ros"
Names = named_packages.Names


def names_group(word: str = "NAME", *, required: bool = False, state: bool = True) -> Any:
    """Return the default of an argument of a verb that are the packages which the command line names.

    Args:
        word: what the help page calls one.
        required: the verb does nothing to all packages unless somebody says so.
        state: ``--state`` may choose among them.
    """

    def check(names: Names) -> None:
        if required and not names:
            raise click.UsageError(f"Missing argument '{word}...': a name, a pattern such as '/r0/*', or --from FILE.")

    return option_group(
        Names,
        check,
        given=argument(nargs=-1, metavar=f"{word}..." if required else f"[{word}]..."),
        listed=path_option("--from", kind=FILE),
        **({"state": option(type=click.Choice(("due", "stale", "revoked")))} if state else {}),
    )


force_option = flag("-f", help=_TEXTS.get("force"))


class Number(click.FloatRange):
    """A number within a range. Refuses "nan", which passes every range check."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number, or fail as click does."""
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value!r} is not a number", param, ctx)
        return number


# -- policies outside of a workspace ---------------------------------------------------------------------------------

DEFAULT_DISTRO = "jazzy"
distro_option = option(metavar="NAME", help=f"ROS 2 distribution [$ROS_DISTRO, else {DEFAULT_DISTRO}].")
library_option = plugin("keymint.profile_types", default=DEFAULT_PROFILE_TYPE, show_default=True)


class PolicyOptions(Data):
    """How to read a policy that lies outside of a workspace; the distribution may be None.

    Options:
        profile_type: Plugin that ships the policy library.
        policy_type: Plugin that reads the policy.
        trust_links: Follow symbolic links out of the folders of ROS packages, as 'colcon build --symlink-install'
            makes.
    """

    distro: str | None
    profile_type: str
    policy_type: str
    trust_links: bool = False


policy_options = option_group(
    PolicyOptions,
    distro=option(
        metavar="NAME",
        help=f"ROS 2 distribution of the policy library [the workspace's, else $ROS_DISTRO, else {DEFAULT_DISTRO}].",
    ),
    profile_type=library_option,
    policy_type=plugin("keymint.policy_types", default="keymint_ros2_comarmor", show_default=True),
    trust_links=flag(),
)


# -- lengths of time: 12h, 30d, 4w, 2y, and ISO 8601 durations ------------------------------------------------------

_UNITS = {"h": timedelta(hours=1), "d": timedelta(days=1), "w": timedelta(weeks=1), "y": timedelta(days=365)}
_ISO = lazy_regex(
    r"P(?=.)(?:(?P<y>[0-9]{1,4})Y)?(?:(?P<m>[0-9]{1,4})M)?(?:(?P<w>[0-9]{1,5})W)?(?:(?P<d>[0-9]{1,6})D)?(?:T(?:(?P<h>[0-9]{1,6})H))?"
)
_MONTH = timedelta(days=30)
_SHORTEST = timedelta(hours=1)
LONGEST = timedelta(days=365 * 200)
"""Longer than any validity."""
_EXAMPLES = "write 12h, 30d, 4w or 2y"


def period(value: str) -> timedelta:
    """Return a length of time for an option, e.g. ``30d``; a year has 365 days.

    Raises:
        click.BadParameter: it is none, or longer than any validity.
    """
    if match := re.fullmatch(r"([0-9]{1,6})([hdwy])", value):
        length = int(match[1]) * _UNITS[match[2]]
    elif match := _ISO.fullmatch(value):
        given = {unit: int(number) for unit, number in match.groupdict().items() if number}
        length = sum((number * _UNITS.get(unit, _MONTH) for unit, number in given.items()), timedelta())
    else:
        raise click.BadParameter(f"{value!r} is not a length of time; {_EXAMPLES}")
    if length > LONGEST:
        raise click.BadParameter(f"{value!r} is longer than any validity")
    return length


def validity(value: str) -> timedelta:
    """Return a length of validity for an option.

    Raises:
        click.BadParameter: it is no length of time, or not between an hour and 200 years.
    """
    length = period(value)
    if length < _SHORTEST:
        raise click.BadParameter(f"{value!r} is shorter than an hour")
    return length


def iso_validity(value: str) -> str:
    """Return a length of validity for an option as an ISO 8601 duration: ``P90D`` for ``90d``; errors as above."""
    validity(value)
    if value.startswith("P"):
        return value
    number, unit = int(value[:-1]), value[-1].upper()
    return f"PT{number}H" if unit == "H" else f"P{number}{unit}"


def threshold(value: str) -> Threshold:
    """Return when something is due for renewal: ``66%`` of its validity, or the time that is left, e.g. ``30d``.

    Raises:
        click.BadParameter: it is neither, or not a share between 1 % and 99 %.
    """
    if match := re.fullmatch(r"([1-9][0-9]?)%", value):
        return Threshold(share=int(match[1]) / 100)
    if value.endswith("%"):
        raise click.BadParameter(f"{value!r} is not a share from 1% to 99%")
    return Threshold(left=period(value))


# -- new workspaces --------------------------------------------------------------------------------------------------


valid_for_option = option(type=iso_validity, metavar="PERIOD", help=_TEXTS.get("valid_for"))


# -- building and installing -----------------------------------------------------------------------------------------


class DocumentOptions(Data):
    """What shapes the documents of a build; see :class:`keymint.api.BuildOptions`.

    Options:
        allow_vendor_specific: Report rules that vendors of a transport decide differently as warnings, not as errors.
        optimise: Rewrite permissions into fewer rules and expressions, proven equivalent.
        hints: Put frequent requests first: a CSV of subject,permission,object,count, or a graph.
    """

    allow_vendor_specific: bool = flag()
    optimise: bool = option("--optimise/--no-optimise", default=True, show_default=True, hidden=True)
    hints: Path | None = path_option(hidden=True)


document_options = option_group(DocumentOptions)


def build_options(run: Run, given: DocumentOptions) -> api.BuildOptions:
    """Return the options of a build.

    Raises:
        KeymintError: the file of hints cannot be read, or is malformed.
        click.UsageError: hints are given without optimisation.
    """
    if given.hints is not None and not given.optimise:
        raise click.UsageError("--hints changes the order of rules, which --no-optimise keeps.")
    hints: tuple[api.Hint, ...] = ()
    if given.hints is not None:
        from keymint.command_line.named_files import read_input  # noqa: PLC0415 - few builds have hints
        from keymint.command_line.request_counts import load_hints  # noqa: PLC0415

        hints = load_hints(read_input(run, given.hints), str(given.hints))
    return api.BuildOptions(given.allow_vendor_specific, given.optimise, hints)


prove_option = option("--prove/--no-prove", default=True, show_default=True, help=_TEXTS.get("prove"))
standard_option = flag(help=_TEXTS.get("standard"))
strict_option = flag(help=_TEXTS.get("strict"))


def _prove_if_strict(request: InstallRequest) -> None:
    if request.strict and not request.prove:
        raise click.UsageError("--strict demands a proof, which --no-prove leaves out.")


def install_request(**more: Any) -> Any:
    """Return the default of an argument of a verb that is a request to install, with more options for it in front."""
    return option_group(
        InstallRequest,
        _prove_if_strict,
        **more,
        prune=flag(help=_TEXTS.get("prune")),
        new_authority=option(multiple=True, metavar="NAME", help=_TEXTS.get("new_authority")),
        prove=prove_option,
        strict=strict_option,
        revoke_superseded=flag(help=_TEXTS.get("revoke_superseded")),
    )


# -- authorities -----------------------------------------------------------------------------------------------------


authority_argument = argument(metavar="NAME")
flag_day_option = flag(help=_TEXTS.get("flag_day"))


# -- transports ------------------------------------------------------------------------------------------------------

kind_option = option(type=click.Choice(tuple(PERMISSIONS)), help=_TEXTS.get("kind"))


def raw_topic_doubt(kind: str, name: str, *, typed: bool) -> tuple[Diagnostic, ...]:
    """Return a warning if a denied object was read as a raw topic, as its name has no ``/`` in front, or nothing.

    Args:
        kind: kind of the object.
        name: its name.
        typed: the user named the kind.
    """
    if kind != RAW or typed or name.startswith(RAW_PREFIXES):
        return ()
    help_ = f"did you mean {'/' + name!r}? If not, add --kind {RAW}"
    return (Diagnostic.warning("query-object", f"{name!r} is read as a raw topic", help=help_),)


vendors_of_option = option(metavar="NAME", help=_TEXTS.get("vendors_of"))
implementation_option = plugin(
    "keymint.transports", "-i", "--implementation", multiple=True, help=_TEXTS.get("implementation")
)
bundle_output_option = path_option("-o", metavar="PATH", help=_TEXTS.get("bundle"))


# -- graphs of systems -------------------------------------------------------------------------------------------------


def graph_source(plugins: Plugins, name: str | None, option: str) -> api.GraphSource:
    """Return the graph source of a name; without a name the only installed one.

    Args:
        plugins: the installed plugins.
        name: what the command line names, or None.
        option: the option that names it, for the message.

    Raises:
        KeymintError: no name is given, and several graph sources are installed, or none; or it cannot be loaded.
    """
    if name is not None:
        return plugins.graph_source(name)
    installed = plugins.names("keymint.graph_sources")
    if len(installed) == 1:
        return plugins.graph_source(installed[0])
    if not installed:
        raise usage_error("no graph source is installed", "'keymint plugins' lists the installed plugins")
    raise usage_error(f"several graph sources are installed: {', '.join(installed)}", f"choose one: {option} NAME")
