# SPDX-License-Identifier: Apache-2.0
"""What is alike rolls up into its first with a number, so that a fleet prints as few lines as a robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TypeVar

from comarmor.errors import Diagnostic
from comarmor.regex import lazy_regex
from keymint.store.changes import Step

_NAMES = lazy_regex(r"(?:(?:'[^']*'|\S*[/\d]\S*)[,;]?\s*)+")
"""What differs between messages that say the same: quoted words, paths, names of ROS, and numbers."""
_T = TypeVar("_T", Diagnostic, Step)


def rolled_up(items: Sequence[_T], few: int) -> Iterator[tuple[_T, int]]:
    """Yield items, each with 1; where many are alike, the first of them with their number.

    Args:
        items: diagnostics or steps, in the order in which they are shown.
        few: so many that are alike are shown one by one.
    """
    kinds = [_kind(each) for each in items]
    numbers = Counter(kinds)
    for item, own in zip(items, kinds, strict=True):
        number = numbers[own]
        if number > few:
            numbers[own] = 0
            yield item, number
        elif number:
            yield item, 1


def _kind(item: Diagnostic | Step) -> tuple[str, str, str]:
    """Return what is equal for items that are alike: what they are called, and their words without names."""
    if isinstance(item, Step):
        return item.stage, item.action, _without_names(item.detail, item.package)
    return item.code, item.severity, _without_names(item.message, item.subject)


def _without_names(text: str, subject: str) -> str:
    name = subject.strip("/")
    return _NAMES.sub("… ", text.replace(name, "/") if name else text)
