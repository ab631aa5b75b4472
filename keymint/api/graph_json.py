# SPDX-License-Identifier: Apache-2.0
"""Semantic access graphs as JSON: the format of ``docs/graph.md``, read strictly and written canonically."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NoReturn

from comarmor.rules import KIND_OF, PERMISSIONS, is_fully_qualified, is_subject
from comarmor.text import did_you_mean, lazy_regex
from keymint.api.graph import Edge, Graph, Object
from keymint.errors import KeymintError, Origin

FORMAT = "keymint-graph"
VERSION = 1
MAX_BYTES = 16 * 2**20
"""Maximum size of a document in bytes."""
MAX_VALUES = 1_200_000
"""Maximum number of the characters ``,:[{`` in a document: each begins a value that takes more memory than its text."""
MAX_NAME = 1024
"""Maximum length of a name."""
MAX_DOMAIN = 232
"""Highest domain id of ROS 2 (``ROS_DOMAIN_ID``)."""

_CONTROL = lazy_regex(r"[\x00-\x1f\x7f\ud800-\udfff\ufffe\uffff]")

Path = tuple[str | int, ...]


def legal_subject(name: str) -> bool:
    """Whether a subject may have a name: a fully qualified ROS name of limited length, or ``/``, the root enclave."""
    return len(name) <= MAX_NAME and is_subject(name)


def legal_node(name: str) -> bool:
    """Whether a node may have a name: a fully qualified ROS name of limited length."""
    return len(name) <= MAX_NAME and is_fully_qualified(name)


def legal_text(text: str) -> bool:
    """Return True for a legal name of an object, partition or type: not too long, without control characters."""
    return len(text) <= MAX_NAME and not _CONTROL.search(text)


def merge(first: Graph, second: Graph) -> Graph:
    """Return the union of two graphs."""
    return Graph.of((*first.edges, *second.edges), (*first.subjects, *second.subjects), (*first.types, *second.types))


def recognises(content: bytes) -> bool:
    """Return True if a file looks like JSON, for :func:`load`."""
    return content.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"{"


def decoded_text(content: bytes, name: str, code: str) -> str:
    """Return the text of a file.

    Args:
        content: the file, UTF-8.
        name: its name for messages.
        code: the diagnostic code.

    Raises:
        KeymintError: the file is too large, or not UTF-8.
    """
    if len(content) > MAX_BYTES:
        raise KeymintError(f"the file has more than the {MAX_BYTES:,} bytes allowed", where=Origin(name), code=code)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where = Origin(name, content[: error.start].count(b"\n") + 1)
        raise KeymintError("the text is not UTF-8", where=where, code=code) from None


# -- writing -----------------------------------------------------------------------------------------------------


def dump(graph: Graph) -> bytes:
    """Return a graph as a canonical JSON document, with one edge per line for readers and diffs."""
    head = [f'"format": "{FORMAT}"', f'"version": {VERSION}', _array("subjects", map(json.dumps, graph.subjects))]
    edges = _array("edges", (json.dumps(_edge(edge)) for edge in graph.edges))
    types = _array("types", (json.dumps({**_object(object_), "type": name}) for object_, name in graph.types))
    return ("{\n  " + ",\n  ".join([*head, edges, types]) + "\n}\n").encode()


def _array(name: str, items: Iterator[str]) -> str:
    inner = ",\n    ".join(items)
    return f'"{name}": [\n    {inner}\n  ]' if inner else f'"{name}": []'


def _edge(edge: Edge) -> dict[str, Any]:
    return {
        "subject": edge.subject,
        "permission": edge.permission,
        "object": edge.object.name,
        **_partitions(edge.object),
        "domain": edge.domain,
    }


def _object(object_: Object) -> dict[str, Any]:
    return {"kind": object_.kind, "object": object_.name, **_partitions(object_)}


def _partitions(object_: Object) -> dict[str, Any]:
    return {"partitions": list(object_.partitions)} if object_.partitions else {}


# -- reading -----------------------------------------------------------------------------------------------------


def load(content: bytes, name: str) -> Graph:
    """Return the graph of a JSON document.

    Args:
        content: the document, UTF-8.
        name: its file as the user would type it, for messages.

    Raises:
        KeymintError: the document is invalid; with line, expectation and fix.
    """
    return _GraphReader(name, content).graph()


class _GraphReader:
    """Reads one document; errors have its line."""

    def __init__(self, name: str, content: bytes) -> None:
        self._name = name
        self._text = decoded_text(content, name, "graph-invalid")
        if sum(map(self._text.count, ",:[{")) > MAX_VALUES:
            raise self._error(f"the file has more than the {MAX_VALUES:,} values allowed", 0)
        try:
            self._document: Any = json.loads(self._text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
        except json.JSONDecodeError as error:
            message = f"not JSON: {error.msg[:1].lower()}{error.msg[1:]}"
            raise self._error(message, error.lineno, "name a file of 'keymint discover' (docs/graph.md)") from None
        except RecursionError:
            raise self._error("nested too deeply for a graph", 0) from None
        except ValueError as error:
            raise self._error(f"not a graph: {error}", 0) from None

    def _error(self, message: str, line: int, help: str = "") -> KeymintError:  # noqa: A002
        return KeymintError(message, where=Origin(self._name, line), help=help, code="graph-invalid")

    def _refuse(self, path: Path, message: str, help: str = "") -> NoReturn:  # noqa: A002
        shown = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")
        raise self._error(f"{shown}: {message}" if shown else message, _line(self._text, path), help)

    def graph(self) -> Graph:
        document = self._members(
            (), self._document, required=("format", "version", "edges"), also=("subjects", "types")
        )
        if document["format"] != FORMAT:
            self._refuse(("format",), f"is {_shown(document['format'])}, expected {FORMAT!r}")
        if isinstance(document["version"], bool) or document["version"] != VERSION:
            help_ = "a newer keymint wrote it" if isinstance(document["version"], int) else ""
            self._refuse(("version",), f"is {_shown(document['version'])}, expected {VERSION}", help_)
        subjects = [self._subject(path, item) for path, item in self._items((), document, "subjects")]
        edges = [self._edge(path, item) for path, item in self._items((), document, "edges")]
        types = [self._type(path, item) for path, item in self._items((), document, "types")]
        return Graph.of(edges, subjects, types)

    def _items(self, path: Path, entry: Mapping[str, Any], name: str) -> Iterator[tuple[Path, Any]]:
        items = entry.get(name, [])
        if not isinstance(items, list):
            self._refuse((*path, name), f"is {_shown(items)}, expected an array")
        return (((*path, name, at), item) for at, item in enumerate(items))

    def _one_of(self, path: Path, value: Any, known: Collection[str], noun: str) -> str:
        if not isinstance(value, str) or value not in known:
            help_ = did_you_mean(str(value), known, f"known are {', '.join(known)}")
            self._refuse(path, f"unknown {noun} {_shown(value)}", help_)
        return value

    def _members(self, path: Path, value: Any, *, required: Sequence[str], also: Sequence[str]) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            self._refuse(path, f"is {_shown(value)}, expected an object")
        known = (*required, *also)
        for name in value:
            if name not in known:
                help_ = did_you_mean(name, known, f"known are {', '.join(known)}")
                self._refuse((*path, name), "unknown member", help_)
        for name in required:
            if name not in value:
                self._refuse(path, f"the member {name!r} is missing")
        return value

    def _text_of(self, path: Path, value: Any, *, empty: bool = False) -> str:
        if not isinstance(value, str) or (not value and not empty):
            self._refuse(path, f"is {_shown(value)}, expected text")
        if len(value) > MAX_NAME:
            self._refuse(path, f"has {len(value):,} characters, at most {MAX_NAME:,} are allowed")
        if _CONTROL.search(value):
            self._refuse(path, f"{_shown(value)} contains an illegal character")
        return value

    def _subject(self, path: Path, value: Any) -> str:
        name = self._text_of(path, value)
        if not legal_subject(name):
            self._refuse(path, f"{_shown(name)} is not a subject name", "subject names look like /robot1/talker")
        return name

    def _edge(self, path: Path, value: Any) -> Edge:
        edge = self._members(path, value, required=("subject", "permission", "object"), also=("partitions", "domain"))
        permission = self._one_of((*path, "permission"), edge["permission"], KIND_OF, "permission")
        domain = edge.get("domain", 0)
        if isinstance(domain, bool) or not isinstance(domain, int) or not 0 <= domain <= MAX_DOMAIN:
            self._refuse((*path, "domain"), f"is {_shown(domain)}, expected a domain id from 0 to {MAX_DOMAIN}")
        subject = self._subject((*path, "subject"), edge["subject"])
        return Edge(subject, permission, self._object(path, edge, KIND_OF[permission]), domain)

    def _type(self, path: Path, value: Any) -> tuple[Object, str]:
        entry = self._members(path, value, required=("kind", "object", "type"), also=("partitions",))
        kind = self._one_of((*path, "kind"), entry["kind"], PERMISSIONS, "kind")
        return self._object(path, entry, kind), self._text_of((*path, "type"), entry["type"])

    def _object(self, path: Path, entry: Mapping[str, Any], kind: str) -> Object:
        name = self._text_of((*path, "object"), entry["object"])
        names = {self._text_of(place, item, empty=True) for place, item in self._items(path, entry, "partitions")}
        if kind == "topic":
            return Object(kind, name, partitions(names))
        if names:
            self._refuse((*path, "partitions"), f"a {kind} has no partitions", "only objects of kind topic have")
        if not name.startswith("/"):
            self._refuse((*path, "object"), f"{_shown(name)} does not begin with '/'", "write the absolute ROS name")
        return Object(kind, name)


def partitions(names: set[str]) -> tuple[str, ...]:
    """Return partitions as in :class:`~keymint.api.graph.Object`: empty for the default partition alone."""
    return () if names == {""} else tuple(sorted(names))


def _shown(value: Any) -> str:
    text = repr(value[:81]) if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 80 else f"{text[:80]}…"  # noqa: PLR2004 - what fits in a line


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a JSON number")


def _unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the member {next(name for name in names if names.count(name) > 1)!r} appears twice")
    return members


def _line(text: str, path: Path) -> int:
    """Return the line of the value at a path in JSON text."""
    decoder = json.JSONDecoder()
    at = _skip(text, text.find("{"))
    for step in path:
        at = next(start for name, start in _inside(decoder, text, at) if name == step)
    return text.count("\n", 0, at) + 1


def _inside(decoder: json.JSONDecoder, text: str, at: int) -> Iterator[tuple[str | int, int]]:
    """Yield name or index, and position, of the members of the object or array at a position in JSON text."""
    opening = text[at]
    at = _skip(text, at + 1)
    number = 0
    while text[at] not in "}]":
        name: str | int = number
        if opening == "{":
            name, at = decoder.raw_decode(text, at)
            at = _skip(text, at)
        yield name, at
        _, at = decoder.raw_decode(text, at)
        at = _skip(text, at)
        number += 1


def _skip(text: str, at: int) -> int:
    """Return the position of the next value, or of the end of an array or object."""
    while text[at] in " \t\r\n,:":
        at += 1
    return at
