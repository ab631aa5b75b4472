"""The two vendors: whether they are here, and their probes, small programs that hold a secure participant each.

A probe is built from its source in this folder, against the vendor's packages, once for each state of source,
compiler and library. :mod:`participants` starts it and talks to it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from . import cyclone_access_control

INSTALL = "run .ci/setup-vendors.sh"
_SOURCES = Path(__file__).parent


class MissingVendorError(Exception):
    """A vendor is not on this machine; says what is missing and how to install it."""


@dataclass(frozen=True, slots=True)
class Probe:
    """How to build a vendor's probe.

    Attributes:
        vendor: the vendor's name, for people.
        source: file name of the program.
        compilers: compilers that do, best first.
        header: a header of the vendor without which it cannot be built.
        arguments: arguments of the compiler beside source and output.
    """

    vendor: str
    source: str
    compilers: tuple[str, ...]
    header: str
    arguments: tuple[str, ...]

    def build(self, cache: Path) -> Path:
        """Return the program, built in the cache unless it is there.

        Raises:
            MissingVendorError: compiler, headers or library are not installed.
        """
        compiler = next(filter(None, map(shutil.which, self.compilers)), None)
        if compiler is None:
            raise MissingVendorError(f"{self.vendor}: no compiler {' or '.join(self.compilers)}; {INSTALL}")
        looked_for = subprocess.run(
            [compiler, *self.arguments[:1], "-E", "-include", self.header, "-x", self._language, os.devnull],
            capture_output=True,
            check=False,
        )
        if looked_for.returncode:
            raise MissingVendorError(f"{self.vendor}: no header {self.header}; {INSTALL}")
        source = _SOURCES / self.source
        state = hashlib.sha256(source.read_bytes() + looked_for.stdout + repr(self).encode())
        program = cache / f"{source.stem}-{state.hexdigest()[:16]}"
        if not program.exists():
            with tempfile.TemporaryDirectory(dir=cache) as scratch:
                output = Path(scratch) / program.name
                command = [compiler, *self.arguments[:1], "-O1", "-o", str(output), str(source)]
                subprocess.run([*command, *self.arguments[1:]], check=True)
                output.replace(program)
        return program

    @property
    def _language(self) -> str:
        return "c" if self.source.endswith(".c") else "c++"


CYCLONEDDS = Probe("Cyclone DDS", "cyclonedds_probe.c", ("gcc", "cc"), "dds/dds.h", ("-std=gnu11", "-lddsc"))
FASTDDS = Probe(
    "Fast DDS",
    "fastdds_probe.cpp",
    ("g++", "c++"),
    "fastdds/dds/domain/DomainParticipant.hpp",
    ("-std=c++17", "-lfastrtps", "-lfastcdr"),
)


def require_cyclone_plugins() -> None:
    """Check that the security plugins of Cyclone DDS load.

    Raises:
        MissingVendorError: they do not.
    """
    try:
        cyclone_access_control.library()
    except OSError as error:
        raise MissingVendorError(f"Cyclone DDS: {error}; {INSTALL}") from None
