# SPDX-License-Identifier: Apache-2.0
"""A pull request on GitHub: the revision that it starts from, and a comment on it (REST API of GitHub, 2022-11-28)."""

from __future__ import annotations

import json
import re
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

LONGEST_COMMENT = 65_000
"""Bytes of a comment; GitHub takes 65,536 characters."""
_MOST_PAGES = 50
_PAGE = 100
_SECONDS = 30
_OBJECT = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")
_REPOSITORY = re.compile(r"[\w.-]+/[\w.-]+")


class CheckoutError(Exception):
    """The checkout is not what the pull request proposes: one line what it is."""


class CommentError(Exception):
    """The comment was not written: one line why."""


@dataclass(frozen=True, slots=True)
class PullRequest:
    """The pull request that a workflow runs for.

    Attributes:
        number: its number.
        base: commit of the branch that it goes to, when the event happened.
        head: commit of the branch that it comes from.
    """

    number: int
    base: str
    head: str

    @classmethod
    def of_event(cls, path: str) -> PullRequest | None:
        """Return the pull request of an event, or None if the event is about something else.

        Args:
            path: the file that ``GITHUB_EVENT_PATH`` names; may be empty.

        Raises:
            ValueError: the event has no usable pull request.
        """
        event = json.loads(Path(path).read_text(encoding="utf-8")) if path else {}
        found = event.get("pull_request")
        if not found:
            return None
        number, base, head = found.get("number"), found["base"]["sha"], found["head"]["sha"]
        if type(number) is not int or not _OBJECT.fullmatch(str(base)) or not _OBJECT.fullmatch(str(head)):
            raise ValueError(f"the pull request of the event {path} has no number or commits")
        return cls(number, base, head)


def git(folder: Path, *arguments: str) -> str:
    """Run git and return its output.

    Raises:
        subprocess.CalledProcessError: it fails.
    """
    done = subprocess.run(
        ["git", *arguments], cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=True, timeout=600
    )
    return done.stdout.decode(errors="replace").strip()


def base_of(pull_request: PullRequest, folder: Path) -> str:
    """Return the commit to compare with, which is fetched if the checkout is shallow.

    ``actions/checkout`` checks out the merge of both branches: its first parent is the base as it is now, so that what
    others merged meanwhile does not count as a change of the pull request.

    Args:
        pull_request: the pull request.
        folder: the checkout.

    Raises:
        CheckoutError: the checkout is something else, e.g. the base itself, of which the pull request changes nothing.
        subprocess.CalledProcessError: the commit is not there, and cannot be fetched.
    """
    head = git(folder, "rev-parse", "HEAD")
    header = git(folder, "cat-file", "commit", "HEAD").partition("\n\n")[0]
    parents = re.findall(r"^parent ([0-9a-f]+)$", header, re.MULTILINE)
    is_merge = len(parents) == 2 and parents[1] == pull_request.head  # noqa: PLR2004 - a merge of two branches
    if not is_merge and head != pull_request.head:
        raise CheckoutError(
            f"the checkout is {head[:12]}, neither the head of the pull request nor its merge with the base"
        )
    base = parents[0] if is_merge else pull_request.base
    try:
        git(folder, "cat-file", "-e", f"{base}^{{commit}}")
    except subprocess.CalledProcessError:
        git(folder, "fetch", "--quiet", "--no-tags", "--no-recurse-submodules", "--depth=1", "origin", base)
    return base


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirect: the token is for one host."""

    def redirect_request(self, *_: Any) -> None:
        return None


@dataclass(frozen=True, slots=True)
class Comments:
    """The comments of pull requests in a repository.

    Attributes:
        api: address of the API, e.g. ``https://api.github.com``.
        repository: ``owner/name``.
        token: for the header ``Authorization``.
        author: login of the token's owner; comments of others are never changed.
    """

    api: str
    repository: str
    token: str = field(repr=False)
    author: str

    def __post_init__(self) -> None:
        parts = urlsplit(self.api)
        if parts.scheme != "https" and parts.hostname not in ("127.0.0.1", "localhost"):
            raise CommentError(f"the token is not sent to {self.api!r}, which is no https address")
        if not _REPOSITORY.fullmatch(self.repository):
            raise CommentError(f"{self.repository!r} is no repository, expected owner/name")

    def write(self, number: int, marker: str, text: str) -> str:
        """Update our comment that begins with a marker, or write it; return its address.

        Args:
            number: number of the pull request.
            marker: a line that identifies the comment.
            text: the rest of the comment.

        Raises:
            CommentError: the API refuses, or cannot be reached.
        """
        body = {"body": f"{marker}\n{text}"}
        mine = next((each for each in self._all(number) if self._is_mine(each, marker)), None)
        if mine is None:
            answer = self._ask("POST", f"issues/{number}/comments", body)
        elif mine.get("body") == body["body"]:
            answer = mine
        else:
            answer = self._ask("PATCH", f"issues/comments/{int(mine['id'])}", body)
        return str(answer.get("html_url", ""))

    def _is_mine(self, comment: Mapping[str, Any], marker: str) -> bool:
        author = (comment.get("user") or {}).get("login")
        return author == self.author and str(comment.get("body") or "").startswith(f"{marker}\n")

    def _all(self, number: int) -> Iterator[Mapping[str, Any]]:
        for page in range(1, _MOST_PAGES + 1):
            comments = self._ask("GET", f"issues/{number}/comments?per_page={_PAGE}&page={page}")
            if not isinstance(comments, list):
                raise CommentError("GitHub does not answer with a list of comments")
            yield from comments
            if len(comments) < _PAGE:
                return

    def _ask(self, method: str, path: str, body: Mapping[str, str] | None = None) -> Any:
        request = urllib.request.Request(  # the address is checked when the object is made
            f"{self.api.rstrip('/')}/repos/{self.repository}/{path}",
            data=None if body is None else json.dumps(body).encode(),
            method=method,
            headers={
                "Authorization": f"Bearer {self.token}",
                "Accept": "application/vnd.github+json",
                "X-GitHub-Api-Version": "2022-11-28",
                "Content-Type": "application/json",
                "User-Agent": "keymint",
            },
        )
        try:
            with urllib.request.build_opener(_NoRedirect).open(request, timeout=_SECONDS) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            reason = {
                401: "the token is not valid",
                403: "the token may not comment",
                404: "the token sees no such pull",
            }
            raise CommentError(f"{reason.get(error.code, 'GitHub refuses')} (HTTP {error.code})") from None
        except (OSError, HTTPException, ValueError) as error:
            raise CommentError(f"GitHub does not answer: {type(error).__name__}") from None
