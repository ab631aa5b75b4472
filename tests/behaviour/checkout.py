# SPDX-License-Identifier: Apache-2.0
"""A checkout of the project whose command line is run; any commit that has ``keymint.cli.main``."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NOW = 1_800_000_000
"""2027-01-15T08:00:00Z, the clock of all commands unless a step says otherwise."""
_RUNNER = Path(__file__).with_name("runner.py")


@dataclass(frozen=True)
class Result:
    """What a command did, as it is."""

    code: int
    out: str
    err: str


class Checkout:
    """A process that runs commands of a checkout.

    Args:
        root: the checkout.
        scratch: a folder for what the process needs.
    """

    def __init__(self, root: Path, scratch: Path) -> None:
        self.root = root
        self.metadata = scratch / "metadata"
        _write_metadata(root, self.metadata)
        path = os.pathsep.join(str(each) for each in (self.metadata, root, root / "plugins"))
        self._base = {
            "PATH": os.environ.get("PATH", os.defpath), "PYTHONPATH": path, "LANG": "C.UTF-8", "TERM": "dumb",
            "COLUMNS": "300", "PYTHONDONTWRITEBYTECODE": "1", "TZ": "UTC",
        }  # fmt: skip
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(_RUNNER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={**self._base, "PYTHONHASHSEED": "0"}, cwd=scratch,
        )  # fmt: skip
        for words in (("init", str(scratch / "warm"), "--json"), ("lint", "-w", str(scratch / "warm"), "--json"),
                      ("provision", str(scratch / "none.xml"), "-w", str(scratch / "warm"))):  # fmt: skip
            self.run(words, scratch, warm=True)

    def run(
        self, argv: Sequence[str], cwd: Path, env: Mapping[str, str] | None = None, stdin: str = "", *,
        now: int = NOW, warm: bool = False,
    ) -> Result:  # fmt: skip
        """Run a command in a folder, whose ``home`` is the home directory."""
        own = {"HOME": str(cwd / "home"), "XDG_CACHE_HOME": str(cwd / "home/.cache"), "SOURCE_DATE_EPOCH": str(now)}
        request: dict[str, Any] = {"argv": list(argv), "cwd": str(cwd), "stdin": stdin, "warm": warm}
        request["env"] = {**self._base, **own, **(env or {})}
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the runner of {self.root} ended before {argv}")
        return Result(**json.loads(answer))

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def _write_metadata(root: Path, folder: Path) -> None:
    """Write the metadata of an installed distribution, so that the plugins are those of this checkout."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    version = re.search(r'^__version__ = "(.+)"', (root / "keymint/__init__.py").read_text(), re.MULTILINE)
    place = folder / "keymint_tools-0.dist-info"
    place.mkdir(parents=True)
    (place / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {version[1] if version else 0}\n\n"
    )
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {target}" for name, target in entries.items()), ""]
    (place / "entry_points.txt").write_text("\n".join(lines))
