# SPDX-License-Identifier: Apache-2.0
"""Hostile conditions of a run: its environment, streams and clock, and the names of files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

EXIT_CODES = frozenset({0, 1, 2, 3})
"""The exit codes of runs that no signal ends."""
NASTY = "a\x1b]0;owned\x07\n\x9b31m\u202e\udcff b"
"""A name that attacks a terminal: escape sequence, bell, line end, C1 control, bidi override, and invalid UTF-8."""
VERBS: Mapping[str, Sequence[str]] = {
    "init": ("new_ws",),
    "create": ("--all", "-w", "ws"),
    "build": ("-w", "ws"),
    "install": ("-w", "ws", "--no-prove"),
    "check": ("-w", "ws", "--within", "400d"),
    "prove": ("-w", "ws"),
    "status": ("-w", "ws"),
    "verify": ("-w", "ws", "-i", "omg"),
    "why": ("-w", "ws", "/a", "ros_publish", "/x", "-i", "omg"),
    "lint": ("policy.xml",),
    "diff": ("policy.xml", "other.xml"),
    "query": ("policy.xml", "who", "can", "publish", "/x"),
    "test": ("policy.xml",),
    "provision": ("policy.xml", "-w", "fresh"),
    "discover": ("--from", "graph.json"),
    "learn": ("graph.json",),
    "import": ("foreign.xml", "-o", "imported"),
    "export": ("policy.xml", "--format", "sros2"),
    "graph": ("policy.xml",),
    "plugins": (),
    "transports": (),
    "completion": ("bash",),
}
POLICY = (
    "<profiles><profile name='a'><attachment>/a</attachment><ros_topic qualifier='ALLOW'><attachment>/x</attachment>"
    "<permissions><ros_publish/></permissions></ros_topic></profile></profiles>\n"
)
FOREIGN = (
    "<policy version='0.2.0'><enclaves><enclave path='/a'><profiles><profile ns='/' node='a'><topics publish='ALLOW'>"
    "<topic>x</topic></topics></profile></profiles></enclave></enclaves></policy>\n"
)
"""A policy of another tool."""
GRAPH = {
    "format": "keymint-graph",
    "version": 1,
    "subjects": ["/a"],
    "edges": [{"subject": "/a", "permission": "ros_publish", "object": "/x", "domain": 0}],
    "types": [],
}


@dataclass(frozen=True)
class Surroundings:
    """The unusual conditions of a run.

    Attributes:
        set: environment variables that are set; None takes one away.
        shell: redirections, as a shell writes them; empty for none.
    """

    set: Mapping[str, str | None] = field(default_factory=dict)
    shell: str = ""


STREAMS: Mapping[str, Surroundings] = {
    "stdout closed": Surroundings(shell=">&-"),
    "stderr closed": Surroundings(shell="2>&-"),
    "stdin closed": Surroundings(shell="<&-"),
    "all closed": Surroundings(shell="<&- >&- 2>&-"),
    "stdout full": Surroundings(shell=">/dev/full"),
    "stderr full": Surroundings(shell="2>/dev/full"),
    "both full": Surroundings(shell=">/dev/full 2>&1"),
    "reader gone": Surroundings(shell="| true"),
    "reader of one line": Surroundings(shell="| head -n 1"),
    "stdout read-only": Surroundings(shell="1</dev/null"),
}
LOCALES: Mapping[str, Surroundings] = {
    "C": Surroundings({"LC_ALL": "C", "LANG": "C"}),
    "no coercion": Surroundings({"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}),
    "ascii": Surroundings({"PYTHONIOENCODING": "ascii:strict"}),
    "latin-1": Surroundings({"PYTHONIOENCODING": "latin-1"}),
    "unknown": Surroundings({"LC_ALL": "xx_YY.nosuch", "LANGUAGE": "\x1b"}),
}
VARIABLES: Mapping[str, Surroundings] = {
    "no home": Surroundings({"HOME": None}),
    "home is empty": Surroundings({"HOME": ""}),
    "home is nowhere": Surroundings({"HOME": "/nowhere"}),
    "no path": Surroundings({"PATH": None}),
    "cache is a file": Surroundings({"XDG_CACHE_HOME": "/dev/null"}),
    "cache is relative": Surroundings({"XDG_CACHE_HOME": "cache"}),
    "no temporary folder": Surroundings({"TMPDIR": "/nowhere"}),
    "no columns": Surroundings({"COLUMNS": "0", "LINES": "0"}),
    "odd columns": Surroundings({"COLUMNS": "-3", "TERM": "\x1b[31m"}),
    "no terminal": Surroundings({"TERM": None, "COLORTERM": "\x07"}),
    "no zone": Surroundings({"TZ": "Nowhere/At\x1ball"}),
    "debugging": Surroundings({"PYTHONWARNINGS": "always", "PYTHONDEVMODE": "1"}),
    "optimised": Surroundings({"PYTHONOPTIMIZE": "2"}),
}
EPOCHS = (
    *(
        "-1",
        "0",
        "1",
        "253402300799",
        "253402300800",
        "250246000000",
        "250246108800",
        "99999999999999999999",
        "9" * 400,
    ),
    *(
        "1e9",
        "1.5",
        "0x10",
        " 1800000000",
        "1800000000 ",
        "1_800_000_000",
        "+5",
        "\u0661",
        "now",
        "nan",
        "\x1b[31m",
        "\udcff",
    ),
    *("-62135596800", "2147483648", "4294967296", "222000000000"),
)
"""Values of ``SOURCE_DATE_EPOCH``: the limits of computers and formats, and values that are not numbers."""


def files(folder: Path) -> Path:
    """Create the input of the verbs of :data:`VERBS` in a folder, and return the folder."""
    (folder / "policy.xml").write_text(POLICY)
    (folder / "other.xml").write_text(POLICY.replace("ros_publish", "ros_subscribe"))
    (folder / "foreign.xml").write_text(FOREIGN)
    (folder / "graph.json").write_text(json.dumps(GRAPH))
    words = ("provision", "policy.xml", "-w", "ws", "-q")
    subprocess.run([sys.executable, "-m", "keymint", *words], cwd=folder, check=True)
    assert (folder / "ws/install/enclaves/a/permissions.p7s").is_file()
    return folder


@dataclass(frozen=True)
class Ended:
    """The result of a run."""

    code: int
    out: bytes
    err: bytes


def run(arguments: Sequence[str], cwd: Path, around: Surroundings) -> Ended:
    """Run the command line in its own process; the exit code is Keymint's, even in a pipe."""
    variables: dict[str, str] = {**os.environ, "KEYMINT_TRACEBACK": ""}
    for name, value in around.set.items():
        variables.pop(name, None)
        if value is not None:
            variables[name] = value
    bash = shutil.which("bash") or "/bin/bash"
    script = f'"$0" -m keymint "$@" {around.shell}; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(
        [bash, "-c", script, sys.executable, *arguments],
        cwd=cwd,
        env=variables,
        capture_output=True,
        timeout=120,
        check=False,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def require_orderly(
    arguments: Sequence[str], code: int, out: str, err: str, codes: frozenset[int] = EXIT_CODES
) -> None:
    """Check any run: a documented exit code, printable text, and one valid JSON document if requested."""
    assert code in codes, (arguments, code, out, err)
    for text in (out, err):
        assert "Traceback" not in text, text
        assert "internal error" not in text, text
        assert "Exception ignored" not in text, text
        # A policy, a graph or a picture goes into a pipe as it is; XML has no other controls.
        document = text is out and arguments[0] in {"learn", "discover", "graph", "export"}
        assert all(char.isprintable() or char in "\n\t" or (document and char >= "\x7f") for char in text), repr(text)
    if "--json" in arguments and out:
        document = json.loads(out)
        assert document["exit_code"] == code
        json.dumps(document, ensure_ascii=False).encode()  # holds no lone surrogate
    for line in err.splitlines():
        assert line.strip(), repr(err)
