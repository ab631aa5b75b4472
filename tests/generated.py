# SPDX-License-Identifier: Apache-2.0
"""Random policies with all features, from a seed: nesting, tunables, placeholders, partitions, denials, both dialects.

A policy is a list of tokens, so that it can be written with an element on each line, or all on one line.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from xml.sax.saxutils import escape

from comarmor.rules import PERMISSIONS

Tokens = list[str]

_WORDS = ("scan", "odom", "cmd", "map", "arm", "lidar", "status", "image", "a", "b", "x")
_ROBOTS = ("/r1", "/r2", "/robot", "/fleet/r1", "/cell/line", "")
_SUBJECTS = ("talker", "driver", "planner", "camera", "ui")
_PARTITIONS: tuple[Sequence[str], ...] = (
    (), (), (), ("p",), ("p", "q"), ("",), ("p", ""), ("lab/*",), ("*",), ("p*",), ("lab/a", "lab/b"),
)  # fmt: skip
_XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


class _Writer:
    """Draws the parts of one policy.

    Args:
        rng: the source of choices.
        include: href of a file that profiles may include; empty for none.
    """

    def __init__(self, rng: Random, include: str) -> None:
        self._rng = rng
        self._include = include
        self._tunables = 0

    def policy(self) -> Tokens:
        rng = self._rng
        tokens = [f"<profiles {_XI}>"]
        known: list[str] = []
        for _ in range(rng.choice((0, 0, 1, 2))):
            tokens += self._tunable(known)
        for _ in range(rng.randint(1, 5)):
            tokens += self._profile(list(known), "", 1)
        return [*tokens, "</profiles>"]

    def _tunable(self, known: list[str]) -> Tokens:
        self._tunables += 1
        name = f"T{self._tunables}"
        values = self._rng.sample(("r1", "r2", "cell", "scan", "odom", "a*", "[ab]", "x?"), self._rng.randint(1, 3))
        known.append(name)
        return [f'<tunable name="{name}">', *(f"<value>{value}</value>" for value in values), "</tunable>"]

    def _profile(self, known: list[str], around: str, depth: int) -> Tokens:
        rng = self._rng
        tokens = [f'<profile name="p{rng.randrange(1000)}"{self._audit()}>']
        if rng.random() < 0.15:
            tokens += self._tunable(known)
        mine = [self._subject(known, around) for _ in range(rng.choice((1, 1, 1, 2, 3)))]
        tokens += self._attachments(mine)
        if self._include and rng.random() < 0.3:
            tokens.append(f'<xi:include href="{self._include}" parse="xml"/>')
        for _ in range(rng.choice((1, 2, 3, 5, 8))):
            tokens += self._rule(known)
        if depth < 4 and rng.random() < 0.35:
            for _ in range(rng.randint(1, 2)):
                tokens += self._profile(list(known), rng.choice(mine), depth + 1)
        return [*tokens, "</profile>"]

    def _subject(self, known: Sequence[str], around: str) -> str:
        rng = self._rng
        robot, name = rng.choice(_ROBOTS), rng.choice(_SUBJECTS)
        if around and rng.random() < 0.8:
            narrower = around.replace("*", f"/{name}" if around.startswith("*") else name, 1)
            return narrower if rng.random() < 0.7 else around
        if known and rng.random() < 0.2:
            return f"/@{{{rng.choice(known)}}}/{name}"
        return rng.choice((f"{robot}/{name}",) * 4 + (f"{robot}/*", f"*/{name}", f"{robot}/{name}?", f"/r[12]/{name}"))

    def _rule(self, known: Sequence[str]) -> Tokens:
        rng = self._rng
        kind = rng.choice(("ros_topic",) * 4 + ("ros_service", "ros_action", "ros_parameter", "topic", "topic"))
        permissions = rng.sample(PERMISSIONS[kind], rng.randint(1, 2))
        effect = rng.choice(("ALLOW", "ALLOW", "ALLOW", "DENY"))
        names = [self._object(kind, known) for _ in range(rng.choice((1, 1, 1, 2, 3)))]
        tokens = [f'<{kind} qualifier="{effect}"{self._audit()}>', *self._attachments(names)]
        partitions = rng.choice(_PARTITIONS) if kind == "topic" else ()
        if partitions:
            tokens += ["<partitions>", *(f"<partition>{each}</partition>" for each in partitions), "</partitions>"]
        return [*tokens, "<permissions>", *(f"<{each}/>" for each in permissions), "</permissions>", f"</{kind}>"]

    def _object(self, kind: str, known: Sequence[str]) -> str:
        rng = self._rng
        one, two = rng.choice(_WORDS), rng.choice(_WORDS)
        robot = rng.choice(_ROBOTS)
        if kind == "topic":
            return rng.choice((one, f"{one}/{two}", f"{one}*", f"{one}/*", f"*{one}", f"{one}?{two}", f"rt/{one}", "*"))
        if known and rng.random() < 0.15:
            return f"{robot}/@{{{rng.choice(known)}}}"
        return rng.choice((
            *(f"{robot}/{one}",) * 3, f"{robot}/{one}/{two}", f"{robot}/{one}*", f"{robot}/*", f"*/{one}",
            f"{robot}/*{one}*", f"*{one}*{two}*", f"{robot}/{one}[0-9]", f"{robot}/[!{one[0]}]*", f"/{one}?",
            f"{{namespace}}{one}", f"{{namespace}}{{name}}/{one}", "{namespace}*", f"{{namespace}}{one}*", "/{name}",
        ))  # fmt: skip

    def _attachments(self, texts: Sequence[str]) -> Tokens:
        plain = [f"<attachment>{escape(text)}</attachment>" for text in dict.fromkeys(texts)]
        return plain if self._rng.random() < 0.6 else ["<attachments>", *plain, "</attachments>"]

    def _audit(self) -> str:
        return ' modifier="AUDIT"' if self._rng.random() < 0.1 else ""


def tokens(seed: int, *, include: str = "") -> Tokens:
    """Return the tokens of a policy, the same for the same seed.

    Args:
        seed: any number.
        include: href of a file that profiles may include; empty for none.
    """
    return _Writer(Random(seed), include).policy()


def pretty(policy: Sequence[str]) -> str:
    """Return a policy with a token on each line."""
    return "\n".join(policy) + "\n"


def minified(policy: Sequence[str]) -> str:
    """Return a policy on one line."""
    return "".join(policy)


def line_in_pretty(policy: Sequence[str], column: int) -> int:
    """Map a column of the minified policy to a line of the policy with one token per line, both from 1."""
    at = 1
    for number, token in enumerate(policy, 1):
        if at == column:
            return number
        at += len(token)
    raise ValueError(column)
