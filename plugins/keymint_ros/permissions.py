# SPDX-License-Identifier: Apache-2.0
"""Reads ``permissions.xml``: the policy's rules for one subject as a document that a person can read and edit.

It has the rules of the intermediate representation in the vocabulary of ComArmor, flat and fully expanded. The root has
a digest of the policy's rules, so that manual edits are recognised without any other state, as dpkg does for
configuration files.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from urllib.parse import unquote

from lxml import etree

from comarmor.errors import Origin
from comarmor.language.attachments import strip
from comarmor.patterns.expression import parse as parse_expression
from comarmor.regex import lazy_regex
from comarmor.rules import Effect
from comarmor.values import dataclass
from comarmor.xml import reader
from comarmor.xml.includes import PACKAGE
from comarmor.xml.reader import line
from keymint.api.source_documents import Reader, place
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from keymint.names import name_of
from keymint_ros import certificate, placeholders
from keymint_ros.certificate import IssuedElement

OLD_FORMAT = "permissions-format"
"""Code of the error for a document in the format of 2018."""

_PLACEHOLDER = lazy_regex(r"@?\{\w+\}")
_OVERRIDES = ("domains", "subject_name", "validity")


@dataclass(frozen=True, slots=True)
class WrittenGrant:
    """The grant of a package.

    Attributes:
        name: the grant's label.
        own: what it says beside its rules, in place of the defaults.
        rules: the rules in order, with the origin that the document states, or their place in the document.
        places: the place of each rule in the document.
        base: digest of the policy's rules when the document was written; empty if it is not known.
        current: digest of the rules in the document.
        overrides: the XML elements that a person set to override the defaults.
    """

    name: str
    own: IssuedElement
    rules: tuple[Rule, ...]
    places: tuple[Origin, ...]
    base: str
    current: str
    overrides: tuple[str, ...]

    @property
    def edited(self) -> bool:
        """Whether the rules differ from those that the policy had when the document was written."""
        return self.base != self.current


def digest(rules: Iterable[Rule]) -> str:
    """Return the digest ``sha256:…`` of rules, independent of their order and their origins."""
    lines = sorted(
        [
            f"{rule.effect}\x1f{rule.kind}\x1f{'AUDIT' if rule.audit else ''}\x1f{_joined(rule.permissions)}"
            f"\x1f{_joined(rule.expressions)}\x1f{_joined(('', *rule.partitions))}"
            for rule in rules
        ]
    )
    return "sha256:" + hashlib.sha256("\n".join(dict.fromkeys(lines)).encode()).hexdigest()


def _joined(texts: tuple[str, ...]) -> str:
    return "\x1e".join(sorted(texts)) if len(texts) > 1 else texts[0] if texts else ""


def _old(content: bytes, name: str) -> Origin | None:
    """Return the place of a rule in a document of 2018, which has ``allow_rule`` and ``deny_rule``; else None.

    Raises:
        KeymintError: the document is not well-formed.
    """
    root = reader.parse(content, name)
    for tag in ("allow_rule", "deny_rule", "default"):
        if (element := root.find(f"permissions/grant/{tag}")) is not None and "format" not in root.attrib:
            return Origin(name, line(element))
    return None


def read(content: bytes, name: str, subject: str) -> WrittenGrant:
    """Return the grant of a ``permissions.xml``.

    Args:
        content: the document.
        name: its path, for messages.
        subject: its subject, for messages.

    Raises:
        KeymintError: the document is not valid, or in the format of 2018.
    """
    try:
        return _read(content, name)
    except KeymintError:
        old = _old(content, name)
        if old is None:
            raise
    raise KeymintError(
        "these permissions are in the format of 2018",
        where=old,
        help=f"'keymint create {name_of(subject)}' recreates them from the policy",
        code=OLD_FORMAT,
    )


def _grant(root: etree._Element) -> WrittenGrant:
    (grant,) = root.iterfind("permissions/grant")
    overrides = [part for part in grant if part.tag in _OVERRIDES]
    elements = [part for part in grant if part.tag not in _OVERRIDES]
    rules = tuple(map(_rule, elements))
    base, current = root.get("digest", "").strip(), digest(rules)
    if base != current:
        _check_edited(grant)
    return WrittenGrant(
        name=grant.get("name", "").strip(),
        own=certificate.read(grant, placeholders.SUBJECT),
        rules=rules,
        places=tuple(map(place, elements)),
        base=base,
        current=current,
        overrides=tuple(etree.tostring(part, encoding="unicode", with_tail=False) for part in overrides),
    )


_read = Reader("keymint_ros", "permissions", _grant)


def _rule(element: etree._Element) -> Rule:
    expressions, partitions, permissions = [], [], []
    for part in element:
        if part.tag == "attachment":
            expressions.append(strip(part.text or ""))
        elif part.tag == "permissions":
            permissions += [str(permission.tag) for permission in part]
        else:
            partitions += [strip(partition.text or "") for partition in part]
    return Rule(
        effect=Effect(element.get("qualifier", "").strip()),
        kind=str(element.tag),
        permissions=tuple(dict.fromkeys(permissions)),
        expressions=tuple(expressions),
        partitions=tuple(partitions),
        audit=element.get("modifier") is not None,
        origin=parse_origin(element.get("origin", "")) or place(element),
    )


def _check_edited(grant: etree._Element) -> None:
    """Check the expressions of an edited document; those of the policy were checked with the policy."""
    for tag in ("attachment", "partition"):
        for element in grant.iter(tag):
            expression = strip(element.text or "")
            if (not expression and tag == "attachment") or _PLACEHOLDER.search(expression):
                raise KeymintError(
                    "placeholders and tunables are expanded in this document"
                    if expression
                    else "the attachment is empty",
                    where=place(element),
                    help="write the full name or expression, e.g. /robot1/chatter",
                    code="expression-invalid",
                )
            try:
                parse_expression(expression)
            except KeymintError as error:
                (diagnostic,) = error.diagnostics
                raise KeymintError(
                    diagnostic.message,
                    where=place(element),
                    help=diagnostic.help or "expressions are those of POSIX fnmatch; '\\' escapes",
                    code="expression-invalid",
                ) from None


def has_rules(grant: WrittenGrant, rules: SubjectRules) -> bool:
    """Tell whether a document has exactly these rules in this order.

    Of their origins only the names of files count: folders depend on the current folder, and lines move with each
    line that is added to the policy above them.
    """
    if grant.edited or len(grant.rules) != len(rules.rules):
        return False
    return all(
        rule == replace(other, origin=rule.origin) and _files(rule.origin) == _files(other.origin)
        for rule, other in zip(grant.rules, rules.rules, strict=True)
    )


def _files(origin: Origin) -> list[str]:
    """Return the names of files, without their folders."""
    return [posixpath.basename(each.file) for each in (origin, *origin.chain)]


def to_ir(grant: WrittenGrant, subject: str, file: str, base: str) -> SubjectRules:
    """Return the rules of a document.

    The origin of a rule is its place in the policy, or in the document if the document was edited.

    Args:
        grant: the document.
        subject: the subject.
        file: the document's path, for messages.
        base: folder that origins are relative to.
    """
    rules = []
    for rule, spot in zip(grant.rules, grant.places, strict=True):
        own = grant.edited or rule.origin == spot
        rules.append(replace(rule, origin=Origin(file, spot.line) if own else origin_in_folder(base, rule.origin)))
    return SubjectRules(subject, tuple(rules))


@lru_cache(maxsize=4096)
def parse_origin(text: str) -> Origin | None:
    """Return the origin in a text ``file:line; file:line``, or None if it has another form."""
    places = []
    for item in text.split("; "):
        path, _, number = item.rpartition(":")
        if not path or not (number.isascii() and number.isdigit()):
            return None
        places.append(Origin(unquote(path, errors="surrogateescape") if "%" in path else path, int(number)))
    return replace(places[0], chain=tuple(places[1:]))


@lru_cache(maxsize=4096)
def origin_in_folder(base: str, origin: Origin) -> Origin:
    """Return an origin with its relative paths in a folder."""
    first, *chain = (
        Origin(each.file if each.file.startswith(("/", PACKAGE)) else posixpath.normpath(base + each.file), each.line)
        for each in (origin, *origin.chain)
    )
    return replace(first, chain=tuple(chain))
