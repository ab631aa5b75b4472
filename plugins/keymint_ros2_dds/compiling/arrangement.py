# SPDX-License-Identifier: Apache-2.0
"""Turn "deny overrides allow" into decision lists, in which the first matching block decides.

:func:`arrange` turns two unordered sets of patterns into ``allow free; deny; allow rest`` and drops patterns without
effect. :func:`early_rules` returns what must come first for implementations in which a rule for one direction also
decides about the other.
"""

from __future__ import annotations

from collections.abc import Iterable

from comarmor.patterns.glob import Glob, literal, matcher
from comarmor.patterns.relations import TooComplexError, covers, disjoint, intersection, maximal
from comarmor.patterns.steps import spend
from comarmor.values import Data

MAX_PIECES = 1000
"""Most patterns of early rules: a handshake could not carry a larger document."""


class Arrangement(Data):
    """A decision list: allow ``free``, then deny ``deny``, then allow ``rest``.

    Attributes:
        free: patterns that no denial overlaps; they may come anywhere.
        deny: patterns that overlap ``rest``.
        rest: patterns that a denial overlaps.
    """

    free: tuple[Glob, ...]
    deny: tuple[Glob, ...]
    rest: tuple[Glob, ...]


def arrange(allow: Iterable[Glob], deny: Iterable[Glob], *, reduced: bool = True) -> Arrangement:
    """Return the decision list that permits the names of ``allow`` without those of ``deny``.

    Args:
        allow: allowed patterns.
        deny: denied patterns.
        reduced: drop every pattern without effect; otherwise only denials that overlap no allowed pattern.
    """
    if not reduced:
        return _arrange_all(tuple(dict.fromkeys(allow)), tuple(dict.fromkeys(deny)))
    distinct = dict.fromkeys(allow)
    literals = [(text, glob) for glob in distinct if (text := literal(glob)) is not None]
    wild = [glob for glob in distinct if literal(glob) is None]
    if denied := tuple(deny):
        denied_names = {text for glob in denied if (text := literal(glob)) is not None}
        denies = [matcher(glob) for glob in denied if literal(glob) is None]
        spend(len(literals) * len(denies) // 8)
        literals = [
            (text, glob)
            for text, glob in literals
            if text not in denied_names and not any(matches(text) for matches in denies)
        ]
        wild = [glob for glob in wild if not any(covers(other, glob) for other in denied)]
    wild = maximal(wild)
    if wild:
        denied = tuple(maximal(d for d in denied if not all(disjoint(d, glob) for glob in wild)))
        allows = [matcher(glob) for glob in wild]
        spend(len(literals) * len(allows) // 8)
        literals = [pair for pair in literals if not any(matches(pair[0]) for matches in allows)]
    else:
        denied = ()
    rest = tuple(glob for glob in wild if not all(disjoint(glob, other) for other in denied))
    free = [glob for _, glob in literals] + [glob for glob in wild if glob not in rest]
    return Arrangement(tuple(free), denied, rest)


def _arrange_all(allow: tuple[Glob, ...], deny: tuple[Glob, ...]) -> Arrangement:
    """Return the decision list with every pattern, except denials that overlap no allowed pattern."""
    rest = tuple(glob for glob in allow if not all(disjoint(glob, other) for other in deny))
    overlapping = tuple(other for other in deny if not all(disjoint(glob, other) for glob in rest))
    in_rest = set(rest)
    return Arrangement(tuple(glob for glob in allow if glob not in in_rest), overlapping, rest)


def early_rules(denies: Iterable[Glob], order: Arrangement) -> Arrangement:
    """Return rules for every name that ``order`` permits and ``denies`` match, and for none that ``order`` denies.

    They must come before the denials of the other direction.

    Args:
        denies: patterns that the other direction denies.
        order: the decision list of this direction; its ``free`` part comes first anyway.

    Returns:
        The start of a decision list: no denial of this direction overlaps ``free``, and both directions deny what
        ``deny`` matches.

    Raises:
        TooComplexError: this needs too many patterns.
    """
    denies = tuple(denies)
    overlaps: dict[Glob, None] = {}
    for deny in denies:
        for glob in order.rest:
            overlaps.update(dict.fromkeys(intersection(glob, deny)))
        if len(overlaps) > MAX_PIECES:
            raise TooComplexError
    free: list[Glob] = []
    rest: list[Glob] = []
    overlapping: dict[Glob, None] = {}
    for piece in maximal(overlaps):
        if any(covers(glob, piece) for glob in (*order.free, *order.deny)):
            continue
        own_denials = [deny for deny in order.deny if not disjoint(deny, piece)]
        overlapping.update(dict.fromkeys(own_denials))
        (rest if own_denials else free).append(piece)
    # Both directions deny these names, so that denying them early does no harm, also outside of the rest.
    denied = {piece: None for own in overlapping for deny in denies for piece in intersection(own, deny)}
    if len(denied) > MAX_PIECES:
        raise TooComplexError
    return Arrangement(tuple(free), tuple(maximal(denied)), tuple(rest))
