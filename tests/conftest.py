# SPDX-License-Identifier: Apache-2.0
"""Fixtures for all tests: the command line, run in this process."""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from keymint import cli
from keymint.api import Environment, plugin_loader
from keymint.api.plugin_loader import PluginInfo, Plugins, entries_in
from keymint.view.recorded_answers import software_metadata
from tests import advice
from tests.effort import tries
from tests.softhsm import SoftHsm, opened

# Machines are noisy, so an example has no deadline. Where CI is set, hypothesis tries the same examples each time.
hypothesis.settings.register_profile("keymint", deadline=None, max_examples=tries(50, 100))
hypothesis.settings.load_profile("keymint")

# A shell that starts the suite in the background ignores SIGINT. Every process that a test starts would inherit this,
# and could not be interrupted.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

CHECKOUT = Path(__file__).resolve().parent.parent
NOW = 1_800_000_000
"""2027-01-15T08:00:00Z, the clock of the tests, as ``SOURCE_DATE_EPOCH``."""


LONGEST = ("robustness", "packaging", "tests")
"""Folders of the tests that take longest. They start first, so that no processor is idle at the end."""
WAITING = "real"
"""The folder of tests that mostly wait for other software. They run beside those that compute."""


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name PEM in a test by its argument: each worker makes keys of its own, and all must collect the same tests."""
    text = val.decode("latin-1") if isinstance(val, bytes) else val
    return argname if isinstance(text, str) and "-----BEGIN" in text else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with the longest tests first, and spread those that wait evenly, but not to the end."""
    files = list(dict.fromkeys(item.path for item in items))
    waiting = [file for file in files if file.parent.name == WAITING]
    computing = [file for file in files if file.parent.name != WAITING]
    computing.sort(key=lambda file: LONGEST.index(file.parent.name) if file.parent.name in LONGEST else len(LONGEST))
    place = {file: at / len(computing) for at, file in enumerate(computing)}
    place |= {file: 0.7 * at / len(waiting) for at, file in enumerate(waiting)}
    items.sort(key=lambda item: place[item.path])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Run the tests of a file in one process, so that its fixtures are made once, and groups as they are marked."""
    from xdist.scheduler import LoadGroupScheduling

    class ByFile(LoadGroupScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return super()._split_scope(nodeid).partition("::")[0]

    return ByFile(config, log) if config.getvalue("dist") == "loadgroup" else None


def pytest_collection_finish() -> None:
    """Spare the garbage collector the thousands of tests, which stay until the end."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


@dataclass(frozen=True)
class Outcome:
    """The result of a run of the command line."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """The document that ``--json`` printed."""
        return json.loads(self.out)

    def codes(self) -> list[str]:
        """The codes of the diagnostics that ``--json`` printed."""
        return [diagnostic["code"] for diagnostic in self.document["diagnostics"]]


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fix the clock, and hide the machine's ROS."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(NOW))
    monkeypatch.setenv("COLUMNS", "200")  # tables of a wide terminal
    for name in (
        "ROS_DISTRO",
        "ROS_DOMAIN_ID",
        "AMENT_PREFIX_PATH",
        "KEYMINT_TRACEBACK",
        "KEYMINT_PKCS11_PIN",
        "KEYMINT_PKCS11_MODULE",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/nonexistent")  # where the developer may have defaults


@pytest.fixture(scope="session", autouse=True)
def read_once() -> Iterator[None]:
    """Let the runs in this process read the entry points of a distribution once, unless its files change."""
    read, known = plugin_loader.entries_of, {}

    def entries_of(metadata: str) -> tuple[PluginInfo, ...]:
        key = (metadata, *(file_status(f"{metadata}/{file}") for file in ("entry_points.txt", "METADATA")))
        if key not in known:
            known[key] = tuple(read(metadata))
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugin_loader, "entries_of", entries_of)
        yield


def installed_plugins(environment: Environment | None = None) -> Plugins:
    """Return the plugins of the environment that runs the tests."""
    return Plugins(entries_in(software_metadata()), environment and (lambda: environment))


def file_status(path: str) -> tuple[int, int, int] | None:
    """Return what tells whether a file changed; None if there is none."""
    try:
        found = os.stat(path)  # noqa: PTH116 - called some hundred times in each run of the command line
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


@pytest.fixture
def keymint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Outcome]]:
    """Run the command line in ``tmp_path``, or in another folder.

    With ``KEYMINT_FULL=1`` (or ``KEYMINT_ADVICE=1``) the advice of each error that a test meets is followed, in a
    copy of its folder.
    """
    wrong: list[str] = []

    def run(*arguments: object, cwd: Path | None = None, env: Mapping[str, str] | None = None) -> Outcome:
        out, err = io.StringIO(), io.StringIO()
        with monkeypatch.context() as patch:
            patch.chdir(cwd or tmp_path)
            patch.setenv("KEYMINT_TRACEBACK", "1")
            for name, value in (env or {}).items():
                patch.setenv(name, value)
            umask = os.umask(0o022)
            try:
                with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                    code = cli.main([str(argument) for argument in arguments])
            finally:
                os.umask(umask)
            if advice.FOLLOWS and os.environ.get("KEYMINT_ADVICE") != "0" and code in {1, 3}:
                wrong.extend(advice.in_a_fork([str(each) for each in arguments], tmp_path, cwd or tmp_path))
        sys.stdout.flush()
        return Outcome(code, out.getvalue(), err.getvalue())

    yield run
    assert wrong == []


@pytest.fixture
def softhsm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SoftHsm:
    """A token in software without keys, which the modules of this process and of all that it starts see."""
    token = opened(tmp_path / "softhsm")
    for name, value in token.environment.items():
        monkeypatch.setenv(name, value)
    return token


@pytest.fixture
def reference() -> Path:
    """Real-world data, beside the checkout on some machines only."""
    folder = CHECKOUT.parent / "shared" / "reference"
    if not folder.is_dir():
        pytest.skip("no ../shared/reference beside this checkout")
    return folder


def snapshot(folder: Path) -> dict[str, tuple[int, int, bytes]]:
    """Return the mode, modification time and content of every file and folder below a folder.

    Recorded answers are left out: a command that has nothing to do may record what it says.
    """
    return {
        str(path.relative_to(folder)): (
            path.lstat().st_mode,
            path.lstat().st_mtime_ns if path.name != ".keymint" else 0,
            path.read_bytes() if path.is_file() else b"",
        )
        for path in sorted(folder.rglob("*"))
        if not path.match(".keymint/last-*.json")
    }
