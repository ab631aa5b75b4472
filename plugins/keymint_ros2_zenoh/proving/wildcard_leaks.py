# SPDX-License-Identifier: Apache-2.0
"""Find key expressions that carry a message around a denial to a receiver.

A denial hides the keys that it includes. A sender that may also send a wider key expression can address the denied name
with it, and a receiver gets the message if its rights include that expression too. The smallest such expressions are
the denied one with one ``$*`` or ``**`` inserted. So for a denied name without wildcards their absence is a proof;
otherwise the answer may be unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import lru_cache

from comarmor.values import dataclass
from keymint_ros2_zenoh.keyexpr.key_expr import (
    ANY_CHARACTERS,
    ANY_CHUNK,
    ANY_CHUNKS,
    VERBATIM,
    KeyExpr,
    KeyExprError,
    of_chunks,
)
from keymint_ros2_zenoh.keyexpr.key_relations import includes, intersects
from keymint_ros2_zenoh.lowering.name_keys import TYPE_AND_HASH


@dataclass(frozen=True, slots=True)
class Rights:
    """What a subject may send, or receive, of one message.

    Attributes:
        subject: the subject.
        allowed: key expressions that are allowed.
        denied: key expressions that are denied.
    """

    subject: str
    allowed: tuple[KeyExpr, ...]
    denied: tuple[KeyExpr, ...]


@dataclass(frozen=True, slots=True)
class Leak:
    """A way around a denial.

    Attributes:
        sender: who is denied.
        receiver: who receives.
        denied: the denied key expression.
        key: the key expression that carries the message; None if it is not known whether there is one.
    """

    sender: str
    receiver: str
    denied: KeyExpr
    key: KeyExpr | None


def leaks(senders: Iterable[Rights], receivers: Sequence[Rights]) -> Iterator[Leak]:
    """Yield at most one leak for each denied key expression of a sender."""
    groups = _groups(receivers)
    for sender in senders:
        wild = [each for each in sender.allowed if not each.is_literal]
        for denied in sender.denied:
            around = [each for each in wild if intersects(each, denied) and not includes(denied, each)]
            if around:
                yield from _first(_past(sender, denied, around, groups))


_Group = tuple[tuple[KeyExpr, ...], tuple[KeyExpr, ...], list[str]]
"""Key expressions with wildcards that are allowed, those that are denied, and the subjects that have both."""


def _groups(receivers: Iterable[Rights]) -> list[_Group]:
    """Return the receivers by what they may receive: many have the same rights."""
    groups: dict[tuple[tuple[KeyExpr, ...], tuple[KeyExpr, ...]], list[str]] = {}
    for each in receivers:
        wild = tuple(allowed for allowed in each.allowed if not allowed.is_literal)
        if wild:
            groups.setdefault((wild, each.denied), []).append(each.subject)
    return [(allowed, denied, subjects) for (allowed, denied), subjects in groups.items()]


def _first(found: Iterable[Leak]) -> Iterator[Leak]:
    """Yield the first leak whose key is known, else the first one."""
    unknown = None
    for leak in found:
        if leak.key is not None:
            yield leak
            return
        unknown = unknown or leak
    if unknown is not None:
        yield unknown


def _past(sender: Rights, denied: KeyExpr, around: list[KeyExpr], groups: Iterable[_Group]) -> Iterator[Leak]:
    """Yield the leaks past a denied key expression, one for each right of each group."""
    sent = [key for key in (*wider(denied), *around) if any(includes(each, key) for each in around)]
    for allowed, hidden, subjects in groups:
        receiver = next((subject for subject in subjects if subject != sender.subject), None)
        for right in allowed if receiver else ():
            if not intersects(right, denied) or includes(denied, right):
                continue
            fitting = [key for key in sent if includes(right, key)]
            fitting += [right] * any(includes(each, right) for each in around)
            denials = (*sender.denied, *hidden)
            key = next((key for key in fitting if not any(includes(each, key) for each in denials)), None)
            meeting = any(intersects(each, right) for each in around)
            if key is not None or fitting or (meeting and not _is_plain(denied)):
                yield Leak(sender.subject, str(receiver), denied, key)


def _is_plain(denied: KeyExpr) -> bool:
    """Return whether only type and hash of a denied key expression are open, and what follows a verbatim chunk."""
    chunks = denied.chunks
    if len(chunks) > 1 and chunks[-2].startswith(VERBATIM):
        chunks = chunks[:-2]
    return not any("*" in chunk for chunk in chunks[: -len(TYPE_AND_HASH)])


@lru_cache(maxsize=1 << 12)
def wider(denied: KeyExpr) -> tuple[KeyExpr, ...]:
    """Return a key expression with one ``$*`` or ``**`` inserted, at each place where this makes a wider one."""
    found: dict[KeyExpr, None] = {}
    chunks = denied.chunks
    for at, chunk in enumerate(chunks):
        if chunk in (ANY_CHUNK, ANY_CHUNKS) or chunk.startswith(VERBATIM):
            continue
        for split in range(len(chunk) + 1):
            with suppress(KeyExprError):  # within a "$*"
                inserted = f"{chunk[:split]}{ANY_CHARACTERS}{chunk[split:]}"
                found[of_chunks((*chunks[:at], inserted, *chunks[at + 1 :]))] = None
    for at in range(len(chunks) + 1):
        found[of_chunks((*chunks[:at], ANY_CHUNKS, *chunks[at:]))] = None
    return tuple(each for each in found if not includes(denied, each))
