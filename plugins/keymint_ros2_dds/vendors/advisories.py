# SPDX-License-Identifier: Apache-2.0
"""Known vulnerabilities of access control in vendors of DDS, and the versions that are installed here.

The table, ``advisories.toml``, was made on its date ``as_of`` from the sources that it names: tags of the vendors'
repositories that contain a fix, notes of releases, and records of CVEs. Nothing is fetched. No CVE of Zenoh's access
control was found. Those against SROS2 (CVE-2019-19625 and -19627, governance that leaks names) concern files that
Keymint writes itself.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace

from keymint.errors import Diagnostic, usage_error

_PACKAGES = {
    "fastdds": r"libfastrtps|libfastdds|ros-[a-z]+-fast(?:rtps|dds)$",
    "cyclonedds": r"libddsc|ros-[a-z]+-cyclonedds$",
}
_SHARES = {"fastrtps": "fastdds", "fastdds": "fastdds", "cyclonedds": "cyclonedds"}
_VERSION = re.compile(r"\d+(?:\.\d+)+")


_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
AS_OF: str = _TABLE["as_of"]
ADVISORIES = tuple(SimpleNamespace(**each) for each in _TABLE["advisory"])
"""The rows of the table, which says what their fields are."""


def number(version: str) -> tuple[int, ...]:
    """Return the numbers of a version such as ``2.9.1+ds-1``.

    Raises:
        KeymintError: it does not begin with two numbers; a usage error.
    """
    found = _VERSION.match(version)
    if found is None:
        raise usage_error(f"{version!r} is no version", "write major, minor and patch, e.g. 2.14.1")
    return tuple(map(int, found[0].split(".")))


def affects(advisory: SimpleNamespace, version: str) -> bool:
    """Tell whether a version has a vulnerability, as far as the table knows: a line without a known fix has it."""
    own = number(version)
    fixed = {number(each)[:2]: number(each) for each in advisory.fixed}
    if own[:2] in fixed:
        return own < fixed[own[:2]]
    return not advisory.everywhere or own < number(advisory.everywhere)


def advisories(vendor: str, version: str) -> tuple[Diagnostic, ...]:
    """See :meth:`keymint.api.BuildType.advisories`."""
    return tuple(_finding(each, version) for each in ADVISORIES if each.vendor == vendor and affects(each, version))


def _finding(advisory: SimpleNamespace, version: str) -> Diagnostic:
    since = f"{advisory.everywhere} and later" if advisory.everywhere else "of other lines the fixed version is unknown"
    fixed = ", ".join((*advisory.fixed, since))
    message = f"{advisory.vendor} {version} has {advisory.cve} ({advisory.date}): {advisory.what}; fixed in {fixed}"
    help_ = f"update it; a package of a Linux distribution may have the fix already [{advisory.source}; as of {AS_OF}]"
    return Diagnostic.warning("vendor-advisory", message, None, help_)


def installed_vendors(environment: Mapping[str, str]) -> Mapping[str, Sequence[str]]:
    """See :meth:`keymint.api.BuildType.installed_vendors`: packages of Debian, and those of sourced ROS 2."""
    found: dict[str, dict[str, None]] = {}
    for vendor, version in (*_of_debian(environment), *_of_ros(environment)):
        found.setdefault(vendor, {})[version] = None
    return {vendor: tuple(versions) for vendor, versions in sorted(found.items())}


def _of_debian(environment: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    query = shutil.which("dpkg-query", path=environment.get("PATH"))
    if query is None:
        return
    listed = subprocess.run(  # noqa: S603 - no shell, and no word is from outside
        [query, "-W", "-f", "${db:Status-Status} ${Package} ${Version}\\n"], capture_output=True, check=False, text=True
    ).stdout
    for state, package, version in (line.split(" ", 2) for line in listed.splitlines()):
        for vendor, names in _PACKAGES.items():
            if state == "installed" and re.match(names, package) and (known := _VERSION.match(version)):
                yield vendor, known[0]


def _of_ros(environment: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    for prefix in filter(None, environment.get("AMENT_PREFIX_PATH", "").split(":")):
        for share, vendor in _SHARES.items():
            manifest = Path(prefix, "share", share, "package.xml")
            try:
                found = re.search(r"<version>\s*(\d+(?:\.\d+)+)", manifest.read_text(errors="replace"))
            except OSError:
                continue
            if found:
                yield vendor, found[1]
