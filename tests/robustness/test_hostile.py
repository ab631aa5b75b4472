# SPDX-License-Identifier: Apache-2.0
"""No run ends in a traceback, an internal error or an escape sequence, whatever its conditions.

Every verb meets some of the surroundings; with ``KEYMINT_FULL=1`` each meets all of them.
"""

from __future__ import annotations

import io
import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from keymint.host.streams_and_signals import Output
from keymint.output.console import Console, Streams
from tests.conftest import NOW, snapshot
from tests.effort import FULL

from . import hostile
from .hostile import EPOCHS, LOCALES, NASTY, POLICY, STREAMS, VARIABLES, VERBS, require_orderly

READ_NO_FILE = {"plugins", "transports", "completion"}
PROCESSES = {**STREAMS, **LOCALES, **VARIABLES}


def processes() -> Iterator[tuple[str, str, bool]]:
    """Yield verb, conditions, and whether to print JSON: all combinations, or each verb and condition once."""
    if FULL:
        yield from itertools.product(VERBS, PROCESSES, (False, True))
        return
    verbs = itertools.cycle([verb for verb in VERBS if verb not in {"verify", "prove"}])
    for number, (name, verb) in enumerate(zip(PROCESSES, verbs, strict=False)):
        yield verb, name, number % 3 == 0


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that no test changes."""
    folder = tmp_path_factory.mktemp("prepared")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
        return hostile.files(folder)


@pytest.fixture
def place(tmp_path: Path, prepared: Path) -> Path:
    """Return a copy of the folder; a workspace may be copied."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.parametrize(("verb", "name", "as_json"), list(processes()))
def test_streams_locales_and_variables(place: Path, verb: str, name: str, as_json: bool) -> None:
    arguments = (verb, *VERBS[verb], *(["--json"] if as_json else []))
    ended = hostile.run(arguments, place, PROCESSES[name])
    encoding = PROCESSES[name].set.get("PYTHONIOENCODING") or "utf-8"
    out, err = (text.decode(encoding.partition(":")[0], "backslashreplace") for text in (ended.out, ended.err))
    if as_json and name == "reader of one line":
        assert out in {"{\n", ""}
        out = ""
    require_orderly(arguments, ended.code, out, err)
    lost = name in {"stdout closed", "stdout full", "stdout read-only"}
    if lost and verb != "test":
        assert (ended.code, err.count("keymint: error: standard output: ")) == (1, 1), err


@pytest.mark.parametrize("verb", VERBS)
def test_clocks(keymint: Callable, place: Path, verb: str) -> None:
    chosen = EPOCHS if FULL else EPOCHS[list(VERBS).index(verb) :: 10]
    for epoch in chosen:
        for made in ("new_ws", "fresh"):
            shutil.rmtree(place / made, ignore_errors=True)
        before = snapshot(place)
        arguments = (verb, *VERBS[verb], "--json")
        outcome = keymint(*arguments, cwd=place, env={"SOURCE_DATE_EPOCH": epoch})
        require_orderly(arguments, outcome.code, outcome.out, outcome.err)
        if not epoch.isascii() or not epoch.isdigit():
            assert outcome.code == 2
            assert "SOURCE_DATE_EPOCH" in outcome.document["diagnostics"][0]["message"]
            assert snapshot(place) == before


@pytest.mark.parametrize("seconds", [-1.0, -62135596801.0, 222_000_000_000.0, 253402300799.0, 1e15, float("inf")])
@pytest.mark.parametrize("verb", ["init", "check", "status", "provision"])
def test_a_system_clock_that_is_far_off(
    keymint: Callable, place: Path, monkeypatch: pytest.MonkeyPatch, verb: str, seconds: float
) -> None:
    monkeypatch.setattr(time, "time", lambda: seconds)
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    arguments = (verb, *VERBS[verb], "--json")
    outcome = keymint(*arguments, cwd=place)
    require_orderly(arguments, outcome.code, outcome.out, outcome.err)
    assert outcome.code == 2 or seconds == 222_000_000_000.0


OUTPUTS = {
    "graph": ("-o", f"{NASTY}.html", "--title", NASTY),
    "verify": ("--report", f"r{NASTY}", "--sarif", f"{NASTY}.sarif", "--junit", f"{NASTY}.xml"),
    "lint": ("--sarif", f"{NASTY}.sarif"),
    "learn": ("-o", f"{NASTY}.xml"),
    "discover": ("-o", f"{NASTY}.json"),
}


@pytest.mark.parametrize(
    ("verb", "as_json"),
    [
        (verb, as_json)
        for at, verb in enumerate(verb for verb in VERBS if verb not in READ_NO_FILE)
        for as_json in ((False, True) if FULL else (at % 2 == 0,))
    ],
)
def test_names_on_disk(keymint: Callable, place: Path, verb: str, as_json: bool) -> None:
    """Workspaces, files, packages, enclaves and keys may be called anything."""
    work = place / f"work{NASTY}"
    work.mkdir()
    for name in ("policy.xml", "other.xml", "graph.json"):
        (place / name).rename(work / f"{NASTY}{name}")
    (place / "ws").rename(work / "ws")
    for space in ("src", "build", "install/enclaves", "private", "public", "profile"):
        shutil.copytree(work / "ws" / space, work / "ws" / space / NASTY)
        (work / "ws" / space / f"{NASTY}.xml").write_text("<?xml \x1b[31m?>")
    arguments = [
        f"{NASTY}{word}" if word in {"policy.xml", "other.xml", "graph.json"} else word for word in VERBS[verb]
    ]
    for more in ([], ["-v"], *([OUTPUTS[verb]] if verb in OUTPUTS else [])):
        words = (verb, *arguments, *more, *(["--json"] if as_json else []))
        outcome = keymint(*words, cwd=work)
        require_orderly(words, outcome.code, outcome.out, outcome.err)


def test_pruned_names_are_printed_escaped(keymint: Callable, place: Path) -> None:
    enclaves = place / "ws" / "install" / "enclaves"
    shutil.copytree(enclaves / "a", enclaves / "\x1b[31mred\u202e")
    for words in (["status"], ["install", "--prune", "-v"], ["check"]):
        outcome = keymint(*words, "-w", "ws")
        require_orderly(words, outcome.code, outcome.out, outcome.err)


WRITTEN = ("\x1b[31m", "\u009b2J", "\u202e", "\u2028", "\ud800", "&#10;", "&#27;", "\x7f", "\ufffe", "a\tb")
"""Characters in names of a policy or graph; XML cannot contain some of them."""


PLACES = {
    "policy.xml": ("/x", "'a'", ">/a<"),
    "graph.json": ("/x",),
    "ws/profile/keymint_profile.xml": ("jazzy", "keymint_ros2_comarmor"),
    "ws/profile/package.defaults/permissions.xml": ("<id>0", "2028"),
    "ws/profile/authorities.xml": ("identity_ca",),
    "ws/src/a/permissions.xml": ("/x",),
    "ws/install/enclaves/a/permissions.xml": ("rt/x", "CN="),
}
"""For each file that a run reads, the text to replace."""


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb not in READ_NO_FILE])
def test_names_in_files(keymint: Callable, place: Path, verb: str) -> None:
    cases = [(name, old, text) for name, found in PLACES.items() for old in found for text in WRITTEN]
    originals = {name: (place / name).read_text() for name in PLACES}
    for name, old, written in cases if FULL else cases[list(VERBS).index(verb) :: 23]:
        path, text = place / name, originals[name]
        assert old in text, (name, old)
        path.write_bytes(text.replace(old, old[:-1] + written + old[-1]).encode("utf-8", "surrogatepass"))
        for words in ((verb, *VERBS[verb], "-v"), (verb, *VERBS[verb], "--json")):
            for made in ("new_ws", "fresh"):
                shutil.rmtree(place / made, ignore_errors=True)
            outcome = keymint(*words, cwd=place)
            require_orderly(words, outcome.code, outcome.out, outcome.err)
        for each, original in originals.items():  # a verb may have written what follows from the text
            (place / each).write_text(original)


class Terminal(io.StringIO):
    """A stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("written", ["\u009b31m", "\u202e", "\ud800"])
def test_a_document_printed_to_a_terminal_is_escaped(written: str) -> None:
    content = f"<!-- a{written}b -->\n".encode("utf-8", "surrogatepass")
    for stream in (Terminal(), Output(Terminal())):
        Console(Streams(stream, stream)).document(content)
        shown = stream.getvalue() if isinstance(stream, Terminal) else stream._stream.getvalue()
        assert shown.count("\n") == 1
        assert shown.removesuffix("\n").isprintable()


def test_a_document_written_to_a_file_is_not_escaped(tmp_path: Path) -> None:
    content = "<topic>\u009bé</topic>\n".encode()
    with (tmp_path / "file").open("w", encoding="latin-1") as file:
        output = Output(file)
        Console(Streams(output, output)).document(content)
    assert (tmp_path / "file").read_bytes() == content


PASSWORDS = {
    "no UTF-8": ("p\udcff\udc80", 0),
    "UTF-8": ("pässwörd", 0),
    "1,023 bytes": ("x" * 1023, 0),
    "1,024 bytes": ("x" * 1024, 1),
    "more bytes than characters": ("ä" * 512, 1),
    "a megabyte": ("x" * 100_000, 1),
}


@pytest.mark.parametrize(("password", "code"), PASSWORDS.values(), ids=PASSWORDS)
def test_passwords(keymint: Callable, tmp_path: Path, password: str, code: int) -> None:
    keymint("init", "ws")
    shutil.rmtree(tmp_path / "ws/private")
    shutil.rmtree(tmp_path / "ws/public")
    defaults = tmp_path / "ws/profile/profile.defaults/authorities.xml"
    text = defaults.read_text()
    for old, new in (("NoEncryption<", "BestAvailableEncryption<"), ("<password_env>", "<password_env>CA_PASSWORD")):
        assert old in text
        text = text.replace(old, new)
    defaults.write_text(text)
    for words in (("init", "ws"), ("provision", "ws/profile/comarmor.d", "-w", "ws"), ("check", "-w", "ws")):
        outcome = keymint(*words, "--json", env={"CA_PASSWORD": password})
        require_orderly((*words, "--json"), outcome.code, outcome.out, outcome.err)
        assert password not in outcome.out
        if words[0] != "check":
            assert outcome.code == code
            assert not code or set(outcome.codes()) == {"password-long"}
    assert code or (tmp_path / "ws/install/enclaves/talker/permissions.p7s").is_file()


STRIKER = """
import os, sys
number, at = int(sys.argv.pop(1)), int(sys.argv.pop(1))
seen = 0
def hook(event, arguments):
    global seen
    if event in {"open", "import", "exec", "os.rename", "os.mkdir", "os.remove", "os.listdir", "fcntl.flock"}:
        seen += 1
        if seen == at:
            os.kill(os.getpid(), number)
from keymint.__main__ import main
sys.addaudithook(hook)
try:
    main()
finally:
    if not at:
        print(seen, file=sys.stderr)
"""
"""Runs the command line, and sends it a signal at the interpreter event with this number."""


def struck(folder: Path, number: int, at: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", STRIKER, str(number), str(at), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("part", range(4))
def test_a_signal_at_any_time(keymint: Callable, tmp_path: Path, part: int) -> None:
    """The run prints one line or one document, exits as shells do, and the next run completes the workspace."""
    words = ("provision", "policy.xml", "-w", "ws")
    (tmp_path / "policy.xml").write_text(POLICY)
    whole = struck(tmp_path, 0, 0, *words)
    *_notes, number = whole.stderr.splitlines()
    events = int(number)
    assert (whole.returncode, events > 500) == (0, True)
    step = 7 if FULL else events // 3
    for count, at in enumerate(range(1 + part * (1 if FULL else step // 4), events, step)):
        shutil.rmtree(tmp_path / "ws", ignore_errors=True)
        number = (signal.SIGTERM, signal.SIGINT)[(count + part) % 2]
        as_json = (count + part) % 4 < 2
        ended = struck(tmp_path, number, at, *words, *(["--json"] if as_json else []))
        require_orderly(
            (*words, *(["--json"] if as_json else [])), ended.returncode, ended.stdout, ended.stderr, STOPPED
        )
        assert ended.returncode == (128 + number if ended.returncode else 0)
        if ended.returncode and as_json:
            (said,) = json.loads(ended.stdout)["diagnostics"]
            assert (said["code"], ended.stderr) == ("interrupted", "")
        elif ended.returncode:
            assert (ended.stdout, ended.stderr.count("\n")) == ("", 1)
        again = keymint(*words)
        assert (again.code, keymint("check", "-w", "ws").code) == (0, 0)
        assert not [path for path in (tmp_path / "ws").rglob("*") if path.name.startswith(".keymint-")]


STOPPED = frozenset({0, 130, 143})


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_ignored_signal_stays_ignored(tmp_path: Path, number: int) -> None:
    """As under nohup, or in the background of a script."""
    (tmp_path / "policy.xml").write_text(POLICY)
    signal_was = signal.signal(number, signal.SIG_IGN)
    try:
        assert struck(tmp_path, number, 300, "provision", "policy.xml", "-w", "ws").returncode == 0
    finally:
        signal.signal(number, signal_was)
