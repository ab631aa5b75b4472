# SPDX-License-Identifier: Apache-2.0
"""The program of a process with real Zenoh sessions; :mod:`zenoh_processes` starts it and talks to it.

It reads one command per line, a JSON object with a member ``do``, and answers each with one line: a JSON object, which
has a member ``error`` if the command failed. It imports nothing of Keymint. The library writes its log to standard
output, which therefore is a file; answers go to a copy of the first standard output.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh
import zenoh.handlers

_QUERY_SECONDS = 10.0


class Mailbox:
    """Samples in the order of their arrival."""

    def __init__(self) -> None:
        self._samples: list[tuple[str, str]] = []
        self._arrival = threading.Condition()

    def put(self, key: str, text: str) -> None:
        """Put a key and a text."""
        with self._arrival:
            self._samples.append((key, text))
            self._arrival.notify_all()

    def arrived(self, sample: Any) -> None:
        """Put the key and the text of a sample of the library."""
        self.put(str(sample.key_expr), sample.payload.to_string())

    def replied(self, key: str, reply: Any) -> None:
        """Put the text of a reply, if it is one, as the answer to the query for a key."""
        if reply.ok is not None:
            self.put(key, reply.ok.payload.to_string())

    def samples(self, last: str = "", seconds: float = 0) -> list[tuple[str, str]]:
        """Return all samples until now, but first wait for one with the text ``last``, up to a time."""
        with self._arrival:
            self._arrival.wait_for(lambda: any(text == last for _, text in self._samples), seconds)
            return list(self._samples)


def in_order(called: Callable[[Any], None]) -> Any:
    """Return a handler that the library's own thread calls.

    A bare function gets a thread for each declaration. Then a mailbox may still be empty when a later sample is already
    in another one, and a fence would prove nothing about the samples before it.
    """
    return zenoh.handlers.Callback(called, indirect=False)


class Commands:
    """The commands by name; each gets the other members of its JSON object."""

    def __init__(self) -> None:
        self._sessions: dict[str, Any] = {}
        self._mailboxes: dict[str, Mailbox] = {}
        self._declared: dict[str, list[Any]] = {}
        self._publishers: dict[tuple[str, str], Any] = {}
        self._queriers: dict[tuple[str, str], Any] = {}

    def open(self, session: str, file: str, changes: dict[str, str]) -> None:
        """Open a session with a configuration; ``changes`` are JSON texts by the path of their setting."""
        config = zenoh.Config.from_file(file)
        for path, value in changes.items():
            config.insert_json5(path, value)
        self._sessions[session] = zenoh.open(config)
        self._declared[session] = []

    def close(self, session: str) -> None:
        """Close a session."""
        self._declared.pop(session)
        self._sessions.pop(session).close()

    def publishers(self, session: str, keys: list[str]) -> None:
        """Declare a publisher on each key."""
        self._declared[session] += [self._sessions[session].declare_publisher(key) for key in keys]

    def put(self, session: str, samples: list[tuple[str, str]]) -> None:
        """Publish (key, text) pairs, by a publisher that is not declared; none is dropped because of a full queue."""
        for key, text in samples:
            self._sessions[session].put(key, text, congestion_control=zenoh.CongestionControl.BLOCK)

    def publish(self, session: str, samples: list[tuple[str, str]]) -> None:
        """Publish (key, text) pairs, each by a publisher that is declared once, as a ROS node does.

        A publisher sends nothing until it knows of a subscriber, except at first, while it waits to know.
        """
        for key, text in samples:
            if (session, key) not in self._publishers:
                self._publishers[session, key] = self._sessions[session].declare_publisher(key)
            self._publishers[session, key].put(text)

    def subscribe(self, session: str, keys: dict[str, str]) -> None:
        """Declare subscribers on keys, by the names of their mailboxes."""
        for name, key in keys.items():
            box = self._mailboxes[name] = Mailbox()
            self._declared[session].append(self._sessions[session].declare_subscriber(key, in_order(box.arrived)))

    def received(self, names: list[str], last: str, seconds: float) -> dict[str, list[tuple[str, str]]]:
        """Return the samples in mailboxes; wait for the text ``last`` in the first of them, up to a time."""
        self._mailboxes[names[0]].samples(last, seconds)
        return {name: self._mailboxes[name].samples() for name in names}

    def answer(self, session: str, keys: list[str], text: str) -> None:
        """Declare queryables that answer each query with a text, on the key of the query if it is literal."""
        for key in keys:

            def reply(query: Any, own: str = key) -> None:
                asked = str(query.key_expr)
                query.reply(own if "*" in asked else asked, text)

            queryable = self._sessions[session].declare_queryable(key, reply, complete=True)
            self._declared[session].append(queryable)

    def query(self, session: str, keys: dict[str, str]) -> None:
        """Send a query for each key, by the name of the mailbox into which its answers come."""
        for name, key in keys.items():
            box = self._mailboxes[name] = Mailbox()
            self._sessions[session].get(key, in_order(partial(box.replied, key)), timeout=_QUERY_SECONDS)

    def queriers(self, session: str, keys: list[str], seconds: float) -> dict[str, list[str]]:
        """Query each key by a querier that is declared once, as a ROS client does; return the answers after a time.

        A querier sends nothing until it knows of a queryable, except at first, while it waits to know.
        """
        found: dict[str, list[str]] = {}
        for key in keys:
            if (session, key) not in self._queriers:
                self._queriers[session, key] = self._sessions[session].declare_querier(key, timeout=seconds)
            replies = self._queriers[session, key].get()
            found[key] = [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]
        return found

    def zid(self, session: str) -> str:
        """Return the identifier of a session."""
        return str(self._sessions[session].info.zid())


def main(log: str, commands: Commands) -> None:
    """Answer commands until standard input ends.

    Args:
        log: file for the log of the library, which ``RUST_LOG`` controls.
        commands: the commands that are known.
    """
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    target = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    os.dup2(target, 1)
    zenoh.init_log_from_env_or("error")
    for line in sys.stdin:
        command = json.loads(line)
        try:
            answer = {"result": getattr(commands, command.pop("do"))(**command)}
        except KeyboardInterrupt:
            return
        except BaseException as error:  # noqa: BLE001 - a panic of the library is a BaseException
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main(sys.argv[1], Commands())
