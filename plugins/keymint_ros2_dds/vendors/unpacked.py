# SPDX-License-Identifier: Apache-2.0
"""Newer versions of vendors, which ``make vendors-new`` unpacks into the cache: each with its libraries and loader.

Nothing of them is installed. A program that is built for one is started by its loader, because the machine's may be too
old for its libraries.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from comarmor.values import dataclass
from keymint.host.vendor_process import MissingVendorError
from keymint_ros2_dds.vendors import program_cache
from keymint_ros2_dds.vendors.probe_builds import Probe

HELP = "'make vendors-new' in a checkout of Keymint unpacks it from Debian"


@dataclass(frozen=True, slots=True)
class Unpacked:
    """A version of a vendor.

    Attributes:
        version: the version.
        headers: its folder of headers.
        libraries: its folder of shared objects.
        loader: the program that loads them (ELF's interpreter).
    """

    version: str
    headers: Path
    libraries: Path
    loader: Path

    @property
    def starter(self) -> tuple[str, ...]:
        """The words that come before a program, so that it runs with these libraries and no others."""
        return str(self.loader), "--library-path", str(self.libraries)

    @property
    def plugins(self) -> Path:
        """The folder of the security plugins of Cyclone DDS; Fast DDS has none."""
        return self.libraries / "libddsc0debian"

    def built(self, probe: Probe) -> Probe:
        """Return a probe that is built from the headers and libraries of this version; :attr:`starter` starts it.

        The libraries need a newer C library than the linker finds on the machine, so it does not look for that.

        Args:
            probe: how to build it with the machine's headers.
        """
        headers = f"-I{self.headers}", f"-I{self.headers / self.libraries.name}"
        folders = (*headers, f"-L{self.libraries}", "-Wl,--allow-shlib-undefined")
        return replace(probe, folders=folders, packages=(probe.compilers[0],))


def unpacked(cache: Path, names: Iterable[str]) -> Unpacked:
    """Return the first of these versions that is in the cache.

    Args:
        cache: this user's cache.
        names: folders of versions: a vendor and a version.

    Raises:
        MissingVendorError: none is there, or others could have written it.
    """
    folder, tried = cache / "vendors", tuple(names)
    found = {name: next((folder / name).glob("usr/lib/*/ld-linux*.so.*"), None) for name in tried}
    for name, loader in found.items():
        if loader is None:
            continue
        if not program_cache.is_ours_alone(folder):
            reason = f"others may write to {folder} or to a folder above it"
            raise MissingVendorError(name, reason, "take this right from them (chmod)")
        return Unpacked(name.rpartition("-")[2], folder / name / "usr/include", loader.parent, loader)
    raise MissingVendorError(tried[0], f"no {' or '.join(tried)} in {folder}", HELP)
