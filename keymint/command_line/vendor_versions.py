# SPDX-License-Identifier: Apache-2.0
"""The option ``--vendors`` of ``keymint check``: known vulnerabilities of the software that reads the keystore."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import click

from comarmor.errors import Diagnostic
from comarmor.text import did_you_mean
from keymint.errors import usage_error
from keymint.run.run import Run

INSTALLED = "installed"

vendors_option = click.option(
    "--vendors",
    is_flag=False,
    flag_value=INSTALLED,
    metavar="NAME=VERSION,...",
    help="Name known vulnerabilities of access control in these versions of vendors [without a list: those that are "
    "installed here].",
)


def advisories(run: Run, given: str | None) -> Iterator[Diagnostic]:
    """Yield the findings on versions of vendors; none without the option.

    Raises:
        KeymintError: the list is malformed, or names an unknown vendor; a usage error.
    """
    if given is None:
        return
    plugins = [run.plugins.build_type(name) for name in run.plugins.names("keymint.build_types")]
    by_vendor = {name: each for each in plugins for name in each.VENDORS}
    if given != INSTALLED:
        for name, version in _listed(given, by_vendor):
            yield from by_vendor[name].advisories(name, version)
        return
    for plugin in dict.fromkeys(by_vendor.values()):
        for name, versions in plugin.installed_vendors(run.setting.environment).items():
            for version in versions:
                yield from plugin.advisories(name, version)


def _listed(given: str, known: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    for part in given.split(","):
        name, is_pair, version = (each.strip() for each in part.partition("="))
        if not is_pair:
            raise usage_error(f"--vendors {given}: {part!r} is not NAME=VERSION", f"known names are {', '.join(known)}")
        if name not in known:
            names = did_you_mean(name, known, f"known are {', '.join(known)}")
            raise usage_error(f"--vendors {given}: unknown vendor {name!r}", names)
        yield name, version
