# SPDX-License-Identifier: Apache-2.0
"""Explains each violation of an XSD: where, what was expected, how to fix it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from lxml import etree

from comarmor.errors import Diagnostic, Origin
from comarmor.text import did_you_mean, lazy_regex, quote
from comarmor.xml.reader import XINCLUDE, line_in, parse

XS = "{http://www.w3.org/2001/XMLSchema}"
_PREFIXES = {XINCLUDE: "xi:", "http://www.w3.org/XML/1998/namespace": "xml:"}
_MOST = 50
"""Violations of one file that are reported at most."""


class SchemaVocabulary:
    """The names that an XSD declares, with those of the XSDs that it includes.

    Messages need them: libxml2 does not always report which elements are allowed.

    Args:
        documents: root elements of the XSD and of those that it includes.

    Attributes:
        elements: declarations of the elements that may be a root.
        names: names of all elements, sorted.
        attributes: names of all attributes, sorted.
    """

    def __init__(self, documents: Iterable[etree._Element]) -> None:
        schemas = tuple(documents)

        def top_level(tag: str) -> dict[str, etree._Element]:
            return {item.get("name", ""): item for schema in schemas for item in schema.iterchildren(f"{XS}{tag}")}

        def names(tag: str) -> tuple[str, ...]:
            declared = (item.get("name") for schema in schemas for item in schema.iter(f"{XS}{tag}"))
            return tuple(sorted({str(name) for name in declared if name}))

        self.elements, self._types, self._groups = map(top_level, ("element", "complexType", "group"))
        self.names, self.attributes = names("element"), names("attribute")

    def allowed_in(self, element: etree._Element) -> tuple[str, ...]:
        """Return the names of the elements that are allowed in an element of a document; none if it is not declared."""
        declaration = self._declaration(element)
        return () if declaration is None else tuple(self._children(declaration))

    def attributes_of(self, element: etree._Element) -> tuple[str, ...]:
        """Return the names of the attributes that an element of a document may have, and does not have."""
        declaration = self._declaration(element)
        type_ = None if declaration is None else self._types.get(declaration.get("type", ""), declaration)
        found = () if type_ is None else (item.get("name", "") for item in type_.iterchildren(f"{XS}attribute"))
        return tuple(name for name in found if name and name not in element.attrib)

    def _declaration(self, element: etree._Element) -> etree._Element | None:
        path = [element.tag, *(outer.tag for outer in element.iterancestors())]
        declaration = self.elements.get(str(path.pop()))
        while path and declaration is not None:
            declaration = self._children(declaration).get(str(path.pop()))
        return declaration

    def _children(self, declaration: etree._Element) -> dict[str, etree._Element]:
        """Return the declarations of the elements allowed in a declared element, by name."""
        type_ = self._types.get(declaration.get("type", ""), declaration)
        children: dict[str, etree._Element] = {}
        for child in self._declared(type_):
            name = str(child.get("name") or child.get("ref", ""))
            children.setdefault(name, self.elements.get(name, child) if child.get("ref") else child)
        return children

    def _declared(self, holder: etree._Element) -> Iterator[etree._Element]:
        """Yield the element declarations directly in a type or group."""
        for child in holder:
            if child.tag == f"{XS}element":
                yield child
            elif child.tag == f"{XS}group" and child.get("ref") in self._groups:
                yield from self._declared(self._groups[child.get("ref", "")])
            else:
                if child.tag == f"{XS}extension" and child.get("base") in self._types:
                    yield from self._declared(self._types[child.get("base", "")])
                yield from self._declared(child)


@lru_cache
def _vocabulary(path: Path) -> SchemaVocabulary:
    """Return the names that an XSD declares; only documents with defects need them."""
    return SchemaVocabulary(_documents(path))


def _documents(path: Path) -> Iterator[etree._Element]:
    """Yield an XSD and those that it includes."""
    document = parse(path.read_bytes(), str(path))
    yield document
    for include in document.iterchildren(f"{XS}include"):
        yield from _documents(path.with_name(include.get("schemaLocation", "")))


def explained_violations(
    root: etree._Element, log: Any, path: Path, file: str, chain: tuple[Origin, ...]
) -> tuple[Diagnostic, ...]:
    """Return the defects of a document.

    Args:
        root: its root element.
        log: what libxml2 says about it.
        path: the XSD.
        file: path of the document as the user would type it.
        chain: the places that include the document, innermost first.
    """
    vocabulary = _vocabulary(path)
    diagnostics: dict[Diagnostic, None] = {}
    wrong = {
        entry.path for entry in log if re.search(r"Character content|attribute '.+' is not allowed", entry.message)
    }
    for entry in log:
        if entry.path in wrong and re.search(r"Missing child|is required but missing", entry.message):
            continue  # what is missing is probably that text, without its tags, or that attribute
        element = _element(root, entry.path)
        where = Origin(file, entry.line if element is None else line_in(root, element), chain)
        message, hint = _explain(entry.message, vocabulary, element)
        diagnostics[Diagnostic.error("schema", message, where, hint)] = None
        if len(diagnostics) == _MOST:
            break
    return tuple(diagnostics)


def _element(root: etree._Element, path: str | None) -> etree._Element | None:
    """Return the element of an entry in the validator's log, whose own line number is cut at 16 bits."""
    prefixes = {prefix: uri for prefix, uri in root.nsmap.items() if prefix}
    try:
        elements: Any = root.getroottree().xpath(path, namespaces=prefixes) if path else []
    except etree.XPathError:
        return None
    return elements[0] if elements else None


_NAME = lazy_regex(r"\{([^}]*)\}([^\s',)]+)")


_SAME = {
    "ros_call": "ros_request",
    "ros_request": "ros_call",
    "ros_execute": "ros_operate",
    "ros_operate": "ros_execute",
}
"""Permissions of services and actions that correspond; by their letters, a server would become a client."""


def _unexpected(match: re.Match[str], vocabulary: SchemaVocabulary, element: etree._Element | None) -> tuple[str, str]:
    expected: Sequence[str] = match[2].split(", ") if match[2] else ()
    parent = None if element is None else element.getparent()
    if parent is not None and element is not None:
        expected = _with_exits(expected, element.getprevious(), parent, vocabulary)
    if parent is not None and not expected:  # libxml2 does not report which elements the parent allows
        expected = vocabulary.allowed_in(parent)
        if match[1] in expected:
            return f"<{match[1]}> is not expected here", "move it, or remove it if it occurs more often than allowed"
    expectation = f"expected {_one_of(expected)}" if expected else "expected nothing more"
    same = _SAME.get(match[1])
    help_ = f"did you mean '{same}'?" if same in expected else did_you_mean(match[1], expected)
    if match[1].endswith("}include"):
        help_ = f'the namespace of xi:include is "{XINCLUDE}"'
    if not help_ and match[1] not in vocabulary.names and (hint := did_you_mean(match[1], vocabulary.names)):
        return f"<{match[1]}> is not expected here", hint
    return f"<{match[1]}> is not expected here, {expectation}", help_


def _missing(match: re.Match[str], vocabulary: SchemaVocabulary, element: etree._Element | None) -> tuple[str, str]:
    expected: Sequence[str] = match[2].split(", ")
    if element is not None and len(element) and element[-1].tag in expected:
        # The element that may be repeated is there: the one that must follow it is missing.
        expected = _with_exits(expected, element[-1], element, vocabulary)[len(expected) :] or expected
    return f"<{match[1]}> is not complete, expected {_one_of(expected)}", ""


def _with_exits(
    expected: Sequence[str], last: etree._Element | None, parent: etree._Element, vocabulary: SchemaVocabulary
) -> Sequence[str]:
    """Add the elements that may follow a repeated one: libxml2 reports only the repeated one."""
    if last is None or last.tag not in expected:
        return expected
    allowed = vocabulary.allowed_in(parent)
    known = [allowed.index(name) for name in expected if name in allowed]
    return (*expected, *allowed[max(known, default=len(allowed)) + 1 :])


def _root(match: re.Match[str], vocabulary: SchemaVocabulary, _e: etree._Element | None) -> tuple[str, str]:
    roots = tuple(vocabulary.elements)
    help_ = did_you_mean(match[1], roots, "name a file with one of these root elements")
    return f"<{match[1]}> is not expected as the root, expected {_one_of(roots)}", help_


def _attribute(match: re.Match[str], vocabulary: SchemaVocabulary, element: etree._Element | None) -> tuple[str, str]:
    left = () if element is None else vocabulary.attributes_of(element)
    otherwise = f"expected {' or '.join(left)}" if left else "remove it"
    known = left or [name for name in vocabulary.attributes if name != match[2]]
    return f"<{match[1]}> has the unknown attribute '{match[2]}'", did_you_mean(match[2], known, otherwise)


def _enumeration(match: re.Match[str], *_: object) -> tuple[str, str]:
    values = [value.strip("'") for value in match[4].split(", ")]
    return f"{_node(match)} is {quote(match[3])}, expected {' or '.join(values)}", did_you_mean(match[3], values)


def _length(match: re.Match[str], *_: object) -> tuple[str, str]:
    if match[3] == "min" and not int(match[4]):
        return f"{_node(match)} is empty", ""
    limit = f"{match[5]} or {'more' if match[3] == 'min' else 'fewer'}"
    return f"{_node(match)} has {match[4]} characters, expected {limit}", ""


def _bound(match: re.Match[str], *_: object) -> tuple[str, str]:
    return f"{_node(match)} is {quote(match[4])}, expected {match[5]} or {'more' if match[3] == 'min' else 'less'}", ""


_QUOTED = lazy_regex(r"'([^']*)(?:'|\Z)")
"""A value in a message of libxml2, which truncates long messages."""

_Explanation = Callable[[re.Match[str], SchemaVocabulary, Any], tuple[str, str]]

_NODE = r"Element '(.+?)'(?:, attribute '(.+?)')?: "

_EXPLANATIONS: tuple[tuple[str, _Explanation], ...] = (
    (r"Element '(.+?)': This element is not expected\.(?: Expected is (?:one of )?\( (.+) \)\.)?", _unexpected),
    (r"Element '(.+?)': Missing child element\(s\)\. Expected is (?:one of )?\( (.+) \)\.", _missing),
    (r"Element '(.+?)': No matching global declaration", _root),
    (r"Element '(.+?)', attribute '(.+?)': The attribute '.+' is not allowed", _attribute),
    (_NODE + r"\[.+?\] The value '(.*)' is not .+ set \{(.+)\}", _enumeration),
    (_NODE + r"\[facet '(min|max)Length'\] .* length of '(\d+)'.* length of '(\d+)'", _length),
    (_NODE + r"\[facet '(min|max)Inclusive'\] .* '(.*)' is .+ \('(.+)'\)", _bound),
    (
        _NODE + r"(?:\[.+?\] The value )?'(.*)' is not (a valid .+|accepted .+)\.",
        lambda match, *_: (f"{_node(match)} is {quote(match[3])}, which is not {match[4]}", ""),
    ),
)
"""Patterns of libxml2's messages, and the function that words each. Groups: element, attribute, value, expected."""

_FIXED_EXPLANATIONS = (
    (
        r"Element '(.+?)': The attribute '(.+?)' is required but missing",
        r"<\1> lacks its attribute '\2'",
        r'add \2="…"',
    ),
    (r"Element '(.+?)': Element content is not allowed", r"<\1> can only contain text, no elements", ""),
    (
        r"Element '(.+?)': Character content",
        r"<\1> cannot contain text",
        "put the text into the element that it is for, e.g. <attachment>, or remove it",
    ),
)
"""Patterns of libxml2's messages, and for each the template of a message, and what to do."""


def _explain(message: str, vocabulary: SchemaVocabulary, element: etree._Element | None) -> tuple[str, str]:
    """Return message and help for a message of libxml2; an unknown message is kept, with long values cut."""
    message = _NAME.sub(lambda name: _PREFIXES.get(name[1], f"{{{name[1]}}}") + name[2], message)
    for pattern, explanation in _EXPLANATIONS:
        if match := re.match(pattern, message, re.DOTALL):
            return explanation(match, vocabulary, element)
    for pattern, template, help_ in _FIXED_EXPLANATIONS:
        if match := re.match(pattern, message, re.DOTALL):
            return match.expand(template), match.expand(help_)
    return _QUOTED.sub(lambda value: quote(value[1]), " ".join(message.split())), ""


def _node(match: re.Match[str]) -> str:
    return f"attribute '{match[2]}' of <{match[1]}>" if match[2] else f"<{match[1]}>"


def _one_of(names: Sequence[str]) -> str:
    # A schema that allows more than one version of XInclude names a namespace without a prefix: one is enough.
    return " or ".join(f"<{name}>" for name in names if not name.startswith("{"))
