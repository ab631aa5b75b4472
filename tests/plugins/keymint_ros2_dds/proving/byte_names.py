# SPDX-License-Identifier: Apache-2.0
"""Claims about names of all bytes, compared with the matchers that vendors call, over all short names.

In full: ``python -m tests.plugins.keymint_ros2_dds.proving.byte_names 20000``.
"""

from __future__ import annotations

import ctypes
import locale
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import product
from xml.sax.saxutils import escape

from keymint_ros2_dds.proving.claims import assumptions, prove_content
from keymint_ros2_dds.vendors import probe_builds

from keymint.api import Claim, ComparisonTask, Proof
from keymint.errors import KeymintError
from keymint.host.vendor_process import MissingVendorError
from keymint.ir import SubjectRules
from tests.plugins.keymint_ros2_dds.decision.cyclone_matcher import ac_fnmatch
from tests.plugins.keymint_ros2_dds.packages import DOMAIN, rule

NAME_PIECES = (
    b"a", b"b", b"c", b"]", b"\\", b"[", b"!", b"-", b"*", b"\x01", b"\n", b" ", b"\x7f", b"\xc3", b"\xa9", b"\xff",
    "é".encode(),
)  # fmt: skip
NAMES = tuple(dict.fromkeys(b"".join(word) for length in (1, 2, 3) for word in product(NAME_PIECES, repeat=length)))
ASCII = (
    "a", "b", "c", "a", "b", "*", "?", "*", "?", "[ab]", "[!a]", "[!b-c]", "[a-b]", "]", "-", "!", "\x7f",
)  # fmt: skip
ODD = (
    "\\", "\\\\", "\\*", "[", "[^a]", "[!]a]", "[]a]", "[\\]", "[!\\]", "[!-~]", "[[:alpha:]]", "[A-Za-z]",
    "[a]-", " ", "\t", "\n",
)  # fmt: skip
LITERAL = ("a", "b", "c", "é", "ç", "*", "-", "]", "\\", "\x7f")
BEYOND = ("é", "ç", "[é]", "[!é]", "[a-é]", "a", "*")
PALETTES = (ASCII, (*ASCII, *ODD), LITERAL, (*ASCII, *LITERAL), (*ASCII, *ODD, *BEYOND))
"""Pieces of expressions; where a set stands beside characters beyond ASCII most is unknown."""
NOESCAPE = 2
_ASCII = sum(1 << at for at, name in enumerate(NAMES) if name.isascii())
_libc = ctypes.CDLL(None)
_UTF8 = "C.UTF-8"


@dataclass(frozen=True)
class Case:
    """A policy and a document to compare with it: expressions of ``topic`` rules about publishing."""

    denied: tuple[str, ...]
    allowed: tuple[str, ...]
    document: tuple[tuple[bool, tuple[str, ...]], ...]

    def content(self) -> bytes:
        rules = "".join(
            f"<{kind}><domains><id>0</id></domains><publish><topics>"
            + "".join(f"<topic>{escape(each)}</topic>" for each in expressions)
            + f"</topics></publish></{kind}>\n"
            for allows, expressions in self.document
            for kind in ["allow_rule" if allows else "deny_rule"]
            if expressions
        )
        return (
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            '<dds><permissions><grant name="g"><subject_name>CN=/t</subject_name><validity>'
            "<not_before>2020-01-01T00:00:00</not_before><not_after>2036-01-01T00:00:00</not_after></validity>"
            f"{rules}<default>DENY</default></grant></permissions></dds>\n"
        ).encode()

    def is_plain(self) -> bool:
        """Tell whether nothing in the expressions stands for one character."""
        every = (*self.denied, *self.allowed, *(each for _, listed in self.document for each in listed))
        return not any(set(each) & set("?[") for each in every)

    def claims(self) -> tuple[Claim, ...]:
        """Return the claims about publishing.

        Raises:
            KeymintError: an expression of the policy means nothing.
        """
        rules = [rule("DENY", "topic", "publish", *self.denied)] if self.denied else []
        rules.append(rule("ALLOW", "topic", "publish", *self.allowed))
        policy = SubjectRules("/t", tuple(rules))
        task = ComparisonTask(
            self.content(), "permissions.xml", 0, "CN=/t", policy, "humble", DOMAIN, 200_000, lambda: True
        )
        found = prove_content(task)
        return tuple(claim for claim in found if claim.action == "publish")


def cases(seed: int) -> Iterator[Case]:
    """Yield cases without end: a document that says what the policy says, and then often not quite."""
    chance = random.Random(seed)
    palette = ASCII

    def expression() -> str:
        text = ""
        while not text.strip():
            text = "".join(chance.choice(palette) for _ in range(chance.randint(1, 3)))
        return text

    while True:
        palette = chance.choice(PALETTES)
        denied = tuple(expression() for _ in range(chance.choice((0, 0, 1, 2))))
        allowed = tuple(expression() for _ in range(chance.randint(1, 3)))
        document = [(False, denied), (True, allowed)]
        edit = chance.randrange(6)
        if edit == 0:
            document.append((True, (expression(),)))
        elif edit == 1:
            document[1] = (True, (*allowed, expression()))
        elif edit == 2:
            document[1] = (True, (*allowed[1:], expression()))
        elif edit == 3:
            document.reverse()
        yield Case(denied, allowed, tuple(document))


@contextmanager
def process_locale(name: str) -> Iterator[None]:
    """Put the process in a locale for a while."""
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_ALL, name)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)


def _mask(matches: Callable[[bytes], bool]) -> int:
    return sum(1 << at for at, name in enumerate(NAMES) if matches(name))


@cache
def by_libc(expression: str, flags: int, where: str) -> int:
    """Return the names that the C library's matcher lets an expression match, as a set of bits."""
    with process_locale(where):
        return _mask(lambda name: _libc.fnmatch(expression.encode(), name, flags) == 0)


@cache
def by_cyclone(expression: str) -> int:
    """Return the same of the matcher of Cyclone DDS, which trims what it reads."""
    text = expression.strip(" \t\v\r\n").encode()
    return _mask(lambda name: ac_fnmatch(text, name))


def permitted(case: Case, by: Callable[[str], int]) -> int:
    """Return the names that a document permits: the first rule that matches decides."""
    allowed = decided = 0
    for allows, expressions in case.document:
        here = 0
        for expression in expressions:
            here |= by(expression)
        if allows:
            allowed |= here & ~decided
        decided |= here
    return allowed


def wanted(case: Case, where: str) -> int:
    """Return the names that the policy allows: a denial overrides, and classes are those of the C locale."""
    allowed = denied = 0
    for expression in case.allowed:
        allowed |= by_libc(expression.replace("[:alpha:]", "A-Za-z"), 0, where)
    for expression in case.denied:
        denied |= by_libc(expression.replace("[:alpha:]", "A-Za-z"), 0, where)
    return allowed & ~denied


def readings(*, cyclone: bool) -> dict[str, tuple[tuple[str, Callable[[str], int]], ...]]:
    """Return, by model, the locales in which it is held to its claims, and its matcher there."""
    both = [where for where in ("C", _UTF8) if _has(where)]
    found = {
        "omg": tuple((where, lambda each, where=where: by_libc(each, 0, where)) for where in both),
        "fastdds-2.9": tuple((where, lambda each, where=where: by_libc(each, NOESCAPE, where)) for where in both),
    }
    return found | ({"cyclonedds-0.10": (("C", by_cyclone),)} if cyclone else {})


def _has(where: str) -> bool:
    try:
        with process_locale(where):
            return True
    except locale.Error:
        return False


def run(count: int, seed: int, *, cyclone: bool) -> Counter[str]:
    """Hold the claims about so many cases against brute force; return how they stood, by model.

    Raises:
        AssertionError: a claim is proven of a document that some name refutes, or refuted without cause.
    """
    found: Counter[str] = Counter()
    models = readings(cyclone=cyclone)
    assert set(models) <= set(assumptions())
    drawn = cases(seed)
    while found["cases"] < count:
        case = next(drawn)
        try:
            claims = case.claims()
        except KeymintError:
            continue  # no policy: an expression that means nothing
        found["cases"] += 1
        for claim in claims:
            for where, by in models.get(claim.model, ()):
                differing = permitted(case, by) ^ wanted(case, where)
                # Elsewhere than in the C locale, "?" and sets of glibc stand for a byte or a character.
                _hold(case, claim, differing if where == "C" or case.is_plain() else differing & _ASCII, where)
            found[f"{claim.model} {claim.proof}"] += claim.model in models
    return found


def _hold(case: Case, claim: Claim, differing: int, where: str) -> None:
    if claim.proof is Proof.PROVEN:
        names = [name for at, name in enumerate(NAMES) if differing >> at & 1]
        assert not names, (case, claim.model, where, names[:3])
    elif claim.counterexample is not None and where == "C":
        name = claim.counterexample.endpoint.name.encode("utf-8", "surrogateescape")
        shorter = [each for at, each in enumerate(NAMES) if differing >> at & 1 and len(each) < len(name)]
        assert not shorter, (case, claim.model, name, shorter[:3])
        if name in NAMES:
            assert differing >> NAMES.index(name) & 1, (case, claim.model, name)


def has_cyclone() -> bool:
    """Tell whether the plugin of Cyclone DDS is here."""
    try:
        probe_builds.require_cyclone_plugins()
    except MissingVendorError:
        return False
    return True


if __name__ == "__main__":
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    for kind, times in sorted(run(number, 8, cyclone=has_cyclone()).items()):
        sys.stdout.write(f"{times:>8,} {kind}\n")
    sys.stdout.write(f"each compared with {len(NAMES):,} names: nothing is proven that a name refutes\n")
