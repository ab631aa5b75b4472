"""The rules of the architecture that import-linter cannot hold: who writes, who reads the clock, what is slow."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parent.parent
SOURCES = sorted(path for room in ("comarmor", "keymint", "plugins") for path in (CHECKOUT / room).rglob("*.py"))

WRITING = {
    *(f"os.{name}" for name in ("chmod", "fchmod", "link", "makedirs", "mkdir", "mkfifo", "mknod", "remove")),
    *(
        f"os.{name}"
        for name in ("removedirs", "rename", "renames", "replace", "rmdir", "symlink", "truncate", "unlink")
    ),
    *("shutil.", "tempfile.", "sqlite3.", "subprocess.", "os.system", "os.popen"),
    *(f".{name}" for name in ("write_text", "write_bytes", "touch", "mkdir", "symlink_to", "hardlink_to", "chmod")),
    *(f".{name}" for name in ("unlink", "rmdir", "rename")),
}
"""Functions that change the file system, whatever their arguments."""

READS_ONLY = {"os.O_RDONLY", "os.O_DIRECTORY", "os.O_NOFOLLOW", "os.O_CLOEXEC", "os.O_NONBLOCK", "os.O_PATH"}

FOREIGN = "plugins/keymint_ros2_dds/vendors/"
"""The one room that builds, starts and times foreign programs; it writes into the cache folder alone."""

SURROUNDINGS = {
    *("os.environ", "os.environb", "os.getenv", "os.umask", "os.getcwd", "os.cpu_count", "os.times", "os.getlogin"),
    *("time.", "datetime.datetime.now", "datetime.datetime.utcnow", "datetime.datetime.today", "datetime.date.today"),
    *(
        "pathlib.Path.cwd",
        "pathlib.Path.home",
        ".expanduser",
        "os.path.expanduser",
        "os.path.expandvars",
        "platform.",
        "socket.",
        "locale.",
    ),
}
"""What depends on where and when the program runs."""


class Uses(ast.NodeVisitor):
    """Collects what a module names, by the full name of the module it comes from: ``os.environ``.

    An attribute of something that is not a module is known by its own name: ``.write_text``.
    """

    def __init__(self) -> None:
        self.names: list[tuple[int, str]] = []
        self.calls: list[tuple[int, str, ast.Call]] = []
        self._known: dict[str, str] = {}

    @classmethod
    def of(cls, source: str) -> Uses:
        found = cls()
        found.visit(ast.parse(source))
        return found

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            bound = alias.asname or alias.name.partition(".")[0]
            self._known[bound] = alias.name if alias.asname else bound
            self.names.append((node.lineno, alias.name))

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        for alias in node.names:
            self._known[alias.asname or alias.name] = f"{node.module}.{alias.name}"
            self.names.append((node.lineno, f"{node.module}.{alias.name}"))

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.names.append((node.lineno, self._name(node)))
        self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        if node.id in self._known:
            self.names.append((node.lineno, self._known[node.id]))

    def visit_Call(self, node: ast.Call) -> None:
        self.calls.append((node.lineno, self._name(node.func), node))
        self.generic_visit(node)

    def _name(self, node: ast.expr) -> str:
        if isinstance(node, ast.Name):
            return self._known.get(node.id, node.id)
        if isinstance(node, ast.Attribute):
            within = self._name(node.value)
            return f"{within}.{node.attr}" if within.partition(".")[0] in self._modules() else f".{node.attr}"
        return ""

    def _modules(self) -> set[str]:
        return {name.partition(".")[0] for name in self._known.values()}


def among(name: str, listed: set[str]) -> bool:
    """Tell whether a name is listed, or lies in a module that is (``time.``)."""
    last = f".{name.rpartition('.')[2]}"
    return name in listed or last in listed or f"{name.partition('.')[0]}." in listed


def writes(source: str) -> list[int]:
    """Return the lines that open a file for writing or change a folder."""
    found = Uses.of(source)
    lines = [line for line, name in found.names if among(name, WRITING)]
    for line, name, call in found.calls:
        if name == "os.open":
            lines += [line] * _opens_to_write(call)
        elif name in {"open", "io.open", "os.fdopen", "codecs.open", "gzip.open"} or name.endswith(".open"):
            # The mode is the second argument of the functions, and the first of a path's method.
            lines += [line] * _has_writing_mode(call, position=0 if name == ".open" else 1)
    return sorted(set(lines))


def _opens_to_write(call: ast.Call) -> bool:
    if isinstance(call.args[0], ast.Attribute) and call.args[0].attr == "devnull":
        return False
    flags = {ast.unparse(node) for node in ast.walk(call.args[1]) if isinstance(node, ast.Attribute)}
    return not flags or not flags <= READS_ONLY


def _has_writing_mode(call: ast.Call, position: int) -> bool:
    named = [keyword.value for keyword in call.keywords if keyword.arg == "mode"]
    given = call.args[position : position + 1]
    if position == 0:  # what is not a path may be opened with anything
        given = [mode for mode in given if isinstance(mode, ast.Constant)]
    return any(not isinstance(mode, ast.Constant) or set(str(mode.value)) & set("wax+") for mode in named or given)


def surroundings(source: str) -> list[int]:
    """Return the lines that read the clock, the environment, or what else depends on where the program runs."""
    return sorted({line for line, name in Uses.of(source).names if among(name, SURROUNDINGS)})


def entry_points(source: str) -> list[int]:
    """Return the lines that ask for what is installed."""
    return sorted({line for line, name in Uses.of(source).names if name.startswith("importlib.metadata")})


def places(finder: object, but: set[str]) -> Iterator[str]:
    for path in SOURCES:
        name = path.relative_to(CHECKOUT).as_posix()
        if name not in but and not name.startswith(FOREIGN):
            yield from (f"{name}:{line}" for line in finder(path.read_text(encoding="utf-8")))  # type: ignore[operator]


def test_there_is_something_to_look_at() -> None:
    names = {path.relative_to(CHECKOUT).as_posix() for path in SOURCES}
    assert {
        "keymint/store.py",
        "keymint/cli.py",
        "comarmor/language/source.py",
        "plugins/keymint_ros2_dds/build.py",
    } <= names


def test_only_the_store_writes() -> None:
    # Trees of a revision are extracted into a temporary folder, which goes when they were read; so are the copies of
    # enclaves that transports read.
    store = {f"keymint/{name}.py" for name in ("store", "staging", "exchange", "writing")}
    assert list(places(writes, {*store, "keymint/git.py", "keymint/verify/copies.py"})) == []
    assert writes((CHECKOUT / "keymint/store.py").read_text())


def test_what_readers_look_at_comes_from_their_snapshot() -> None:
    # The policy and its library are read by themselves; git reads the disk; copies follow links.
    asks = {f".{name}" for name in ("lstat", "is_file", "is_dir", "is_symlink", "iterdir", "rglob", "read_bytes")}
    asks |= {"os.stat", "os.lstat", "os.listdir", "os.scandir", "os.walk", "os.path.exists", "os.path.lexists"}
    readers = ("keymint/check/", "keymint/plan/", "keymint/verify/", "keymint/status.py")
    known = {"plan/create.py", "plan/ignored.py", "check/exposed.py", "verify/copies.py"}

    def asked(source: str) -> list[int]:
        return [line for line, name in Uses.of(source).names if among(name, asks)]

    found = [place for place in places(asked, {f"keymint/{name}" for name in known}) if place.startswith(readers)]
    assert found == []
    assert asked((CHECKOUT / "keymint/tree.py").read_text())


def test_only_the_command_line_looks_around() -> None:
    assert list(places(surroundings, {"keymint/cli.py"})) == []
    assert surroundings((CHECKOUT / "keymint/cli.py").read_text())


def test_only_plugins_asks_what_is_installed() -> None:
    assert list(places(entry_points, {"keymint/plugins.py"})) == []
    assert entry_points((CHECKOUT / "keymint/plugins.py").read_text())


@pytest.mark.parametrize(
    "source",
    [
        "open('f', 'w')",
        "open('f', mode='ab')",
        "open('f', mode)",
        "path.open('x')",
        "path.open(mode='r+')",
        "path.open(mode=mode)",
        "path.write_text('')",
        "(folder / name).write_bytes(b'')",
        "path.mkdir(parents=True)",
        "import os\nos.open('f', os.O_WRONLY | os.O_CREAT)",
        "import os\nos.open('f', flags)",
        "import os\nos.fdopen(1, 'wb')",
        "import os as system\nsystem.replace('a', 'b')",
        "from os import rename\nrename('a', 'b')",
        "from shutil import copytree",
        "import tempfile",
    ],
)
def test_writing_is_seen(source: str) -> None:
    assert len(source.splitlines()) in writes(source)


@pytest.mark.parametrize(
    "source",
    [
        "open('f')",
        "open('f', 'rb')",
        "path.open()",
        "plugin.open(surroundings)",
        "path.read_text()",
        "'a'.replace('a', 'b')",
        "import dataclasses\ndataclasses.replace(a, b=1)",
        "import os\nos.open('f', os.O_RDONLY | os.O_CLOEXEC)",
        "import os\nos.fdopen(1, 'rb')",
        "import os\nos.open(os.devnull, os.O_WRONLY)",
        "stream.write('')",
    ],
)
def test_reading_is_not_writing(source: str) -> None:
    assert writes(source) == []


@pytest.mark.parametrize(
    "source",
    [
        "import os\nos.environ['A']",
        "import os\nos.getenv('A')",
        "from os import environ as env\nenv.get('A')",
        "import os\nos.umask(0)",
        "import time",
        "from time import time",
        "from datetime import datetime\ndatetime.now()",
        "import datetime\ndatetime.datetime.utcnow()",
        "from datetime import date\ndate.today()",
        "from pathlib import Path\nPath.cwd()",
        "Path('~').expanduser()",
    ],
)
def test_looking_around_is_seen(source: str) -> None:
    assert len(source.splitlines()) in surroundings(source)


@pytest.mark.parametrize("source", ["from datetime import datetime\ndatetime(2030, 1, 1)", "run.setting.now", "a.time"])
def test_what_was_handed_down_is_not_looking_around(source: str) -> None:
    assert surroundings(source) == []


# -- speed --------------------------------------------------------------------------------------------------------

SLOW = {
    "lxml",
    "cryptography",
    "rich",
    "jinja2",
    "xmlschema",
    "networkx",
    "isodate",
    "comarmor.language",
    "importlib.metadata",
}


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_imports_nothing_slow(option: str) -> None:
    script = (
        "import sys\n"
        f"sys.argv = ['keymint', {option!r}]\n"
        "from keymint.__main__ import main\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert not end.code, end.code\n"
        "import json\n"
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=CHECKOUT, capture_output=True, text=True, check=True, env=_environment()
    )
    assert "keymint" in done.stdout
    assert set(json.loads(done.stderr)) & SLOW == set()


def _environment() -> Mapping[str, str]:
    return {"PYTHONPATH": str(CHECKOUT), "PATH": "/usr/bin:/bin"}


# -- the project's files ------------------------------------------------------------------------------------------

SOMEONES_MACHINE = re.compile(r"(?<![\w.*})/])/(?:root|work|(?:home|Users)/(?!me\b)\w+|opt/\w+venv)(?:/|\b)")
"""Folders that only the machine has on which something was written."""


def project_files() -> list[Path]:
    """Return the files that are, or are about to be, under version control."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=CHECKOUT,
        capture_output=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("this is not a checkout of git")
    return [path for name in listed.stdout.decode().split("\0") if name and (path := CHECKOUT / name).is_file()]


def test_no_file_names_a_place_of_somebodys_machine() -> None:
    found = [
        f"{path.relative_to(CHECKOUT)}:{number}: {line.strip()}"
        for path in project_files()
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1)
        if SOMEONES_MACHINE.search(line)
    ]
    assert found == []


def test_a_place_of_somebodys_machine_is_seen() -> None:
    for top in ("home", "Users", "root", "work"):
        assert SOMEONES_MACHINE.search(f"see /{top}/someone/notes.md")
    for name in (
        "my_ws/work/x",
        "/home/me/ws",
        "/workspace/x",
        "../shared/reference",
        "/opt/ros/jazzy/lib",
        "https://host/work/x",
    ):
        assert not SOMEONES_MACHINE.search(name)
