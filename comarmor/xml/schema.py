"""Holds XML against the project's XSDs, and says what is wrong in words a person can act on."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Diagnostic, Origin, Severity
from comarmor.text import did_you_mean, quoted
from comarmor.xml.reader import XINCLUDE, line, parse
from comarmor.xml.xsd import Vocabulary

_PREFIXES = {XINCLUDE: "xi:", "http://www.w3.org/XML/1998/namespace": "xml:"}
_MOST = 50
"""So many defects of one file are reported; a person mends the first ones first."""


@lru_cache
def _load(name: str) -> tuple[etree.XMLSchema, Vocabulary]:
    """Return an XSD, compiled, and the names that it knows."""
    path = locate("schemas") / name
    return etree.XMLSchema(file=str(path)), Vocabulary.of(parse(path.read_bytes(), str(path)))


def validate(root: etree._Element, schema: str, file: str, chain: tuple[Origin, ...] = ()) -> None:
    """Hold a document against a schema.

    Args:
        root: root element, from :func:`comarmor.language.source.parse`.
        schema: path of the XSD below the folder of schemas, e.g. ``comarmor/comarmor.xsd``.
        file: path of the document as the user would type it.
        chain: the places that include the document, innermost first.

    Raises:
        ComArmorError: the document is not valid; every defect with ``file:line``, what was expected, and a hint.
    """
    compiled, vocabulary = _load(schema)
    if compiled.validate(root):
        return
    found: dict[Diagnostic, None] = {}
    log: Any = compiled.error_log
    for entry in log:
        element = _element(root, entry.path)
        where = Origin(file, entry.line if element is None else line(element), chain)
        message, hint = _explain(entry.message, vocabulary, element)
        found[Diagnostic("schema", Severity.ERROR, message, where, hint)] = None
        if len(found) == _MOST:
            break
    raise ComArmorError.of(found)


def _element(root: etree._Element, path: str | None) -> etree._Element | None:
    """Return the element that an entry of the validator's log is about; its own line number is cut at 16 bits."""
    prefixes = {prefix: uri for prefix, uri in root.nsmap.items() if prefix}
    try:
        found: Any = root.getroottree().xpath(path, namespaces=prefixes) if path else []
    except etree.XPathError:
        return None
    return found[0] if found else None


_NAME = re.compile(r"\{([^}]*)\}([^\s',)]+)")


def _unexpected(found: re.Match[str], vocabulary: Vocabulary, element: etree._Element | None) -> tuple[str, str]:
    expected: Sequence[str] = found[2].split(", ") if found[2] else ()
    parent = None if element is None else element.getparent()
    if parent is not None and element is not None:
        expected = _with_exits(expected, element.getprevious(), parent, vocabulary)
    if parent is not None and not expected:  # libxml2 does not say where the element could also end
        expected = vocabulary.allowed_in(parent)
        if found[1] in expected:
            return f"<{found[1]}> is not expected here", "it stands in another place, or more often than it may"
    wanted = f"expected {_one_of(expected)}" if expected else "expected nothing more"
    help_ = did_you_mean(found[1], expected)
    if found[1].endswith("}include"):
        help_ = f'the namespace of xi:include is "{XINCLUDE}"'
    return f"<{found[1]}> is not expected here, {wanted}", help_


def _missing(found: re.Match[str], vocabulary: Vocabulary, element: etree._Element | None) -> tuple[str, str]:
    expected: Sequence[str] = found[2].split(", ")
    if element is not None and len(element) and element[-1].tag in expected:
        # What may be repeated is there already: what lacks is what follows it.
        expected = _with_exits(expected, element[-1], element, vocabulary)[len(expected) :] or expected
    return f"<{found[1]}> is not complete, expected {_one_of(expected)}", ""


def _with_exits(
    expected: Sequence[str], last: etree._Element | None, parent: etree._Element, vocabulary: Vocabulary
) -> Sequence[str]:
    """Return what is expected, with what may follow a repetition: there libxml2 says only how it can go on."""
    if last is None or last.tag not in expected:
        return expected
    allowed = vocabulary.allowed_in(parent)
    known = [allowed.index(name) for name in expected if name in allowed]
    return (*expected, *allowed[max(known, default=len(allowed)) + 1 :])


def _root(found: re.Match[str], vocabulary: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    roots = tuple(vocabulary.elements)
    return f"<{found[1]}> is not expected as the root, expected {_one_of(roots)}", did_you_mean(found[1], roots)


def _attribute(found: re.Match[str], vocabulary: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    return f"<{found[1]}> has the unknown attribute '{found[2]}'", did_you_mean(found[2], vocabulary.attributes)


def _required(found: re.Match[str], _v: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    return f"<{found[1]}> lacks its attribute '{found[2]}'", ""


def _enumeration(found: re.Match[str], _v: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    values = [value.strip("'") for value in found[4].split(", ")]
    return f"{_holder(found)} is {quoted(found[3])}, expected {' or '.join(values)}", did_you_mean(found[3], values)


def _short(found: re.Match[str], _v: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    least = int(found[4])
    if not int(found[3]):
        return f"{_holder(found)} is empty", ""
    return f"{_holder(found)} has {found[3]} characters, expected {least} or more", ""


def _simple(found: re.Match[str], _v: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    return f"<{found[1]}> can only hold text, not elements", ""


def _text(found: re.Match[str], _v: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    return f"<{found[1]}> cannot hold text", "remove the text, or put it into a comment"


def _value(found: re.Match[str], _v: Vocabulary, _e: etree._Element | None) -> tuple[str, str]:
    return f"{_holder(found)} is {quoted(found[3])}, which is not {found[4]}", ""


_QUOTED = re.compile(r"'([^']*)(?:'|\Z)")
"""A value in a message of libxml2, which cuts its messages where they grow too long."""

_Explanation = Callable[[re.Match[str], Vocabulary, Any], tuple[str, str]]

_EXPLANATIONS: tuple[tuple[re.Pattern[str], _Explanation], ...] = tuple(
    (re.compile(pattern, re.DOTALL), explanation)
    for pattern, explanation in (
        (r"Element '(.+?)': This element is not expected\.(?: Expected is (?:one of )?\( (.+) \)\.)?", _unexpected),
        (r"Element '(.+?)': Missing child element\(s\)\. Expected is (?:one of )?\( (.+) \)\.", _missing),
        (r"Element '(.+?)': No matching global declaration", _root),
        (r"Element '(.+?)', attribute '(.+?)': The attribute '.+' is not allowed", _attribute),
        (r"Element '(.+?)': The attribute '(.+?)' is required but missing", _required),
        (
            r"Element '(.+?)'(?:, attribute '(.+?)')?: \[.+?\] The value '(.*)' is not .+ set \{(.+)\}",
            _enumeration,
        ),
        (
            r"Element '(.+?)'(?:, attribute '(.+?)')?: \[facet 'minLength'\] .* length of '(\d+)'.* length of '(\d+)'",
            _short,
        ),
        (r"Element '(.+?)': Element content is not allowed", _simple),
        (r"Element '(.+?)': Character content", _text),
        (
            r"Element '(.+?)'(?:, attribute '(.+?)')?: (?:\[.+?\] The value )?'(.*)' is not (a valid .+|accepted .+)\.",
            _value,
        ),
    )
)
"""What libxml2 says, as patterns, and how it is said here. Groups: element, attribute, value, what was expected."""


def _explain(message: str, vocabulary: Vocabulary, element: etree._Element | None) -> tuple[str, str]:
    """Return a message of libxml2 as message and help of ours; one that is not known stays, but for long values."""
    message = _NAME.sub(lambda name: _PREFIXES.get(name[1], f"{{{name[1]}}}") + name[2], message)
    for pattern, explanation in _EXPLANATIONS:
        if found := pattern.match(message):
            return explanation(found, vocabulary, element)
    return _QUOTED.sub(lambda value: quoted(value[1]), " ".join(message.split())), ""


def _holder(found: re.Match[str]) -> str:
    return f"attribute '{found[2]}' of <{found[1]}>" if found[2] else f"<{found[1]}>"


def _one_of(names: Sequence[str]) -> str:
    return " or ".join(f"<{name}>" for name in names)
