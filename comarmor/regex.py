# SPDX-License-Identifier: Apache-2.0
"""Regular expressions that are compiled at their first use: a run uses few of those that its modules define."""

from __future__ import annotations

import re
from typing import Any, AnyStr, cast


def lazy_regex(pattern: AnyStr, flags: int = 0) -> re.Pattern[AnyStr]:
    """Return a regular expression like :func:`re.compile`, which is compiled when a method of it is first used.

    Errors in the pattern are raised then; so use it for patterns that are part of the program only.

    Args:
        pattern: the regular expression.
        flags: of :mod:`re`.
    """
    return cast("re.Pattern[AnyStr]", _Regex(pattern, flags))


class _Regex:
    """Has the attributes of a compiled regular expression; each is kept when it is first used."""

    def __init__(self, pattern: Any, flags: int) -> None:
        self._source = (pattern, flags)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Regex, self._source

    def __getattr__(self, name: str) -> Any:
        value = getattr(re.compile(*self._source), name)
        setattr(self, name, value)
        return value
