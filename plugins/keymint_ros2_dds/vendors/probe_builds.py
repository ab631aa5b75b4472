# SPDX-License-Identifier: Apache-2.0
"""Detect the vendors, and build their probes: small programs with one secure participant each.

A probe is built from its source in this folder, against the vendor's packages, once for each version of source,
compiler and library. :mod:`participants` starts it and talks to it. It lies in this user's cache if nobody else can
write there, else in a folder of this run: a program from the cache runs with the rights of the user, so only a safe
place is trusted.

``make vendors-new`` unpacks newer versions of vendors into the cache, each with its libraries and loader. Nothing of
them is installed. A program that is built for one is started by its loader, because the machine's may be too old for
its libraries.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from comarmor.values import Data, replace
from keymint.host.vendor_process import MissingVendorError
from keymint_ros2_dds.vendors import cyclone_access_control


def place(cache: Path, name: str) -> Path:
    """Return the path of a program: in the cache, or in a private folder of this run.

    It is in the cache, which is created if it is missing, if only this user can write that, and no file there with its
    name is one that is not trusted.

    Args:
        cache: a folder for programs.
        name: the program's.
    """
    program = cache / name
    with suppress(OSError):
        cache.mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_ours_alone(cache) and (is_ours(program) or not os.path.lexists(program)):
            return program
    return Path(_of_this_run().name) / name


def is_ours_alone(path: Path) -> bool:
    """Tell whether a folder is this user's, has mode 0700, is not a link, and cannot be replaced by others.

    Only root and this user may own or write its parent folders; in one with the sticky bit, like ``/tmp``, others can
    write, but cannot rename our files.
    """
    try:
        own = path.lstat()
        ours = stat.S_ISDIR(own.st_mode) and stat.S_IMODE(own.st_mode) == stat.S_IRWXU and own.st_uid == os.geteuid()
        # The parent folders and links of the path as given and as resolved; links are not to be followed.
        ways = Path(os.path.abspath(path)), path.resolve()  # noqa: PTH100
        return ours and all(_is_safe(above.lstat()) for way in ways for above in way.parents)
    except OSError:
        return False


def is_ours(program: Path) -> bool:
    """Tell whether a program is a regular file of this user, without hard links, that nobody else can write."""
    try:
        found = program.lstat()
    except OSError:
        return False
    return (
        stat.S_ISREG(found.st_mode)
        and found.st_uid == os.geteuid()
        and found.st_nlink == 1
        and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )


def _is_safe(found: os.stat_result) -> bool:
    if found.st_uid not in {0, os.geteuid()}:
        return False
    writable = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISLNK(found.st_mode) or not writable or bool(found.st_mode & stat.S_ISVTX)


@functools.cache
def _of_this_run() -> tempfile.TemporaryDirectory[str]:
    """Return a folder with mode 0700 that exists as long as the process."""
    return tempfile.TemporaryDirectory(prefix="keymint-")


_SOURCES = Path(__file__).parent
HELP = "'make vendors-new' in a checkout of Keymint unpacks it from Debian"


def _missing(vendor: str, reason: str, packages: Sequence[str]) -> MissingVendorError:
    return MissingVendorError(vendor, reason, f"apt-get install {' '.join(packages)}")


class Probe(Data):
    """How to build a vendor's probe.

    Attributes:
        vendor: the vendor's name, for people.
        source: file name of the program.
        compilers: compilers that do, best first.
        header: a header of the vendor without which it cannot be built.
        arguments: arguments of the compiler beside source and output.
        packages: Debian packages that it is built from.
        folders: arguments of the compiler that name folders of headers and libraries, if they are not the machine's.
    """

    vendor: str
    source: str
    compilers: tuple[str, ...]
    header: str
    arguments: tuple[str, ...]
    packages: tuple[str, ...]
    folders: tuple[str, ...] = ()

    def compiler(self, environment: Mapping[str, str]) -> str:
        """Return the path of the compiler.

        Raises:
            MissingVendorError: it is not installed.
        """
        path = environment.get("PATH", os.defpath)
        compiler = next(filter(None, (shutil.which(name, path=path) for name in self.compilers)), None)
        if compiler is None:
            reason = f"no compiler {' or '.join(self.compilers)}"
            raise _missing(self.vendor, reason, tuple(dict.fromkeys((self.compilers[0], *self.packages))))
        return compiler

    def require(self, environment: Mapping[str, str]) -> tuple[str, bytes]:
        """Return the compiler, and the preprocessed header.

        Raises:
            MissingVendorError: compiler or headers are not installed.
        """
        compiler = self.compiler(environment)
        preprocessing = self._preprocess(compiler, self.header, environment)
        if preprocessing.returncode:
            raise _missing(self.vendor, f"no header {self.header}", self.packages)
        return compiler, preprocessing.stdout

    def build(self, cache: Path, environment: Mapping[str, str]) -> Path:
        """Return the program; build it if it is not in the cache.

        Args:
            cache: a folder for programs; created if missing, and not used if others can write to it.
            environment: environment variables; the compiler is looked for on its ``PATH``.

        Raises:
            MissingVendorError: compiler, headers or library are not installed.
        """
        compiler, included = self.require(environment)
        source = _SOURCES / self.source
        state = hashlib.sha256(source.read_bytes() + included + repr(self).encode())
        program = place(cache, f"{source.stem}-{state.hexdigest()[:16]}")
        if not is_ours(program):
            with tempfile.TemporaryDirectory(dir=program.parent) as scratch:
                output = Path(scratch) / program.name
                command = [compiler, *self.arguments[:1], *self.folders, "-O1", "-o", str(output), str(source)]
                compilation = _run([*command, *self.arguments[1:]], environment)
                if compilation.returncode:
                    errors = compilation.stderr.decode(errors="replace").strip().splitlines()
                    reason = f"{self.source} cannot be built: {errors[-1] if errors else 'no message'}"
                    raise _missing(self.vendor, reason, self.packages)
                output.chmod(0o700)
                output.replace(program)
        return program

    def version(self, header: str, macro: str, environment: Mapping[str, str]) -> str:
        """Return the value of the macro of the vendor's version, or an empty text; errors as of :meth:`require`."""
        compiler, _ = self.require(environment)
        output = self._preprocess(compiler, header, environment, "-dM").stdout.decode(errors="replace")
        lines = (line.split(maxsplit=2) for line in output.splitlines())
        return next((words[2].strip('"') for words in lines if words[1:2] == [macro] and len(words) == 3), "")  # noqa: PLR2004

    def _preprocess(
        self, compiler: str, header: str, environment: Mapping[str, str], *options: str
    ) -> subprocess.CompletedProcess[bytes]:
        language = "c" if self.source.endswith(".c") else "c++"
        reading = ("-E", *options, "-include", header, "-x", language, os.devnull)
        return _run_once((compiler, *self.arguments[:1], *self.folders, *reading), environment.get("PATH", os.defpath))


@functools.cache
def _run_once(command: tuple[str, ...], path: str) -> subprocess.CompletedProcess[bytes]:
    """Run a preprocessor once in this process: several transports ask for the same megabytes of headers."""
    return _run(command, {"PATH": path})


def _run(command: Sequence[str], environment: Mapping[str, str]) -> subprocess.CompletedProcess[bytes]:
    path = environment.get("PATH", os.defpath)
    return subprocess.run(command, capture_output=True, check=False, env={"PATH": path})  # noqa: S603 - no shell


CYCLONE_PACKAGES = ("libddsc0debian", "cyclonedds-dev", "gcc")
CYCLONEDDS = Probe(
    "Cyclone DDS", "cyclonedds_probe.c", ("gcc", "cc"), "dds/dds.h", ("-std=gnu11", "-lddsc"), CYCLONE_PACKAGES
)
_LIBRARY = ("-std=gnu11", "-shared", "-fPIC")
CYCLONEDDS_NONCONFORMING = replace(
    CYCLONEDDS, source="cyclonedds_nonconforming.c", header="dds/security/dds_security_api.h", arguments=_LIBRARY
)
"""An access-control plugin that lets its own participant do everything; peers see its true permissions."""
FAST_PACKAGES = ("libfastrtps-dev", "libfastcdr-dev", "g++")
FASTDDS = Probe(
    "Fast DDS",
    "fastdds_probe.cpp",
    ("g++", "c++"),
    "fastdds/dds/domain/DomainParticipant.hpp",
    ("-std=c++17", "-lfastrtps", "-lfastcdr"),
    FAST_PACKAGES,
)
FASTDDS_3 = replace(FASTDDS, arguments=("-std=c++17", "-lfastdds", "-lfastcdr"), packages=("g++",))
"""The same source; its headers are not the machine's (:class:`Unpacked`)."""
FASTDDS_NONCONFORMING = Probe(
    "Fast DDS", "fastdds_nonconforming.c", ("gcc", "cc"), "stdbool.h", _LIBRARY, FAST_PACKAGES
)
"""A library to preload for the same purpose."""


def require_cyclone_plugins() -> None:
    """Check that the security plugins of Cyclone DDS load.

    Raises:
        MissingVendorError: they do not.
    """
    try:
        cyclone_access_control.library()
    except OSError as error:
        raise _missing("Cyclone DDS", str(error), CYCLONE_PACKAGES[:1]) from None


class Unpacked(Data):
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
    def plugins(self) -> Path:
        """The folder of the security plugins of Cyclone DDS; Fast DDS has none."""
        return self.libraries / "libddsc0debian"

    def built(self, probe: Probe) -> Probe:
        """Return a probe that is built from the headers and libraries of this version; :attr:`loader` starts it.

        The libraries need a newer C library than the linker finds on the machine, so it does not look for that.

        Args:
            probe: how to build it with the machine's headers.
        """
        headers = f"-I{self.headers}", f"-I{self.headers / self.libraries.name}"
        folders = (*headers, f"-L{self.libraries}", "-Wl,--allow-shlib-undefined")
        return replace(probe, folders=folders, packages=(probe.compilers[0],))


def unpacked_version(cache: Path, names: Iterable[str]) -> Unpacked:
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
        if not is_ours_alone(folder):
            reason = f"others may write to {folder} or to a folder above it"
            raise MissingVendorError(name, reason, "take this right from them (chmod)")
        return Unpacked(name.rpartition("-")[2], folder / name / "usr/include", loader.parent, loader)
    raise MissingVendorError(tried[0], f"no {' or '.join(tried)} in {folder}", HELP)
