# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for GitHub: an API of comments on loopback, and a runner that carries out the steps of ``action.yml``."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import parse_qs, urlsplit

import yaml

from tests.conftest import CHECKOUT

ACTION = yaml.safe_load((CHECKOUT / "action.yml").read_text())
TOKEN = "ghs_0123456789abcdef"
BOT = "github-actions[bot]"
AS_SOMEBODY = ("-c", "user.name=a", "-c", "user.email=a@example.org")


@dataclass
class Api:
    """The comments of pull request 7, and what was asked.

    Attributes:
        status: status of every answer, if not that of success.
        location: where answers redirect to.
    """

    comments: list[dict[str, Any]] = field(default_factory=list)
    asked: list[tuple[str, str]] = field(default_factory=list)
    tokens: set[str] = field(default_factory=set)
    status: int = 0
    location: str = ""
    address: str = ""

    def add(self, login: str, body: str) -> dict[str, Any]:
        number = 1000 + len(self.comments)
        comment = {"id": number, "user": {"login": login}, "body": body, "html_url": f"https://example.org/{number}"}
        self.comments.append(comment)
        return comment

    def answer(self, method: str, path: str, body: Any) -> Any:
        parts = urlsplit(path)
        if parts.path == "/repos/o/r/issues/7/comments":
            if method == "POST":
                return self.add(BOT, body["body"])
            query = parse_qs(parts.query)
            size, page = int(query["per_page"][0]), int(query["page"][0])
            return self.comments[size * (page - 1) : size * page]
        number = re.fullmatch(r"/repos/o/r/issues/comments/(\d+)", parts.path)
        assert method == "PATCH"
        assert number
        comment = next(each for each in self.comments if each["id"] == int(number[1]))
        comment["body"] = body["body"]
        return comment


@contextmanager
def served(api: Api) -> Iterator[Api]:
    """Serve the API on loopback."""

    class Handler(BaseHTTPRequestHandler):
        def _answer(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers.get("Content-Length") or 0)) or "null")
            api.asked.append((self.command, self.path))
            api.tokens.add(self.headers["Authorization"])
            self.send_response(api.status or (201 if self.command == "POST" else 200))
            if api.location:
                self.send_header("Location", api.location)
            self.end_headers()
            self.wfile.write(json.dumps({} if api.status else api.answer(self.command, self.path, body)).encode())

        do_GET = do_POST = do_PATCH = _answer  # noqa: N815 - names of the base class

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    api.address = f"http://127.0.0.1:{server.server_port}"
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield api
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def git(folder: Path, *arguments: str) -> str:
    return subprocess.run(
        ["git", *AS_SOMEBODY, *arguments], cwd=folder, check=True, capture_output=True, text=True
    ).stdout.strip()


@dataclass(frozen=True)
class Job:
    """A job that ran.

    Attributes:
        code: exit code of its last step.
        log: what it printed.
        summary: its summary.
        outputs: outputs of the step.
        workspace: the checkout.
    """

    code: int
    log: str
    summary: str
    outputs: Mapping[str, str]
    workspace: Path

    def commands(self) -> list[str]:
        """Return the lines that a runner takes for commands: none between stop-commands and its token."""
        found: list[str] = []
        stopped = ""
        for line in self.log.splitlines():
            if stopped:
                stopped = "" if line == f"::{stopped}::" else stopped
            elif line.startswith("::stop-commands::"):
                stopped = line.removeprefix("::stop-commands::")
            elif line.lstrip().startswith("::") or "##[" in line:
                found.append(line)
        assert not stopped
        return found


def run_action(
    checkout: Path, temporary: Path, api: Api | None, *, event: Mapping[str, Any], inputs: Mapping[str, str]
) -> Job:
    """Carry out the step ``run`` of the action as a runner does: the environment is all that it gets."""
    temporary.mkdir(parents=True, exist_ok=True)
    (temporary / "keymint-venv").symlink_to(sys.prefix)
    (temporary / "event.json").write_text(json.dumps(event))
    defaults = {name: str(each.get("default", "")) for name, each in ACTION["inputs"].items()}
    values = {**defaults, "token": TOKEN, **inputs}
    (step,) = (each for each in ACTION["runs"]["steps"] if each.get("id") == "run")
    environment = {
        name: re.sub(r"\$\{\{ inputs\.([\w-]+) \}\}", lambda match: values[match[1]], text)
        for name, text in step["env"].items()
    }
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("GITHUB_", "KEYMINT_"))}
    environment |= plain | {
        "RUNNER_TEMP": str(temporary),
        "GITHUB_ACTION_PATH": str(CHECKOUT),
        "GITHUB_EVENT_PATH": str(temporary / "event.json"),
        "GITHUB_STEP_SUMMARY": str(temporary / "summary.md"),
        "GITHUB_OUTPUT": str(temporary / "output"),
        "GITHUB_REPOSITORY": "o/r",
        "GITHUB_API_URL": api.address if api else "http://127.0.0.1:9",
        "GITHUB_HEAD_REF": "x$(touch pwned)`touch pwned`;touch pwned",
        "ACTIONS_RUNTIME_TOKEN": TOKEN,
    }
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=checkout, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    summary, output = temporary / "summary.md", temporary / "output"
    written = output.read_text() if output.exists() else ""
    outputs = {match[1]: match[3] for match in re.finditer(r"(?s)(\w+)<<(\w+)\n(.*?)\n\2\n", written)}
    return Job(
        done.returncode, done.stdout + done.stderr, summary.read_text() if summary.exists() else "", outputs, checkout
    )
