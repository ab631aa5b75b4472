# SPDX-License-Identifier: Apache-2.0
"""What is alike rolls up into its first with a number, so that a fleet prints as few lines as a robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import TypeVar

from comarmor.errors import Diagnostic
from comarmor.regex import lazy_regex
from keymint.store.changes import Step

FEW = 10
"""So many that are alike are shown one by one."""
_NAMES = lazy_regex(r"(?:(?:'[^']*'|\S*[/\d]\S*)[,;]?\s*)+")
"""What differs between messages that say the same: quoted words, paths, names of ROS, and numbers."""
_T = TypeVar("_T")


def rolled_up(items: Sequence[_T], kind: Callable[[_T], Hashable]) -> Iterator[tuple[_T, int]]:
    """Yield items, each with 1; where more than :data:`FEW` are of one kind, the first of them with their number.

    Args:
        items: the items, in the order in which they are shown.
        kind: returns equal values for items that are alike.
    """
    kinds = [kind(each) for each in items] if len(items) > FEW else range(len(items))
    numbers = Counter[Hashable](kinds)
    for item, own in zip(items, kinds, strict=True):
        number = numbers[own]
        if number > FEW:
            numbers[own] = 0
            yield item, number
        elif number:
            yield item, 1


def kind_of_diagnostic(diagnostic: Diagnostic) -> Hashable:
    """Return code, severity and message of a diagnostic without the names in it."""
    return diagnostic.code, diagnostic.severity, _without_names(diagnostic.message, diagnostic.subject)


def kind_of_step(step: Step) -> Hashable:
    """Return stage and action of a step, and its reason without the names in it."""
    return step.stage, step.action, _without_names(step.detail, step.package)


def _without_names(text: str, subject: str) -> str:
    name = subject.strip("/")
    return _NAMES.sub("… ", text.replace(name, "/") if name else text)
