# SPDX-License-Identifier: Apache-2.0
"""The program of a process with real Zenoh sessions, with more commands that only tests need."""

from __future__ import annotations

import sys
from typing import Any

import zenoh
import zenoh.ext
from keymint_ros2_zenoh.vendors.session_program import Commands, Mailbox, in_order, main


class MoreCommands(Commands):
    """The commands by name; each gets the other members of its JSON object."""

    def accept(self, file: str) -> None:
        """Read a configuration as the library does, without opening a session."""
        zenoh.Config.from_file(file)

    def publish_late(self, session: str, key: str, text: str) -> None:
        """Publish a sample that late subscribers get too, as a ROS node does on a ``transient_local`` topic."""
        publisher = zenoh.ext.declare_advanced_publisher(
            self._sessions[session], key, cache=zenoh.ext.CacheConfig(max_samples=1), publisher_detection=True
        )
        self._declared[session].append(publisher)
        publisher.put(text)

    def subscribe_late(self, session: str, name: str, key: str) -> None:
        """Declare a subscriber that also gets samples that were published before it, in a mailbox."""
        box = self._mailboxes[name] = Mailbox()
        self._declared[session].append(
            zenoh.ext.declare_advanced_subscriber(
                self._sessions[session],
                key,
                box.arrived,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            )
        )

    def delete(self, session: str, keys: list[str]) -> None:
        """Send a deletion for each key."""
        for key in keys:
            self._sessions[session].delete(key)

    def watch(self, session: str, keys: dict[str, str]) -> None:
        """Declare subscribers on liveliness tokens, by the names of their mailboxes; a text is ``+`` or ``-``."""
        for name, key in keys.items():
            box = self._mailboxes[name] = Mailbox()

            def changed(sample: Any, box: Mailbox = box) -> None:
                box.put(str(sample.key_expr), "+" if sample.kind == zenoh.SampleKind.PUT else "-")

            liveliness = self._sessions[session].liveliness()
            self._declared[session].append(liveliness.declare_subscriber(key, in_order(changed), history=True))

    def send_queries(self, session: str, keys: list[str]) -> None:
        """Send queries for keys and for liveliness tokens, and do not wait for answers."""
        for key in keys:
            self._sessions[session].get(key, lambda _: None, timeout=1.0)
            self._sessions[session].liveliness().get(key, lambda _: None, timeout=1.0)

    def tokens(self, session: str, keys: list[str]) -> None:
        """Declare liveliness tokens."""
        self._declared[session] += [self._sessions[session].liveliness().declare_token(key) for key in keys]

    def alive(self, session: str, key: str, seconds: float) -> list[str]:
        """Return the keys of the liveliness tokens that a key expression finds."""
        replies = self._sessions[session].liveliness().get(key, timeout=seconds)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def peers(self, session: str) -> dict[str, list[str]]:
        """Return the identifiers of the routers and peers that a session is connected to."""
        info = self._sessions[session].info
        return {
            "routers": [str(each) for each in info.routers_zid()],
            "peers": [str(each) for each in info.peers_zid()],
        }


if __name__ == "__main__":
    main(sys.argv[1], MoreCommands())
