"""What a person may have meant by a word that is not known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(text: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return ``did you mean X?`` for the known word that is nearest, or what is known (and otherwise possible)."""
    words = {word.lower(): word for word in known}
    close = difflib.get_close_matches(text.lower(), words, 1)
    if close:
        return f"did you mean {words[close[0]]}?"
    return f"known are {', '.join(words.values())}" + (f" {otherwise}" if otherwise else "")
