# SPDX-License-Identifier: Apache-2.0
"""``permissions.xml``: the policy's rules for one subject as a document that a person can read and edit.

It has the rules of the intermediate representation in the vocabulary of ComArmor, flat and fully expanded. The root has
a digest of the policy's rules, so that manual edits are recognised without any other state, as dpkg does for
configuration files.
"""

from __future__ import annotations

import hashlib
import os.path
import posixpath
from collections.abc import Iterable
from functools import lru_cache, partial
from urllib.parse import quote, unquote

from lxml import etree

from comarmor.language.attachments import strip
from comarmor.patterns.expression import parse as parse_expression
from comarmor.rules import Effect
from comarmor.text import lazy_regex
from comarmor.values import Data, replace
from comarmor.xml import reader
from comarmor.xml.reader import line
from comarmor.xml.sandboxed_paths import PACKAGE
from keymint.api.source_documents import Reader, place
from keymint.errors import KeymintError, Origin
from keymint.ir import Kind, Rule, SubjectRules, once_of_kind
from keymint.names import name_of
from keymint_ros import certificate
from keymint_ros.certificate import IssuedElement

OLD_FORMAT = "permissions-format"
"""Code of the error for a document in the format of 2018."""

_PLACEHOLDER = lazy_regex(r"@?\{\w+\}")
_OVERRIDES = ("domains", "subject_name", "validity")


class WrittenGrant(Data):
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
    around = (
        (each.expressions, _line(each.effect, each.kind, each.permissions, each.partitions, audited=each.audit))
        for each in rules
    )
    return _digest_of([f"{start}{_joined(expressions)}{end}" for expressions, (start, end) in around])


def _digest_of(lines: list[str]) -> str:
    return "sha256:" + hashlib.sha256("\n".join(dict.fromkeys(sorted(lines))).encode()).hexdigest()


def _line(
    effect: Effect, kind: str, permissions: tuple[str, ...], partitions: tuple[str, ...], *, audited: bool
) -> tuple[str, str]:
    """Return what a digest has of a rule, before its expressions and after them."""
    start = f"{effect}\x1f{kind}\x1f{'AUDIT' if audited else ''}\x1f{_joined(permissions)}\x1f"
    return start, f"\x1f{_joined(('', *partitions))}"


def _joined(texts: tuple[str, ...]) -> str:
    return "\x1e".join(sorted(texts)) if len(texts) > 1 else texts[0] if texts else ""


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
        root = reader.parse(content, name)
        found = (root.find(f"permissions/grant/{tag}") for tag in ("allow_rule", "deny_rule", "default"))
        old = next((each for each in found if each is not None), None)
        if old is None or "format" in root.attrib:
            raise
    message = "these permissions are in the format of 2018"
    help_ = f"'keymint create {name_of(subject)}' recreates them from the policy"
    raise KeymintError(message, where=Origin(name, line(old)), help=help_, code=OLD_FORMAT)


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
        own=certificate.read(grant, certificate.SUBJECT_PLACEHOLDERS),
        rules=rules,
        places=tuple(map(place, elements)),
        base=base,
        current=current,
        overrides=tuple(etree.tostring(part, encoding="unicode", with_tail=False) for part in overrides),
    )


_read = Reader("keymint_ros", "permissions", _grant, ("rights_documents", "package"))


def _rule(element: etree._Element) -> Rule:
    permissions = (str(each.tag) for part in element.iterchildren("permissions") for each in part)
    return Rule(
        effect=Effect(element.get("qualifier", "").strip()),
        kind=str(element.tag),
        permissions=tuple(dict.fromkeys(permissions)),
        expressions=tuple(strip(each.text or "") for each in element.iterchildren("attachment")),
        partitions=tuple(strip(each.text or "") for part in element.iterchildren("partitions") for each in part),
        audit=element.get("modifier") is not None,
        origin=parse_origin(element.get("origin", "")) or place(element),
    )


def _check_edited(grant: etree._Element) -> None:
    """Check the expressions of an edited document; those of the policy were checked with the policy."""
    for tag in ("attachment", "partition"):
        for element in grant.iter(tag):
            expression, message = strip(element.text or ""), ""
            help_ = "write the full name or expression, e.g. /robot1/chatter"
            if not expression and tag == "attachment":
                message = "the attachment is empty"
            elif _PLACEHOLDER.search(expression):
                message = "placeholders and tunables are expanded in this document"
            else:
                try:
                    parse_expression(expression)
                except KeymintError as error:
                    message = error.diagnostics[0].message
                    help_ = error.diagnostics[0].help or "expressions are those of POSIX fnmatch; '\\' escapes"
            if message:
                raise KeymintError(message, where=place(element), help=help_, code="expression-invalid")


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
    return origin.with_files(lambda file: file if file.startswith(("/", PACKAGE)) else posixpath.normpath(base + file))


# -- writing --------------------------------------------------------------------------------------------------------

GRANT_LINE = 6
"""Line of the ``<grant>`` in a document."""

_UNSAFE = lazy_regex(r"[%;\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
_DIGEST = len(digest(()))
_ENTITIES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#9;"}
)
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
    files: dict[str, str] = {}
    elements, lines = list[str](), list[str]()
    texts = "".join([text for rule in rules.rules for text in (*rule.expressions, *rule.partitions)])
    is_plain = _is_plain(texts) and " " not in texts
    for rule, (begin, rest, before, after) in zip(rules.rules, _around_expressions(rules.kind[0]), strict=True):
        at, own = rule.origin, rule.expressions
        chain = chains.get(id(at.chain))
        if chain is None:
            chain = chains[id(at.chain)] = "".join([f"; {_place(each.file, base)}:{each.line}" for each in at.chain])
        file = files.get(at.file) or files.setdefault(at.file, _place(at.file, base))
        lines.append(f"{before}{_joined(own)}{after}")
        expressions = "</attachment>\n        <attachment>".join(own if is_plain else map(_text, own))
        attachments = f"        <attachment>{expressions}</attachment>\n" if own else ""
        elements.append(f'{begin}{file}:{at.line}{chain}">\n{attachments}{rest}')
    start, end = _head(rules.subject, name or rules.subject)
    body = "".join(elements)
    document = f"{start}{_digest_of(lines)}{end}{head}{body}    </grant>\n  </permissions>\n</package>\n"
    content = document.encode()
    places = "".join((*files.values(), *chains.values()))
    has_places = all(files.values()) and "; :" not in places and _is_plain(places)
    is_usual = not head and not name and all(rule.expressions and rule.permissions for rule in rules.rules)
    if is_plain and has_places and is_usual:
        # Reading the document gives its rules without a change of their texts.
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
    return (
        content.startswith(start) and rest.startswith(end) and not any(f"<{tag}".encode() in rest for tag in _OVERRIDES)
    )


def rendered_rules(content: bytes, base: str) -> SubjectRules | None:
    """Return what reading a document of :func:`render` gives, from the rules that it was rendered from.

    Args:
        content: the document.
        base: folder that origins are relative to.

    Returns:
        The rules with the places that the document states, at the first call for a document; None if this process did
        not render it, or if reading it may give something else. Only a message needs the places.
    """
    rules, base_then = _rendered.pop(content, (None, ""))
    if rules is None or base_then != base:
        return None
    return SubjectRules(rules.subject, partial(_as_read, rules.rules, base), rules.kind)


def _as_read(rules: Iterable[Rule], base: str) -> tuple[Rule, ...]:
    """Return rules with the places that their document states."""
    chains: dict[int, tuple[Origin, ...]] = {}
    found = []
    for rule in rules:
        at = rule.origin
        chain = chains.get(id(at.chain))
        if chain is None:  # rules of one file share theirs
            chain = chains[id(at.chain)] = tuple([Origin(_read_back(each.file, base), each.line) for each in at.chain])
        origin = Origin(_read_back(at.file, base), at.line, chain)
        found.append(
            Rule(rule.effect, rule.kind, rule.permissions, rule.expressions, rule.partitions, rule.audit, origin)
        )
    return tuple(found)


@lru_cache(maxsize=1024)
def _read_back(file: str, base: str) -> str:
    """Return a file as the reader of a document names it."""
    origin = parse_origin(f"{_relative(file, base)}:0") or Origin(file)
    return origin_in_folder(base, origin).file


@once_of_kind
def _around_expressions(kind: Kind) -> list[tuple[str, str, str, str]]:
    """Return of each rule its element up to its places, and from its partitions on; and its line in a digest."""
    found = []
    for effect, of, permissions, _, listed, audited in kind:
        audit = ' modifier="AUDIT"' if audited else ""
        partitions = "".join([f"<partition>{_text(each)}</partition>" for each in listed])
        partition_list = f"        <partitions>{partitions}</partitions>\n" if partitions else ""
        permission_list = "".join([f"<{each}/>" for each in permissions])
        start = f'      <{of} qualifier="{effect}"{audit} origin="'
        end = f"{partition_list}        <permissions>{permission_list}</permissions>\n      </{of}>\n"
        found.append((start, end, *_line(effect, of, permissions, listed, audited=audited)))
    return found


@lru_cache(maxsize=1024)
def _place(file: str, base: str) -> str:
    """Return a file as the attribute of a place has it."""
    return _text(_relative(file, base))


@lru_cache(maxsize=1024)
def _relative(file: str, base: str) -> str:
    """Return a path relative to a folder where the two paths alone allow it, with unsafe characters quoted."""
    if file.startswith(base):
        file = file.removeprefix(base)
    elif not file.startswith(("/", PACKAGE)) and not base.startswith("/"):
        file = os.path.relpath(file, base)
    if file.isprintable() and "%" not in file and ";" not in file:
        return file
    return _UNSAFE.sub(lambda match: quote(match.group(), safe="", errors="surrogateescape"), file)


def _text(text: str) -> str:
    return text.translate(_ENTITIES)


def _is_plain(text: str) -> bool:
    """Tell whether a text is written as it is, and no reader changes it in an attribute."""
    return text.isascii() and text.isprintable() and not any(each in text for each in '&<>"')
