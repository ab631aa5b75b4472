# SPDX-License-Identifier: Apache-2.0
"""The options that several verbs share."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from comarmor.rules import PERMISSIONS
from comarmor.values import dataclass
from keymint import SPACES
from keymint.api.plugin_loader import Plugins
from keymint.command_line import durations
from keymint.errors import KeymintError
from keymint.executors import PROCESSES
from keymint.stages.work import InstallRequest
from keymint.view.tree import Tree
from keymint.workspace.workspace import Workspace, find, packages

Decorator = Callable[[Any], Any]
"""The executor that is used if none is named."""
DEFAULT_PROFILE_TYPE = "keymint_ros"
PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)


class Number(click.FloatRange):
    """A number within a range. Refuses "nan", which passes every range check."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number, or fail as click does."""
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value!r} is not a number", param, ctx)
        return number


class PluginOption(click.Option):
    """An option that names a plugin.

    Args:
        group: the entry-point group of the plugin.
    """

    def __init__(self, *arguments: Any, group: str, **settings: Any) -> None:
        super().__init__(*arguments, metavar="NAME", **settings)
        self.group = group


def require_known_plugins(context: click.Context, plugins: Plugins) -> None:
    """Require that each plugin that the command line names is installed.

    Raises:
        KeymintError: a plugin is not installed; the exit code is that of a usage error.
    """
    for parameter in context.command.params:
        if not isinstance(parameter, PluginOption) or parameter.name is None:
            continue
        if context.get_parameter_source(parameter.name) is ParameterSource.COMMANDLINE:
            value = context.params[parameter.name]
            for name in value if isinstance(value, tuple) else (value,):
                plugins.require(parameter.group, name)


def complete_package(context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[str]:
    """Complete the name of a package of the workspace, for the shell."""
    slash = "/" if incomplete.startswith("/") else ""
    return _completed(context, incomplete, lambda workspace: [slash + each for each in packages(Tree(), workspace.src)])


def _completed(context: click.Context, incomplete: str, names: Callable[[Workspace], Iterable[str]]) -> list[str]:
    """Return the names in the workspace that begin like a word; none if there is no workspace."""
    try:
        workspace = find(Path(context.params.get("workspace") or "."), {}, Path())
        return [name for name in names(workspace) if name.startswith(incomplete)]
    except KeymintError:
        return []


packages_argument = click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=complete_package)
force_option = click.option("-f", "--force", is_flag=True, help="Replace an existing file with different content.")


def option_group(
    parameter: str, group: type, *options: Decorator, check: Callable[[Any], None] = lambda _: None
) -> Decorator:
    """Return a decorator that adds options whose values reach the verb together, as one argument.

    Args:
        parameter: name of the verb's argument.
        group: dataclass with a field for each option; further fields keep their defaults.
        options: click options, in the order of the help page.
        check: raises a usage error for values that exclude each other.
    """

    def decorate(function: Any) -> Any:
        @functools.wraps(function)
        def grouped(*arguments: Any, **values: Any) -> Any:
            values[parameter] = group(
                **{field.name: values.pop(field.name) for field in fields(group) if field.name in values}
            )
            check(values[parameter])
            return function(*arguments, **values)

        for option in reversed(options):
            grouped = option(grouped)
        return grouped

    return decorate


# -- the options of all verbs ----------------------------------------------------------------------------------------


def common_options(*, workspace: bool, jobs: bool, dry_run: bool, executor: bool) -> Iterator[click.Option]:
    """Yield the options that are not about what a verb does.

    Args:
        workspace: the verb may read or write a workspace.
        jobs: the verb writes several packages at a time.
        dry_run: the verb writes files.
        executor: the verb can compute in other processes, here or on a cluster.
    """
    if workspace:
        yield click.Option(
            ["-w", "--workspace"],
            type=PATH,
            metavar="DIR",
            help="Workspace directory [the one that contains the current directory]. 'keymint --help' lists "
            "the options that move its spaces.",
        )
    yield click.Option(["--json", "as_json"], is_flag=True, help="Print one JSON document (docs/json.md).")
    yield click.Option(["-v", "--verbose"], count=True, help="Show every step, file and note.")
    yield click.Option(["-q", "--quiet"], is_flag=True, help="Show errors only.")
    for space in SPACES if workspace else ():  # 'keymint --help' lists them
        yield click.Option([f"--{space}-space"], type=PATH, metavar="DIR", hidden=True)
    if jobs or executor:
        what = "Write N packages at a time [all cores]." if jobs else "Use N processes [all cores]."
        yield click.Option(["-j", "--jobs"], type=click.IntRange(1, 256), metavar="N", help=what)
    if executor:
        yield click.Option(
            ["--executor"],
            default=PROCESSES,
            show_default=True,
            metavar="WHERE",
            help="Compute in processes of this machine, or on a cluster: dask://HOST:PORT, tls://HOST:PORT "
            "(docs/scale.md).",
        )
    if executor and dry_run:  # the verbs that sign, or record what is proven
        yield click.Option(
            ["--trust-executor"],
            is_flag=True,
            help="Accept what the cluster proves; else documents are proven again here before they are signed.",
        )
    if dry_run:
        yield click.Option(["--dry-run"], is_flag=True, help="Show what would change; write nothing.")


# -- policies outside of a workspace ---------------------------------------------------------------------------------

DEFAULT_DISTRO = "jazzy"
distro_option = click.option(
    "--distro", metavar="NAME", help=f"ROS 2 distribution [$ROS_DISTRO, else {DEFAULT_DISTRO}]."
)
library_option = click.option(
    "--profile-type",
    cls=PluginOption,
    group="keymint.profile_types",
    default=DEFAULT_PROFILE_TYPE,
    show_default=True,
    help="Plugin that ships the policy library.",
)


@dataclass(frozen=True, slots=True)
class PolicyOptions:
    """How to read a policy that lies outside of a workspace.

    Attributes:
        distro: ROS 2 distribution, or None.
        profile_type: plugin that ships the policy library.
        policy_type: plugin that reads the policy.
        trust_links: follow symbolic links out of the folders of ROS packages.
    """

    distro: str | None
    profile_type: str
    policy_type: str
    trust_links: bool = False


policy_options = option_group(
    "policy_options",
    PolicyOptions,
    click.option(
        "--distro",
        metavar="NAME",
        help=f"ROS 2 distribution of the policy library [the workspace's, else $ROS_DISTRO, else {DEFAULT_DISTRO}].",
    ),
    library_option,
    click.option(
        "--policy-type",
        cls=PluginOption,
        group="keymint.policy_types",
        default="keymint_ros2_comarmor",
        show_default=True,
        help="Plugin that reads the policy.",
    ),
    click.option(
        "--trust-links",
        is_flag=True,
        help="Follow symbolic links out of the folders of ROS packages, as 'colcon build --symlink-install' makes.",
    ),
)


# -- new workspaces --------------------------------------------------------------------------------------------------


valid_for_option = click.option(
    "--valid-for",
    callback=durations.validity,
    metavar="PERIOD",
    help="Length of validity of certificates and grants, from a day back on: 90d, 12h, 2y, P6M [1 year].",
)


# -- building and installing -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DocumentOptions:
    """What shapes the documents of a build; see :class:`keymint.api.BuildOptions`."""

    allow_vendor_specific: bool
    optimise: bool
    hints: Path | None


document_options = option_group(
    "document_options",
    DocumentOptions,
    click.option(
        "--allow-vendor-specific",
        is_flag=True,
        help="Report rules that vendors of a transport decide differently as warnings, not as errors.",
    ),
    click.option(
        "--optimise/--no-optimise",
        default=True,
        show_default=True,
        help="Rewrite permissions into fewer rules and expressions, proven equivalent.",
    ),
    click.option(
        "--hints",
        type=PATH,
        metavar="FILE",
        help="Put frequent requests first: a CSV of subject,permission,object,count, or a graph.",
    ),
)

renew_option = click.option("--renew", is_flag=True, help="Replace private keys; by default keys are kept.")
prove_option = click.option(
    "--prove/--no-prove",
    default=True,
    show_default=True,
    help="Install only if each document is proven to permit exactly what the policy allows.",
)
standard_only_option = click.option(
    "--allow-vendor-specific",
    is_flag=True,
    help="Prove documents by the transport's standard only; for builds with --allow-vendor-specific.",
)
strict_option = click.option(
    "--strict",
    is_flag=True,
    help="Accept no exceptions: what a claim leaves out counts as not proven.",
)


def _prove_if_strict(request: InstallRequest) -> None:
    if request.strict and not request.prove:
        raise click.UsageError("--strict demands a proof, which --no-prove leaves out.")


# A verb that has '--force', '--renew' or '--allow-vendor-specific' declares it itself; the request has its value.
install_request = option_group(
    "request",
    InstallRequest,
    click.option("--prune", is_flag=True, help="Remove installed enclaves that have no source package."),
    click.option(
        "--new-authority",
        multiple=True,
        metavar="NAME",
        help="Replace the key and certificate of this authority at once. Deployed enclaves reject what the new one "
        "signs until all are redeployed; 'keymint authority replace' goes step by step. May be repeated.",
    ),
    prove_option,
    strict_option,
    click.option(
        "--revoke-superseded",
        is_flag=True,
        help="Where new signed rights allow less than those they replace, revoke the certificate and issue a new one.",
    ),
    check=_prove_if_strict,
)


# -- authorities -----------------------------------------------------------------------------------------------------


def complete_authority(context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[str]:
    """Complete the name of an authority of the workspace, for the shell."""

    def names(workspace: Workspace) -> Iterable[str]:
        return sorted(entry.removesuffix(".cert.pem") for entry, _ in Tree().names(workspace.public))

    return _completed(context, incomplete, names)


authority_argument = click.argument("name", metavar="NAME", shell_complete=complete_authority)
flag_day_option = click.option(
    "--flag-day",
    is_flag=True,
    help="Accept that all subjects restart together, where the old and the new certificate do not work side by side.",
)


# -- transports ------------------------------------------------------------------------------------------------------

kind_option = click.option(
    "--kind",
    type=click.Choice(tuple(PERMISSIONS)),
    help="Kind of OBJECT; 'topic' is a raw topic of the transport [a name that begins with '/' is a ROS name].",
)
vendors_of_option = click.option(
    "--distro",
    metavar="NAME",
    help="Ask for the versions of vendors that this ROS 2 distribution ships [the workspace's]. Names of the transport "
    "stay those of the workspace.",
)
transport_option = click.option(
    "-t",
    "--transport",
    "chosen",
    cls=PluginOption,
    group="keymint.transports",
    multiple=True,
    help="Ask this transport; may be repeated [all usable ones; 'keymint transports' lists them].",
)
