# SPDX-License-Identifier: Apache-2.0
"""Where ROS packages ship profiles: ``share/PACKAGE/keymint/comarmor.d`` in the prefix where a package is installed."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from comarmor.errors import ComArmorError, Origin
from comarmor.text import did_you_mean, quantity, quote
from comarmor.values import Data, field
from comarmor.xml.sandboxed_paths import FOLLOW_LINKS, PACKAGE, SandboxedFolder, file_errors, is_package_name, path_text

SEARCH_PATH = "AMENT_PREFIX_PATH"
"""The environment variable that lists the prefixes, the first one first (ament_index, of ROS 2)."""
_INDEX = "share/ament_index/resource_index/packages"
_KEYMINT, _PROFILES = "keymint", "comarmor.d"


class ShippedFile(Data):
    """A file of a package that a policy includes.

    Attributes:
        package: name of the package.
        path: path below the package's folder of profiles.
        content: its bytes.
        where: the place that includes it first.
    """

    package: str
    path: str
    content: bytes = field(repr=False)
    where: Origin

    @property
    def sha256(self) -> str:
        """SHA-256 of its bytes, in hex."""
        return hashlib.sha256(self.content).hexdigest()


class CopiedPackages(Data):
    """Copies of files that packages ship.

    Attributes:
        root: the folder with a folder for each package.
        absent_is_empty: a file without a copy counts as empty; else it is missing.
    """

    root: Path
    absent_is_empty: bool = False

    def folder(self, package: str, where: Origin) -> SandboxedFolder:  # noqa: ARG002 - see InstalledPackages
        """Return the folder of the copies of a package."""
        place = self.root / package
        real, shown = place.resolve(), f"{PACKAGE}{package}"
        return SandboxedFolder(real, shown, package, place, absent_is_empty=self.absent_is_empty)

    def looked_at(self, package: str) -> tuple[Path, ...]:  # noqa: ARG002 - see InstalledPackages
        """Return nothing: copies are where they are."""
        return ()


class InstalledPackages(Data):
    """The installed packages, found as ament_index finds them: the first prefix that has a package wins.

    A prefix has a package that is registered in its index, or for which it has a folder ``share/PACKAGE/keymint``.
    Empty entries of the list and prefixes that do not exist are skipped, as ament_index does; a relative prefix is an
    error.

    Attributes:
        environment: environment variables, of which :data:`SEARCH_PATH` is read.
        trusted: packages whose symbolic links are followed out of their folder; None for all.
    """

    environment: Mapping[str, str] = field(repr=False, compare=False)
    trusted: frozenset[str] | None = frozenset()

    @property
    def prefixes(self) -> tuple[str, ...]:
        """The prefixes, without empty entries and repetitions."""
        return tuple(dict.fromkeys(filter(None, self.environment.get(SEARCH_PATH, "").split(os.pathsep))))

    def folder(self, package: str, where: Origin) -> SandboxedFolder:
        """Return the folder of the profiles that a package ships.

        Args:
            package: a legal name of a package.
            where: the place that includes a file of it.

        Raises:
            ComArmorError: there is no such package, or it ships no profiles, or its folder cannot be used.
        """
        prefix = self._prefix(package, where)
        place = Path(prefix, "share", package, _KEYMINT, _PROFILES)
        shown = f"'{path_text(str(place))}'"
        with file_errors(shown, where):
            expected, real = Path(prefix).resolve() / "share" / package, place.resolve()
            is_folder = real.is_dir()
        follows = self.trusted is None or package in self.trusted
        if not follows and not real.is_relative_to(expected):
            message = f"a symbolic link leads out of the package {quote(package)}, at or above {shown}"
            raise ComArmorError(message, where=where, help=FOLLOW_LINKS, code="include-outside")
        if not is_folder:
            later = self.prefixes[self.prefixes.index(prefix) + 1 :]
            other = next((each for each in later if package in _names(each)), "")
            hides = f"'{path_text(other)}' has some, but '{path_text(prefix)}' comes first in {SEARCH_PATH}"
            message = f"the package {quote(package)} ships no profiles: there is no folder {shown}"
            help_ = hides if other else "'keymint plugins' lists the packages that do"
            raise ComArmorError(message, where=where, help=help_, code="package-without-profiles")
        return SandboxedFolder(real, f"{PACKAGE}{package}", package, place, trusts_links=follows)

    def looked_at(self, package: str) -> tuple[Path, ...]:
        """Return the paths that tell where a package is; while none of them changes, neither does the answer."""
        paths: list[Path] = []
        for prefix in self.prefixes:
            paths += (path for _, path in _marks(prefix, package))
            if _found_in(prefix, package):
                break
        return tuple(paths)

    def shipping(self) -> Iterator[tuple[str, Path, tuple[str, ...] | None, str]]:
        """Yield the packages that ship profiles, by name; one that another prefix hides comes after that one.

        Yields:
            The name, the folder of the profiles, and the paths of the ``*.xml`` files below that folder, sorted, or
            None if they cannot be listed. Then the prefix of the package of this name that is found first, or an empty
            text if this one is.
        """
        by_prefix = {prefix: frozenset(_names(prefix)) for prefix in self.prefixes}
        for name in sorted(frozenset().union(*by_prefix.values())):
            having = [each for each in self.prefixes if each.startswith("/") and _found_in(each, name)]
            for prefix in (each for each in having if name in by_prefix[each]):
                folder = Path(prefix, "share", name, _KEYMINT, _PROFILES)
                yield name, folder, _files(folder), "" if prefix == having[0] else having[0]

    def _prefix(self, package: str, where: Origin) -> str:
        for prefix in self.prefixes:
            if not prefix.startswith("/"):
                message = f"{SEARCH_PATH} has the relative path {quote(prefix, 200)}, expected absolute ones only"
                help_ = "what a package ships must not depend on the current folder; the setup files of ROS 2 comply"
                raise ComArmorError(message, where=where, help=help_, code="package-prefix")
            for kind, mark in _marks(prefix, package):
                # That it cannot be told must not mean that a later prefix is taken.
                with file_errors(f"'{path_text(str(mark))}'", where):
                    if _is(kind, mark):
                        return prefix
        known = sorted({name for prefix in self.prefixes for name in _names(prefix)})
        prefixes = quantity(len(self.prefixes), "prefix")
        advice = f"source the setup file of the workspace that has it; {SEARCH_PATH} lists {prefixes}"
        if not self.prefixes:
            advice = f"{SEARCH_PATH} is not set: source the setup file of your ROS 2 workspace"
        message = f"the package {quote(package)} is not installed"
        raise ComArmorError(message, where=where, help=did_you_mean(package, known, advice), code="package-unknown")


PackageFolders = CopiedPackages | InstalledPackages
"""What finds the folder of the profiles that a package ships."""


def _marks(prefix: str, package: str) -> Iterator[tuple[Callable[[int], bool], Path]]:
    """Yield the kinds and paths of which one exists if a prefix has a package: a file of the index, and a folder."""
    yield stat.S_ISREG, Path(prefix, _INDEX, package)
    yield stat.S_ISDIR, Path(prefix, "share", package, _KEYMINT)


def _is(kind: Callable[[int], bool], path: Path) -> bool:
    try:
        return kind(os.stat(path).st_mode)  # noqa: PTH116 - all but a missing file is an error, not an answer
    except (FileNotFoundError, NotADirectoryError):
        return False


def _found_in(prefix: str, package: str) -> bool:
    """Tell whether a prefix has a package, as far as that can be told."""
    try:
        return any(_is(kind, mark) for kind, mark in _marks(prefix, package))
    except OSError:
        return True


def _names(prefix: str) -> Iterator[str]:
    """Yield the names of the packages of a prefix that have a folder for Keymint."""
    if not prefix.startswith("/"):
        return
    try:
        with os.scandir(Path(prefix, "share")) as entries:
            names = [entry.name for entry in entries if is_package_name(entry.name)]
    except OSError:
        return
    for name in names:
        with contextlib.suppress(OSError):
            if _is(stat.S_ISDIR, Path(prefix, "share", name, _KEYMINT, _PROFILES)):
                yield name


def _files(folder: Path) -> tuple[str, ...] | None:
    found: list[str] = []

    def refuse(error: OSError) -> None:
        raise error

    try:
        for inner, _, names in os.walk(folder, onerror=refuse):
            found += (os.path.relpath(Path(inner, name), folder) for name in names if name.endswith(".xml"))
    except OSError:
        return None
    return tuple(sorted(found))
