"""What is peculiar about the bytes of a permissions document, and what vendors make of it.

The models of vendors hold for plain documents: elements, attributes and text as the schema has them. Everything else is
found here, and for each of it is stated what each vendor was measured to do with it. Where that is not known for all
documents of a kind, it is :attr:`VendorReading.UNMODELLED`: then nothing is said of that vendor.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from xml.parsers import expat  # nosec - the document was read before, without a DOCTYPE


class VendorReading(Enum):
    """What a vendor does with a document that has something peculiar.

    ``FINE``: it reads the document as its model does. ``REFUSES``: the whole document. ``STOPS``: its process ends.
    ``UNMODELLED``: it is no part of the model.
    """

    FINE = "fine"
    REFUSES = "refuses"
    STOPS = "stops"
    UNMODELLED = "untold"


FINE, REFUSES, STOPS, UNMODELLED = VendorReading


@dataclass(frozen=True, slots=True)
class Quirk:
    """Something that a plain document has not.

    Attributes:
        line: its line in the document.
        text: what it is, as the end of "Cyclone DDS refuses …".
        cyclone: what Cyclone DDS 0.10.2 does.
        fast: what Fast DDS 2.9.1 does.
        invalid: the schema does not allow it.
    """

    line: int
    text: str
    cyclone: VendorReading
    fast: VendorReading
    invalid: bool = False


@dataclass(frozen=True, slots=True)
class Quirks:
    """What is peculiar about a document.

    Attributes:
        peculiarities: in the order of the document.
        first_pieces: for elements whose text is in pieces, by their number in document order: the first piece, at which
            Fast DDS ends.
    """

    peculiarities: tuple[Quirk, ...] = ()
    first_pieces: Mapping[int, str] = field(default_factory=dict)


NOTHING = Quirks()
_BOM = b"\xef\xbb\xbf"
_HEAD = re.compile(rb"""<\?xml version=["']1\.0["'](?: encoding=["'](?:utf-8|us-ascii)["'])?\s*\?>""", re.IGNORECASE)
_ROOT = re.compile(
    rb' xmlns:xsi="http://www\.w3\.org/2001/XMLSchema-instance"(?: xsi:noNamespaceSchemaLocation="[^"<&]*")?'
)
_SIGNS = re.compile(rb"<[!?]|&|\x00|\xef\xbb\xbf|xmlns|xsi:|</[^>\s]*\s")
_BETWEEN = re.compile(rb">\s*(?:<!--(?:[^-]|-[^-])*-->\s*)+(?=<)")
"""Comments between two tags."""
_CLOSING = re.compile(rb"</[^>\s]*\s")
_REFERENCE = re.compile(rb"&(?:lt|gt|amp|apos|quot|#[0-9]{1,8}|#x[0-9A-Fa-f]{1,8});")
_BLANK_REFERENCE = re.compile(rb"&#0*(?:9|10|13|32);|&#x0*(?:9|[aA]|[dD]|20);")
_BLANKS = " \t\r\n"

_CRITERIA = ("topics", "partitions", "data_tags")
_RULE = ("domains", "publish", "subscribe", "relay")
_CHILDREN: Mapping[str, Sequence[str]] = MappingProxyType(
    {
        "": ("dds",),
        "dds": ("permissions",),
        "permissions": ("grant",),
        "grant": ("subject_name", "validity", "allow_rule", "deny_rule", "default"),
        "validity": ("not_before", "not_after"),
        **dict.fromkeys(("allow_rule", "deny_rule"), _RULE),
        "domains": ("id", "id_range"),
        "id_range": ("min", "max"),
        **dict.fromkeys(("publish", "subscribe", "relay"), _CRITERIA),
        "topics": ("topic",),
        "partitions": ("partition",),
        "data_tags": ("tag",),
        "tag": ("name", "value"),
    }
)
"""What an element may hold."""
_RULES = frozenset(("allow_rule", "deny_rule"))
_LEAVES = frozenset({each for names in _CHILDREN.values() for each in names} - {*_CHILDREN})
_KNOWN = frozenset((*_CHILDREN, *_LEAVES))
_MANY = frozenset(("grant", *_RULES, "id", "id_range", "publish", "subscribe", "relay", "topic", "partition", "tag"))
_TAG = ["name", "value"]
_NUMBERS = frozenset(("id", "min", "max"))
_READ_IN_PIECES = frozenset(("subject_name", "topic", "partition", "name", "value"))
_PLAIN_ATTRIBUTES = frozenset(("xmlns:xsi", "xsi:nonamespaceschemalocation"))


def find(content: bytes, *, valid: bool) -> Quirks:
    """Return what is peculiar about a document that could be read.

    Args:
        content: the document.
        valid: the schema has nothing against it.
    """
    rest = _HEAD.sub(b"", content, count=1)
    if valid and _SIGNS.search(_ROOT.sub(b"", rest, count=1)) is None:
        return NOTHING
    return _Walk(content).found()


def decorations(content: bytes, comments_until: int) -> Iterator[Quirk]:
    """Yield what of the bytes of a governance document is beyond elements, their text, and comments between tags.

    Args:
        content: the document.
        comments_until: offset up to which both vendors pass over a comment between tags.
    """
    if content.startswith(_BOM):
        yield Quirk(1, "a byte order mark", REFUSES, UNMODELLED)
        return
    rest = _HEAD.sub(b"", content, count=1)
    end = max(comments_until - (len(content) - len(rest)), 0)
    plain = _BETWEEN.sub(lambda found: b">" + b"\n" * found[0].count(b"\n"), rest[:end]) + rest[end:]
    sign = _SIGNS.search(_ROOT.sub(b"", plain, count=1))
    if sign is not None:
        before = (
            content.count(b"\n") - plain.count(b"\n") + _ROOT.sub(b"", plain, count=1).count(b"\n", 0, sign.start())
        )
        text = sign[0].decode("latin-1")
        yield Quirk(before + 1, f"{text!r}, which a plain document has not", UNMODELLED, UNMODELLED)


@dataclass(slots=True)
class _Open:
    """An element that is not closed yet.

    Attributes:
        name: its tag, with its prefix.
        number: its number in the document.
        children: tags of its elements so far.
        pieces: its text, in pieces between comments and CDATA sections, and whether each is a CDATA section.
        comments: it has some.
    """

    name: str
    number: int
    children: list[str] = field(default_factory=list)
    pieces: list[tuple[str, bool]] = field(default_factory=list)
    comments: bool = False


class _Walk:
    """Walks through the bytes, as a parser does that knows nothing of namespaces."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._found: list[Quirk] = []
        self._pieces: dict[int, str] = {}
        self._open = [_Open("", -1)]
        self._count = 0
        self._commented = False
        self._cdata = False
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.buffer_size = max(len(content), 1)
        parser.XmlDeclHandler = self._declaration
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.CommentHandler = self._comment
        parser.ProcessingInstructionHandler = self._instruction
        parser.StartCdataSectionHandler = self._cdata_start
        parser.EndCdataSectionHandler = self._cdata_end

    def found(self) -> Quirks:
        """Return what is found."""
        if self._content.startswith(_BOM):
            self._note("a byte order mark", REFUSES, FINE, line=1)
        if b"\0" in self._content:
            self._note("text of two bytes a character", UNMODELLED, UNMODELLED, line=1)
        self._parser.Parse(self._content, True)
        for at in re.finditer(rb"&", self._content):
            self._reference(at.start())
        self._found.sort(key=lambda each: each.line)
        return Quirks(tuple(self._found), MappingProxyType(self._pieces))

    def _note(
        self, text: str, cyclone: VendorReading, fast: VendorReading, *, line: int = 0, invalid: bool = False
    ) -> None:
        self._found.append(Quirk(line or self._parser.CurrentLineNumber, text, cyclone, fast, invalid))

    def _declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        if (encoding or "utf-8").lower() not in {"utf-8", "us-ascii"} and not self._content.isascii():
            self._note(f"text in the encoding {encoding}", UNMODELLED, UNMODELLED)

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        holder = self._open[-1]
        for text, cyclone, fast in self._misplaced(holder, name):
            self._note(text, cyclone, fast, invalid=True)
        for attribute in attributes:
            if attribute.lower() not in _PLAIN_ATTRIBUTES and (name.lower(), attribute) != ("grant", "name"):
                self._note(f"the attribute {attribute!r} of <{name}>", REFUSES, FINE, invalid=True)
        holder.children.append(name)
        self._open.append(_Open(name, self._count))
        self._count += 1

    def _misplaced(self, holder: _Open, name: str) -> Iterator[tuple[str, VendorReading, VendorReading]]:
        """Yield what is wrong with an element in its place."""
        after_default = any(each.name == "grant" and "default" in each.children for each in self._open)
        if name not in _CHILDREN.get(holder.name, ()):
            yield from self._foreign(holder, name, after_default=after_default)
        elif after_default and holder.name == "grant" and name in _RULES:
            # Fast DDS looks at nothing after the default: that is a part of its model.
            yield f"the <{name}> after <default>", FINE, FINE
        elif name in holder.children and name not in _MANY:
            yield f"a second <{name}>", UNMODELLED, self._fast_on_second(name, after_default=after_default)
        elif holder.name in {"grant", "validity"} and _too_late(holder, name):
            yield f"the <{name}> after <{holder.children[-1]}>", UNMODELLED, UNMODELLED if after_default else REFUSES
        elif holder.name in _RULES and _too_late(holder, name):
            late = (FINE, FINE)
            if name == "domains":
                late = (UNMODELLED, UNMODELLED if after_default else REFUSES)
            yield f"the <{name}> after <{holder.children[-1]}>", *late
        elif holder.name == "id_range" and _too_late(holder, name):
            yield f"the <{name}> after <{holder.children[-1]}>", FINE, FINE

    @staticmethod
    def _fast_on_second(name: str, *, after_default: bool) -> VendorReading:
        if name == "default":
            return FINE
        refused = name in {"subject_name", "validity", "not_before", "domains"}
        return REFUSES if refused and not after_default else UNMODELLED

    def _foreign(
        self, holder: _Open, name: str, *, after_default: bool
    ) -> Iterator[tuple[str, VendorReading, VendorReading]]:
        """Yield what is wrong with an element that its holder may not have."""
        names = {each.name for each in self._open}
        if name in _KNOWN or holder.name in _LEAVES or "data_tags" in names:
            yield f"<{name}> in <{holder.name}>", UNMODELLED, UNMODELLED
        elif name.lower() in _KNOWN:
            yield f"<{name}>, as it is not in small letters", UNMODELLED, UNMODELLED if after_default else REFUSES
        else:
            ends = holder.name in {"dds", "validity", "id_range"} and bool(holder.children)
            cyclone = UNMODELLED if "relay" in names else REFUSES
            yield f"the unknown element <{name}>", cyclone, UNMODELLED if after_default or ends else REFUSES

    def _end(self, name: str) -> None:
        if _CLOSING.match(self._content, self._parser.CurrentByteIndex):
            self._note(f"white space in the end tag of <{name}>", REFUSES, FINE)
        closed = self._open.pop()
        if name.lower() in _LEAVES:
            self._leaf(closed)
        else:
            self._between(closed)
        if (name == "data_tags" and not closed.children) or (name == "tag" and len(closed.children) < len(_TAG)):
            self._note(f"a <{name}> that is not complete", FINE, FINE, invalid=True)
        elif name == "tag" and closed.children[:2] != _TAG:
            self._note("a <tag> in another order", FINE, UNMODELLED, invalid=True)

    def _between(self, closed: _Open) -> None:
        """Note text in an element that has elements."""
        if any(cdata for _, cdata in closed.pieces):
            self._note(f"a CDATA section in <{closed.name}>", UNMODELLED, UNMODELLED, invalid=True)
        elif any(text.strip(_BLANKS) for text, _ in closed.pieces):
            ignored = any(each.name in {"relay", "data_tags"} for each in (*self._open, closed))
            self._note(f"text in <{closed.name}>", UNMODELLED if ignored else REFUSES, FINE, invalid=True)

    def _leaf(self, closed: _Open) -> None:
        """Note a text in pieces, of which Fast DDS reads the first one."""
        sections = sum(cdata for _, cdata in closed.pieces)
        first = next((text for text, cdata in closed.pieces if cdata or text.strip(_BLANKS)), "")
        text = f"the text of <{closed.name}>, as it is in pieces"
        if sections > 1 or (sections and not first.strip(_BLANKS)):
            self._note(text, UNMODELLED, UNMODELLED)
        elif closed.comments and closed.name in _NUMBERS:
            self._note(text, FINE, UNMODELLED)
        elif first != "".join(piece for piece, _ in closed.pieces):
            self._note(text, FINE, FINE if closed.name in _READ_IN_PIECES else UNMODELLED)
            self._pieces[closed.number] = first

    def _text(self, text: str) -> None:
        self._open[-1].pieces.append((text, self._cdata))

    def _comment(self, _text: str) -> None:
        self._open[-1].comments = self._commented = True

    def _instruction(self, _target: str, _data: str) -> None:
        inside = self._open[-1].name
        if inside in _LEAVES:
            self._note(f"a processing instruction in <{inside}>", UNMODELLED, REFUSES)
        elif self._count or self._commented:
            self._note("a processing instruction", FINE, REFUSES)

    def _cdata_start(self) -> None:
        self._cdata = True
        self._open[-1].pieces.append(("", True))

    def _cdata_end(self) -> None:
        self._cdata = False
        pieces = self._open[-1].pieces
        if pieces[-2:-1] == [("", True)]:  # the text of the section itself came after its beginning
            del pieces[-2]

    def _reference(self, at: int) -> None:
        """Note what may be a reference to a character, in a form that was not measured."""
        line = self._content.count(b"\n", 0, at) + 1
        if _REFERENCE.match(self._content, at) is None:
            self._note("an ampersand", UNMODELLED, FINE, line=line)
        elif _BLANK_REFERENCE.match(self._content, at):
            self._note("white space as a reference", FINE, UNMODELLED, line=line)


def _too_late(holder: _Open, name: str) -> bool:
    """Tell whether an element stands after one that it should come before."""
    order = _CHILDREN[holder.name]
    own = order.index(name)
    return any(each in order and order.index(each) > own and not {each, name} <= _RULES for each in holder.children)
