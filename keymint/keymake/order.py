"""Deny overrides allow, said as a list in which the first match decides.

:func:`arrange` turns two unordered sets of patterns into ``allow free; deny; allow rest`` and leaves out what has no
effect. :func:`early_rules` finds what must be said earlier for readers that let a rule about one direction
decide for the other, too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.matching import matcher
from comarmor.patterns.relations import TooComplexError, covers, disjoint, intersection, maximal
from comarmor.patterns.steps import spend

MAX_PIECES = 1000
"""Patterns that may be needed to say what must be said first; beyond, no handshake would carry the document."""


@dataclass(frozen=True, slots=True)
class Arrangement:
    """A decision list: allow ``free``, then deny ``deny``, then allow ``rest``, else deny.

    Attributes:
        free: patterns that no deny touches; they may stand anywhere.
        deny: patterns that take something away from ``rest``.
        rest: patterns that a deny touches.
    """

    free: tuple[Glob, ...]
    deny: tuple[Glob, ...] = ()
    rest: tuple[Glob, ...] = ()


def arrange(allow: Iterable[Glob], deny: Iterable[Glob], *, reduced: bool = True) -> Arrangement:
    """Return the decision list that permits the names of ``allow`` without those of ``deny``.

    Args:
        allow: patterns of what is allowed.
        deny: patterns of what is denied.
        reduced: leave out every pattern without which the list means the same; else only denials that touch nothing.
    """
    if not reduced:
        return _in_full(tuple(dict.fromkeys(allow)), tuple(dict.fromkeys(deny)))
    literals: list[tuple[str, Glob]] = []
    wild: list[Glob] = []
    for glob in dict.fromkeys(allow):
        text = literal(glob)
        if text is None:
            wild.append(glob)
        else:
            literals.append((text, glob))
    if denied := tuple(deny):
        exact = {text for glob in denied if (text := literal(glob)) is not None}
        refuse = [matcher(glob) for glob in denied if literal(glob) is None]
        spend(len(literals) * len(refuse) // 8)
        literals = [
            (text, glob)
            for text, glob in literals
            if text not in exact and not any(refused(text) for refused in refuse)
        ]
        wild = [glob for glob in wild if not any(covers(other, glob) for other in denied)]
    wild = maximal(wild)
    if wild:
        denied = tuple(maximal(d for d in denied if not all(disjoint(d, glob) for glob in wild)))
        accept = [matcher(glob) for glob in wild]
        spend(len(literals) * len(accept) // 8)
        literals = [pair for pair in literals if not any(accepted(pair[0]) for accepted in accept)]
    else:
        denied = ()
    rest = tuple(glob for glob in wild if not all(disjoint(glob, other) for other in denied))
    free = [glob for _, glob in literals] + [glob for glob in wild if glob not in rest]
    return Arrangement(tuple(free), denied, rest)


def _in_full(allow: tuple[Glob, ...], deny: tuple[Glob, ...]) -> Arrangement:
    rest = tuple(glob for glob in allow if not all(disjoint(glob, other) for other in deny))
    touching = tuple(other for other in deny if not all(disjoint(glob, other) for glob in rest))
    touched = set(rest)
    return Arrangement(tuple(glob for glob in allow if glob not in touched), touching, rest)


@dataclass(frozen=True, slots=True)
class EarlyRules:
    """What must be allowed before the denials of the other direction are read.

    Attributes:
        clean: patterns that no denial of their own direction touches.
        deny: what is to be denied just before ``dirty`` is allowed; the other direction denies it as well.
        dirty: patterns that ``deny`` punctures.
    """

    clean: tuple[Glob, ...] = ()
    deny: tuple[Glob, ...] = ()
    dirty: tuple[Glob, ...] = ()


def early_rules(denies: Iterable[Glob], order: Arrangement) -> EarlyRules:
    """Return patterns for every name that ``order`` permits and that ``denies`` match, and for none that it denies.

    Args:
        denies: patterns that the other direction denies.
        order: what is permitted in this direction; its ``free`` part is said before anything else anyway.

    Raises:
        TooComplexError: the patterns would be too many.
    """
    denies = tuple(denies)
    found: dict[Glob, None] = {}
    for deny in denies:
        for glob in order.rest:
            found.update(dict.fromkeys(intersection(glob, deny)))
        if len(found) > MAX_PIECES:
            raise TooComplexError
    clean: list[Glob] = []
    dirty: list[Glob] = []
    touching: dict[Glob, None] = {}
    for piece in maximal(found):
        if any(covers(glob, piece) for glob in (*order.free, *order.deny)):
            continue
        touched = [deny for deny in order.deny if not disjoint(deny, piece)]
        touching.update(dict.fromkeys(touched))
        (dirty if touched else clean).append(piece)
    # Both directions deny these, so that it does no harm to deny them early, also beside the dirty pieces.
    punctures = {piece: None for own in touching for deny in denies for piece in intersection(own, deny)}
    if len(punctures) > MAX_PIECES:
        raise TooComplexError
    return EarlyRules(tuple(clean), tuple(maximal(punctures)), tuple(dirty))
