# SPDX-License-Identifier: Apache-2.0
"""Writes ``permissions.xml``, the document of a subject's rules."""

from __future__ import annotations

import os.path
import re
from collections.abc import Iterable
from functools import lru_cache
from urllib.parse import quote

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from comarmor.xml.includes import PACKAGE
from keymint.ir import Rule, SubjectRules
from keymint_ros import permissions
from keymint_ros.permissions import digest

GRANT_LINE = 6
"""Line of the ``<grant>`` in a document."""

_UNSAFE = lazy_regex(r"[%;\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
_OVERRIDES = b"<domains", b"<subject_name", b"<validity"
_DIGEST = len(digest(()))
_SPECIAL = lazy_regex('[&<>"\r\n\t]')
_ENTITIES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#9;"}
)
_CHANGED = ("&", "> ", " </attachment>", " </partition>", 'origin=":', "; :")
"""What a document has, besides characters that are not printable ASCII, if reading may change a text or a place."""
_MOST_RENDERED = 1 << 14
_rendered: dict[bytes, tuple[SubjectRules, str]] = {}
"""Rules by the document that they were rendered to, for folders that origins are relative to."""


def render(rules: SubjectRules, base: str, *, name: str = "", overrides: Iterable[str] = ()) -> bytes:
    """Return the document of a subject's rules.

    Args:
        rules: the rules.
        base: folder that origins are relative to, ending in a slash; or empty.
        name: the grant's label; if empty, the subject is the label.
        overrides: XML of ``<domains>``, ``<subject_name>``, ``<validity>`` to keep.
    """
    head = "".join(f"      {element}\n" for element in overrides)
    chains: dict[int, str] = {}
    body = "".join([_rule(rule, base, chains) for rule in rules.rules])
    start, end = _head(rules.subject, name or rules.subject)
    document = f"{start}{digest(rules.rules)}{end}{head}{body}    </grant>\n  </permissions>\n</package>\n"
    content = document.encode()
    if not head and not name and _is_plain(body, rules):
        if len(_rendered) >= _MOST_RENDERED:
            _rendered.clear()
        _rendered[content] = rules, base
    return content


def _head(subject: str, name: str) -> tuple[str, str]:
    """Return what a document begins with before and after the digest of its rules."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!-- What the policy lets {subject} do. Edits are kept as long as the policy does not change as well;\n"
        "     <domains>, <subject_name> and <validity> at the top of the grant override the defaults, and stay. -->\n"
        '<package format="2" digest="'
    ), f'">\n  <permissions>\n    <grant name="{_text(name)}">\n'


def has_rules_only(content: bytes, subject: str) -> bool:
    """Tell whether a valid document begins as :func:`render` begins it, and overrides no defaults."""
    start, end = (part.encode() for part in _head(subject, subject))
    rest = content[len(start) + _DIGEST :]
    return content.startswith(start) and rest.startswith(end) and not any(each in rest for each in _OVERRIDES)


def _is_plain(body: str, rules: SubjectRules) -> bool:
    """Tell whether reading a document gives its rules without a change of their texts."""
    plain = body.isascii() and body.replace("\n", "").isprintable() and not any(text in body for text in _CHANGED)
    return plain and all(rule.expressions and rule.permissions for rule in rules.rules)


def rendered_rules(content: bytes, base: str) -> SubjectRules | None:
    """Return what reading a document of :func:`render` gives, from the rules that it was rendered from.

    Args:
        content: the document.
        base: folder that origins are relative to.

    Returns:
        The rules with the places that the document states, at the first call for a document; None if this process did
        not render it, or if reading it may give something else.
    """
    rules, base_then = _rendered.pop(content, (None, ""))
    if rules is None or base_then != base:
        return None
    chains: dict[int, tuple[Origin, ...]] = {}
    found = []
    for rule in rules.rules:
        at = rule.origin
        chain = chains.get(id(at.chain))
        if chain is None:  # rules of one file share theirs
            chain = chains[id(at.chain)] = tuple([Origin(_read_back(each.file, base), each.line) for each in at.chain])
        origin = Origin(_read_back(at.file, base), at.line, chain)
        found.append(
            Rule(rule.effect, rule.kind, rule.permissions, rule.expressions, rule.partitions, rule.audit, origin)
        )
    return SubjectRules(rules.subject, tuple(found))


@lru_cache(maxsize=1024)
def _read_back(file: str, base: str) -> str:
    """Return a file as the reader of a document names it."""
    origin = permissions.parse_origin(f"{_relative(file, base)}:0") or Origin(file)
    return permissions.origin_in_folder(base, origin).file


def _rule(rule: Rule, base: str, chains: dict[int, str]) -> str:
    audit = ' modifier="AUDIT"' if rule.audit else ""
    expressions = "".join([f"        <attachment>{_text(each)}</attachment>\n" for each in rule.expressions])
    partitions = "".join([f"<partition>{_text(each)}</partition>" for each in rule.partitions])
    partition_list = f"        <partitions>{partitions}</partitions>\n" if partitions else ""
    at = rule.origin
    chain = chains.get(id(at.chain))
    if chain is None:
        chain = chains[id(at.chain)] = "".join([f"; {_line(each, base)}" for each in at.chain])
    return (
        f'      <{rule.kind} qualifier="{rule.effect}"{audit} origin="{_text(_line(at, base) + chain)}">\n'
        f"{expressions}{partition_list}"
        f"        <permissions>{''.join([f'<{each}/>' for each in rule.permissions])}</permissions>\n"
        f"      </{rule.kind}>\n"
    )


def _line(place: Origin, base: str) -> str:
    return f"{_relative(place.file, base)}:{place.line}"


@lru_cache(maxsize=1024)
def _relative(file: str, base: str) -> str:
    """Return a path relative to a folder where the two paths alone allow it, with unsafe characters quoted."""
    if file.startswith(base):
        file = file.removeprefix(base)
    elif not file.startswith(("/", PACKAGE)) and not base.startswith("/"):
        file = os.path.relpath(file, base)
    return _UNSAFE.sub(_percent_encoded, file)


def _percent_encoded(match: re.Match[str]) -> str:
    return quote(match.group(), safe="", errors="surrogateescape")


def _text(text: str) -> str:
    return text.translate(_ENTITIES) if _SPECIAL.search(text) else text
