# SPDX-License-Identifier: Apache-2.0
"""The parts of the GitHub action, each alone: what the runner reads, and what the API is asked."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests.conftest import CHECKOUT
from tests.integrations.github import BOT, TOKEN, Api, git, served

MARKER = "<!-- keymint 0 -->"


@pytest.fixture
def workflow(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return imported("workflow", monkeypatch)


@pytest.fixture
def pull_request(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return imported("pull_request", monkeypatch)


def imported(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(CHECKOUT / "integrations/github"))
    monkeypatch.delitem(sys.modules, name, raising=False)
    return __import__(name)


@pytest.fixture
def api() -> Iterator[Api]:
    with served(Api()) as api:
        yield api


# -- workflow ----------------------------------------------------------------------------------------------------------


def test_an_annotation_is_one_line(workflow: ModuleType) -> None:
    assert workflow.annotation("note", "100%\r\n::error::x") == "::notice::100%25%0D%0A::error::x"
    assert workflow.annotation("error", "m", "a,line=9:b\n", 3) == "::error file=a%2Cline=9%3Ab%0A,line=3::m"


def test_text_cannot_end_the_block_in_which_there_are_no_commands(workflow: ModuleType) -> None:
    first, *middle, last = workflow.shown("::error::a\n::resume::\nb\n").splitlines()
    assert first.startswith("::stop-commands::")
    assert last == f"::{first.removeprefix('::stop-commands::')}::"
    assert middle == ["::error::a", "::resume::", "b"]
    assert workflow.shown("") != workflow.shown("")


def test_outputs_of_several_lines(workflow: ModuleType, tmp_path: Path) -> None:
    name, end = workflow.outputs({"a": "x\nb=injected"}).splitlines()[0].split("<<")
    assert (name, end.startswith("end_")) == ("a", True)
    workflow.append(str(tmp_path / "out"), "1\n")
    workflow.append(str(tmp_path / "out"), "\udcff\n")
    workflow.append("", "nowhere")
    assert (tmp_path / "out").read_text() == "1\n\\udcff\n"


def test_a_block_of_code_ends_where_it_should(workflow: ModuleType) -> None:
    assert workflow.fenced("a\n````\n@team\n") == "`````text\na\n````\n@team\n`````"


def test_what_is_too_long_is_cut_between_lines_and_its_block_is_closed(workflow: ModuleType) -> None:
    text = "\n".join(["head", workflow.fenced("\n".join(["```", *("é" * 10 for _ in range(50))])), "tail"])
    assert workflow.cut(text, len(text.encode()), "…") == text
    for most in range(60, 900, 7):
        short = workflow.cut(text, most, "more")
        assert len(short.encode()) <= most
        assert short.endswith("\nmore\n")
        assert short.count("````") in (0, 2)
    assert workflow.cut("x" * 100, 50, "more") == "\nmore\n"


# -- pull_request ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "event",
    [
        {"pull_request": {"number": "7", "base": {"sha": "0" * 40}, "head": {"sha": "1" * 40}}},
        {"pull_request": {"number": 7, "base": {"sha": "--upload-pack=x"}, "head": {"sha": "1" * 40}}},
        {"pull_request": {"number": 7, "base": {"sha": "0" * 40}, "head": {"sha": "main"}}},
    ],
)
def test_an_event_that_is_not_of_github_is_refused(pull_request: ModuleType, tmp_path: Path, event: dict) -> None:
    (tmp_path / "event.json").write_text(json.dumps(event))
    with pytest.raises(ValueError, match="has no number or commits"):
        pull_request.PullRequest.of_event(str(tmp_path / "event.json"))


def test_an_event_without_a_pull_request(pull_request: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "event.json").write_text('{"ref": "refs/heads/main"}')
    assert pull_request.PullRequest.of_event(str(tmp_path / "event.json")) is None
    assert pull_request.PullRequest.of_event("") is None


def test_the_base_is_the_first_parent_of_the_merge_else_that_of_the_event(
    pull_request: ModuleType, tmp_path: Path
) -> None:
    git(tmp_path, "init", "-q", "-b", "main")
    commits = []
    for branch in ("main", "change"):
        git(tmp_path, "switch", "-q", "-C", branch)
        git(tmp_path, "commit", "-q", "--allow-empty", "-m", "parent 0")
        commits.append(git(tmp_path, "rev-parse", "HEAD"))
    event = pull_request.PullRequest(7, commits[0], commits[1])
    assert pull_request.base_of(event, tmp_path) == commits[0]  # the head itself is checked out
    git(tmp_path, "switch", "-q", "main")
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "later")
    later = git(tmp_path, "rev-parse", "HEAD")
    git(tmp_path, "merge", "-q", "--no-ff", "-m", "merge", "change")
    assert pull_request.base_of(event, tmp_path) == later
    with pytest.raises(pull_request.CheckoutError, match="neither the head of the pull request nor its merge"):
        pull_request.base_of(pull_request.PullRequest(7, later, "1" * 40), tmp_path)
    git(tmp_path, "switch", "-q", "change")
    with pytest.raises(subprocess.CalledProcessError):
        pull_request.base_of(pull_request.PullRequest(7, "0" * 40, commits[1]), tmp_path)


def test_a_comment_is_written_once_and_those_of_others_never(pull_request: ModuleType, api: Api) -> None:
    planted = api.add("mallory", f"{MARKER}\nplanted")
    quoted = api.add(BOT, f"> {MARKER}\nquoted")
    for number in range(150):
        api.add("somebody", str(number))
    comments = pull_request.Comments(api.address, "o/r", TOKEN, BOT)
    assert TOKEN not in repr(comments)
    address = comments.write(7, MARKER, "one")
    assert comments.write(7, MARKER, "one") == address
    assert [method for method, _ in api.asked] == ["GET", "GET", "POST", "GET", "GET"]
    assert comments.write(7, MARKER, "two") == address
    assert api.asked[-1][0] == "PATCH"
    assert [each["body"] for each in api.comments if each["user"]["login"] == BOT] == [
        quoted["body"], f"{MARKER}\ntwo",
    ]  # fmt: skip
    assert planted["body"].endswith("planted")


@pytest.mark.parametrize(
    ("status", "message"),
    [(401, "the token is not valid"), (403, "may not comment"), (500, "GitHub refuses"), (302, "GitHub refuses")],
)
def test_a_refusal_is_one_line_and_no_redirect_is_followed(
    pull_request: ModuleType, api: Api, status: int, message: str
) -> None:
    with served(Api()) as other:
        api.status, api.location = status, f"{other.address}/stolen"
        with pytest.raises(pull_request.CommentError, match=message):
            pull_request.Comments(api.address, "o/r", TOKEN, BOT).write(7, MARKER, "x")
    assert other.asked == []


def test_what_is_no_api_gets_no_token(pull_request: ModuleType, api: Api) -> None:
    for address, repository in (
        ("http://example.org", "o/r"), ("file:///etc/passwd", "o/r"), (api.address, "o/r/../x"), (api.address, "")
    ):  # fmt: skip
        with pytest.raises(pull_request.CommentError):
            pull_request.Comments(address, repository, TOKEN, BOT)
    with pytest.raises(pull_request.CommentError, match="does not answer"):
        pull_request.Comments("http://127.0.0.1:9", "o/r", TOKEN, BOT).write(7, MARKER, "x")
