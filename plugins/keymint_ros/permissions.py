"""``permissions.xml``: the policy's rules for one subject as a document that a person can read and edit.

It is the intermediate representation in the vocabulary of ComArmor, flat and fully expanded. The root carries a digest
of the rules as the policy said them, so that an edit by hand is recognised without any other state, in the way that
dpkg recognises an edited configuration file.
"""

from __future__ import annotations

import hashlib
import posixpath
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING
from urllib.parse import unquote

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import strip
from comarmor.patterns.expression import parse as parse_expression
from comarmor.rules import Effect
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from keymint_ros import document, placeholders, validity
from keymint_ros.document import Reader, line, place
from keymint_ros.governance import domains

if TYPE_CHECKING:
    from keymint.api import DomainRange, Validity

OLD_FORMAT = "permissions-format"
"""Code of the error that a document of the format of 2018 is."""

_EFFECTS = {effect.value: effect for effect in Effect}
_PLACEHOLDER = re.compile(r"@?\{\w+\}")
_OVERRIDES = ("domains", "subject_name", "validity")


@dataclass(frozen=True, slots=True)
class WrittenRule:
    """A rule of the document: the fields of :class:`keymint.ir.Rule`, its line, and the origin as it is written."""

    effect: Effect
    kind: str
    permissions: tuple[str, ...]
    expressions: tuple[str, ...]
    partitions: tuple[str, ...]
    audit: bool
    line: int
    origin: str


@dataclass(frozen=True, slots=True)
class Grant:
    """What the document says.

    Attributes:
        line: line of the grant.
        name: the grant's label.
        domains: empty where the defaults apply.
        subject_name: distinguished name, with placeholders; None where the default applies, as for the validity.
        validity: period of the grant.
        rules: the rules in order.
        base: digest of the rules that the policy said when the document was written; empty if that is not known.
        current: digest of the rules as they were read.
        overrides: the XML of what a person set in place of the defaults.
    """

    line: int
    name: str
    domains: tuple[DomainRange, ...]
    subject_name: str | None
    validity: Validity | None
    rules: tuple[WrittenRule, ...]
    base: str
    current: str
    overrides: tuple[str, ...]

    @property
    def edited(self) -> bool:
        """Whether the rules are no longer those that the policy said."""
        return self.base != self.current


def digest(rules: Iterable[Rule | WrittenRule]) -> str:
    """Return ``sha256:…`` of what rules mean: without their order and without where they come from."""
    lines = sorted(
        "\x1f".join(
            (
                rule.effect,
                rule.kind,
                "AUDIT" if rule.audit else "",
                "\x1e".join(sorted(rule.permissions)),
                "\x1e".join(sorted(rule.expressions)),
                "\x1e".join(["", *sorted(rule.partitions)]),
            )
        )
        for rule in rules
    )
    return "sha256:" + hashlib.sha256("\n".join(dict.fromkeys(lines)).encode()).hexdigest()


def _old(content: bytes, name: str) -> Origin | None:
    """Return where the grant of a document of 2018 is, with ``allow_rule`` and ``deny_rule``; None for any other one.

    Raises:
        KeymintError: it is not well-formed.
    """
    root = document.parse(content, name)
    for tag in ("allow_rule", "deny_rule", "default"):
        if (found := root.find(f"permissions/grant/{tag}")) is not None and "format" not in root.attrib:
            return Origin(name, line(found))
    return None


def read(content: bytes, name: str, subject: str) -> Grant:
    """Return what a ``permissions.xml`` says.

    Args:
        content: the document.
        name: its path as the user would type it.
        subject: the subject it is about, for messages.

    Raises:
        KeymintError: it is not valid, or in the format of 2018.
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
        help=f"'keymint create {subject.removeprefix('/')}' recreates them from the policy",
        code=OLD_FORMAT,
    )


def _grant(root: etree._Element) -> Grant:
    (grant,) = root.iterfind("permissions/grant")
    own = {part.tag: part for part in grant if part.tag in _OVERRIDES}
    rules = tuple(_rule(rule) for rule in grant if rule.tag not in _OVERRIDES)
    base, current = root.get("digest", "").strip(), digest(rules)
    if base != current:
        _check_edited(grant)
    return Grant(
        line=line(grant),
        name=grant.get("name", "").strip(),
        domains=domains(own.get("domains")),
        subject_name=placeholders.read(own.get("subject_name"), placeholders.SUBJECT),
        validity=validity.read(own.get("validity")),
        rules=rules,
        base=base,
        current=current,
        overrides=tuple(etree.tostring(part, encoding="unicode", with_tail=False) for part in own.values()),
    )


_read = Reader("permissions", _grant)


def _rule(element: etree._Element) -> WrittenRule:
    expressions, partitions, permissions = [], [], []
    for part in element:
        if part.tag == "attachment":
            expressions.append(strip(part.text or ""))
        elif part.tag == "permissions":
            permissions += [str(permission.tag) for permission in part]
        else:
            partitions += [strip(partition.text or "") for partition in part]
    return WrittenRule(
        effect=_EFFECTS[element.get("qualifier", "").strip()],
        kind=str(element.tag),
        permissions=tuple(dict.fromkeys(permissions)),
        expressions=tuple(expressions),
        partitions=tuple(partitions),
        audit=element.get("modifier") is not None,
        line=line(element),
        origin=element.get("origin", ""),
    )


def _check_edited(grant: etree._Element) -> None:
    """Check the expressions that a person wrote; those of the policy were checked with it."""
    for tag in ("attachment", "partition"):
        for element in grant.iter(tag):
            expression = strip(element.text or "")
            if (not expression and tag == "attachment") or _PLACEHOLDER.search(expression):
                raise KeymintError(
                    "placeholders and tunables are expanded in this document"
                    if expression
                    else "the attachment is empty",
                    where=place(element),
                    help="write the whole name or expression, e.g. /robot1/chatter",
                    code="expression-invalid",
                )
            try:
                parse_expression(expression)
            except (ComArmorError, ValueError) as error:
                said = error.diagnostics[0] if isinstance(error, ComArmorError) else None
                raise KeymintError(
                    said.message if said else str(error),
                    where=place(element),
                    help=(said.help if said else "") or "expressions are those of POSIX fnmatch; '\\' escapes",
                    code="expression-invalid",
                ) from None


def says(grant: Grant, rules: SubjectRules) -> bool:
    """Tell whether a document has exactly these rules in this order, as far as a reader sees.

    The folders of their origins do not count: they depend on where the tool is called.
    """
    if grant.edited or len(grant.rules) != len(rules.rules):
        return False
    return all(
        (one.effect, one.kind, one.permissions, one.expressions, one.partitions, one.audit)
        == (other.effect, other.kind, other.permissions, other.expressions, other.partitions, other.audit)
        and _spots(_origin(one.origin, "")) == _spots(other.origin)
        for one, other in zip(grant.rules, rules.rules, strict=True)
    )


def _spots(origin: Origin | None) -> list[tuple[str, int]]:
    """Return names of files, without their folders, and lines."""
    return [] if origin is None else [(posixpath.basename(one.file), one.line) for one in (origin, *origin.chain)]


def to_ir(grant: Grant, subject: str, file: str, base: str) -> SubjectRules:
    """Return the rules of a document.

    Rules that a person edited come from the document itself; others from where the policy says them.

    Args:
        grant: the document.
        subject: the subject.
        file: the document's path as the user would type it.
        base: folder that origins are relative to.
    """
    edited = grant.edited
    return SubjectRules(
        subject,
        tuple(
            Rule(
                rule.effect,
                rule.kind,
                rule.permissions,
                rule.expressions,
                rule.partitions,
                rule.audit,
                (not edited and _origin(rule.origin, base)) or Origin(file, rule.line),
            )
            for rule in grant.rules
        ),
    )


@lru_cache(maxsize=4096)
def _origin(written: str, base: str) -> Origin | None:
    """Return the origin that ``file:line; file:line`` says, or None when it does not say one."""
    places = []
    for item in written.split("; "):
        path, _, number = item.rpartition(":")
        if not path or not (number.isascii() and number.isdigit()):
            return None
        plain = unquote(path, errors="surrogateescape") if "%" in path else path
        places.append((plain if plain.startswith("/") else posixpath.normpath(base + plain), int(number)))
    chain = tuple(Origin(*one) for one in places[1:])
    return Origin(*places[0], chain)
