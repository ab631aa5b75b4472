# SPDX-License-Identifier: Apache-2.0
"""Stamps: which inputs led to which outputs, so that a stage knows what it has done.

The record saves work and recognises manual edits. If it is lost, every stage recomputes its result and compares it with
the existing files.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeVar, cast

from comarmor.values import Data, field

_V = TypeVar("_V")

MAX_RECORD = 1 << 30
"""Largest record in bytes; an enclave needs about 2,000."""
VERSION = 4
_DIGEST = 64
"""Characters of a digest; what longer texts have in common is written once."""
_SIZES = [size.to_bytes(8, "big") for size in range(_DIGEST + 1)]
_AT_ONCE = 256
"""Lines that are hashed together."""
_BEFORE_FILES = 3
"""Texts of a stamp before those of its files: the inputs, the context and the lifetimes."""
_SEAL, _END = b',"sha256":"', b'"}\n'
"""Text around the digest at the end of a record, which detects damage."""


def digest(*parts: bytes | memoryview | str) -> str:
    """Return the SHA-256, in hex, of several parts, each prefixed with its length to keep them distinct."""
    pieces: list[bytes | memoryview] = []
    for part in parts:
        data = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part  # any name on disk
        size = len(data)
        pieces += (_SIZES[size] if size <= _DIGEST else size.to_bytes(8, "big"), data)
    if len(parts) > 1:
        return hashlib.sha256(b"".join(pieces)).hexdigest()
    hashed = hashlib.sha256()
    for piece in pieces:  # which may be a large file
        hashed.update(piece)
    return hashed.hexdigest()


def digest_of_texts(*texts: str) -> str:
    """Return the SHA-256, in hex, of texts without NUL, such as paths and digests: for many, it is quicker."""
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogatepass")).hexdigest()


@functools.lru_cache(maxsize=256)
def one_of(value: _V) -> _V:
    """Return one object for equal values, so that they are kept once."""
    return value


def digest_files(files: Mapping[str, bytes]) -> str:
    """Return one digest over files by name."""
    return digest(*(part for name in sorted(files) for part in (name, files[name])))


class Stamp(Data):
    """A stage's result for one package.

    Attributes:
        inputs: digest over everything the stage read.
        outputs: digest of each file it wrote, by path relative to the package's folder in the stage's space.
        secret: which of them are secret.
        context: digest of other inputs that a stage compares separately: the options of a build, the policy of a proof.
        lifetimes: when the result is in force, if the stage knows; see :mod:`keymint.life.terms`.
        build_types: names of the build types that made the result, if the stage knows.
    """

    inputs: str
    outputs: Mapping[str, str]
    secret: tuple[str, ...] = ()
    context: str = ""
    lifetimes: str = ""
    build_types: tuple[str, ...] = ()
    _row: StampRow | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def row(self) -> StampRow:
        """The stamp as it is written."""
        if self._row is None:
            object.__setattr__(self, "_row", _row(self))
        return cast("StampRow", self._row)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what another process makes of it: the stamp as it is written."""
        return tuple, (self.row,)


class _Form(Data):
    """What the stamps of many packages have in common.

    Attributes:
        files: names of the files that were written, sorted.
        secret: which of them are secret, sorted.
        build_types: see :class:`Stamp`.
        texts: of the inputs, the context, the lifetimes and each file: the text before, between and after what is
            quoted in it; nothing if the whole text is the package's own.
    """

    files: tuple[str, ...]
    secret: tuple[str, ...]
    build_types: tuple[str, ...]
    texts: tuple[tuple[str, ...], ...]

    @property
    def values(self) -> tuple[Any, ...]:
        """The values of its fields."""
        return self.files, self.secret, self.build_types, self.texts

    def __reduce__(self) -> tuple[Any, ...]:
        return _form_of, self.values


@functools.lru_cache(maxsize=64)
def _form_of(*values: Any) -> _Form:
    return _Form(*values)


StampRow = tuple[_Form, bytes]
"""A form, and what is the package's own: texts with tabs in between."""


def _row(stamp: Stamp) -> StampRow:
    files = tuple(sorted(stamp.outputs))
    texts = [stamp.inputs, stamp.context, stamp.lifetimes, *map(stamp.outputs.__getitem__, files)]
    common: list[tuple[str, ...]] = [()] * len(texts)
    own = texts
    for at in reversed([at for at, size in enumerate(map(len, texts)) if size > _DIGEST]):
        pieces = texts[at].split("'")
        pieces = pieces if len(pieces) % 2 else [texts[at]]
        common[at], own = tuple(pieces[::2]), [*own[:at], *pieces[1::2], *own[at + 1 :]]
    line = "\t".join(own)
    if (
        ":" in line or "\n" in line or line.count("\t") >= len(own) or not line.isascii()
    ):  # it may be a date, or no line
        common, line = [(text,) for text in texts], ""
    form = _form_of(files, tuple(sorted(stamp.secret)), stamp.build_types, tuple(common))
    return form, line.encode()


NO_STAMP: StampRow = Stamp("", {}).row


def row_of_inputs(inputs: str) -> StampRow:
    """Return a stamp as it is written that has nothing but a digest over its inputs, or a fingerprint."""
    return NO_STAMP[0], f"{inputs}\t\t".encode()


def stamp_of(recorded: Stamp | StampRow) -> Stamp:
    """Return a stamp that may be as it is written."""
    if isinstance(recorded, Stamp):
        return recorded
    form, line = recorded
    own = itertools.chain(line.decode("latin-1").split("\t"), itertools.repeat(""))
    inputs, context, lifetimes, *values = [
        pieces[0] + "".join([f"'{next(own)}'{piece}" for piece in pieces[1:]]) if pieces else next(own)
        for pieces in form.texts
    ]
    outputs = dict(zip(form.files, values, strict=True))
    return Stamp(inputs, outputs, form.secret, context, lifetimes, form.build_types)


class Stamps(Mapping[str, Stamp]):
    """Stamps by name, kept as they are written: what did not change is neither read nor made again.

    Args:
        rows: by name.
    """

    __slots__ = ("_last", "rows")

    def __init__(self, rows: Mapping[str, StampRow]) -> None:
        self.rows = rows
        self._last: tuple[str, Stamp] | None = None
        """The one that was read last, with its name: whoever looks at a package asks several times."""

    @classmethod
    def of(cls, stamps: Mapping[str, Stamp] | Mapping[str, Stamp | StampRow]) -> Stamps:
        """Return the mapping with the same stamps."""
        if isinstance(stamps, Stamps):
            return stamps
        return cls({name: stamp if isinstance(stamp, tuple) else stamp.row for name, stamp in stamps.items()})

    def __getitem__(self, name: str) -> Stamp:
        if self._last is None or self._last[0] != name:
            self._last = name, stamp_of(self.rows[name])
        return self._last[1]

    def __contains__(self, name: object) -> bool:
        return name in self.rows

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __eq__(self, other: object) -> bool:
        return self.rows == other.rows if isinstance(other, Stamps) else Mapping.__eq__(self, other)

    def __hash__(self) -> int:
        return hash(frozenset(self.rows))


class State(Data):
    """All stamps of a workspace, by ``stage`` and package name.

    Attributes:
        stamps: the record of the last run that finished.
    """

    stamps: Mapping[str, Mapping[str, Stamp]] = field(default_factory=dict)

    def wrote(self, stage: str, package: str, file: str, content: bytes) -> bool:
        """Tell whether a file has the content that Keymint wrote."""
        stamp = self.stamp(stage, package)
        return stamp is not None and stamp.outputs.get(file) == digest(content)

    def stamp(self, stage: str, package: str) -> Stamp | None:
        """Return the stamp of a package, or None."""
        return self.stamps.get(stage, {}).get(package)

    def build_types(self, stage: str, package: str) -> tuple[str, ...]:
        """Return the build types of the stamp of a package; none if there is no stamp, or it does not know them."""
        rows = Stamps.of(self.stamps.get(stage, {})).rows
        return rows[package][0].build_types if package in rows else ()

    def updated(
        self, stage: str, stamps: Mapping[str, Stamp] | Mapping[str, Stamp | StampRow], removed: Iterable[str] = ()
    ) -> State:
        """Return the state with stamps of one stage added or replaced, and some removed."""
        rows = dict(Stamps.of(self.stamps.get(stage, {})).rows)
        for name in removed:
            rows.pop(name, None)
        return State({**self.stamps, stage: Stamps({**rows, **Stamps.of(stamps).rows})})

    def dump(self) -> bytes:
        """Return the record as bytes; equal states give equal bytes."""
        return b"".join(self.pieces())

    def pieces(self) -> Iterator[bytes]:
        """Yield the record in pieces, since that of a large fleet takes memory.

        Its first line has the forms, with the names of their stamps, and everything that may be a date. A line for
        each stamp follows.
        """
        stages: dict[str, list[tuple[Any, ...]]] = {}
        lines: list[bytes] = []
        for stage, of_stage in sorted(self.stamps.items()):
            by_form: dict[_Form, tuple[list[str], list[bytes]]] = {}
            last, own = None, (list[str](), list[bytes]())
            for name, (form, line) in sorted(Stamps.of(of_stage).rows.items()):
                if form is not last:  # a hash of each form would take long
                    last, own = form, by_form.setdefault(form, ([], []))
                own[0].append(name)
                own[1].append(line)
            stages[stage] = [(*form.values, names) for form, (names, _) in by_form.items()]
            lines += itertools.chain(*(own for _, own in by_form.values()))
        hashed = hashlib.sha256()
        starts = range(0, len(lines), _AT_ONCE)
        for at in starts:
            hashed.update(b"\n".join((*lines[at : at + _AT_ONCE], b"")))
        yield sealed_document({"version": VERSION, "lines": hashed.hexdigest(), "stages": stages})
        stages.clear()
        yield from (b"\n".join((*lines[at : at + _AT_ONCE], b"")) for at in starts)


_json = json.JSONEncoder(separators=(",", ":"), sort_keys=True).encode


def sealed_document(document: Mapping[str, Any]) -> bytes:
    """Return a document as one line of JSON that ends with its digest; equal documents give equal bytes."""
    body = _json(document).removesuffix("}").encode()
    return b"".join((body, _SEAL, digest(body).encode(), _END))


def unsealed_document(content: bytes | None, version: int) -> Mapping[str, Any] | None:
    """Return the document of :func:`sealed_document`, or None if it is missing, damaged or of another version."""
    body, _, seal = (content or b"").rpartition(_SEAL)
    if seal != digest(body).encode() + _END:
        return None
    try:
        document = json.loads(content or b"")
        return document if document["version"] == version else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def load(content: bytes | None) -> State:
    """Load a record; a record that is missing, damaged or of another version counts as empty.

    Args:
        content: result of :meth:`State.dump`.
    """
    content = content or b""
    first, *lines = content.split(b"\n")
    document = unsealed_document(first + b"\n", VERSION)
    if document is None or hashlib.sha256(memoryview(content)[len(first) + 1 :]).hexdigest() != document.get("lines"):
        return State()
    at, stamps = 0, dict[str, Stamps]()
    try:
        for stage, sections in document["stages"].items():
            rows: dict[str, StampRow] = {}
            for *names_of_form, texts, names in sections:
                files, secret, build_types = (tuple(map(str, some)) for some in names_of_form)
                form = _Form(files, secret, build_types, tuple(tuple(map(str, pieces)) for pieces in texts))
                at, start = at + len(names), at
                if at >= len(lines) or len(form.texts) != _BEFORE_FILES + len(files):
                    return State()
                own = [(form, line) for line in lines[start:at]]
                rows.update(zip(map(str, names), own, strict=True))
            stamps[stage] = Stamps(rows)
    except (ValueError, KeyError, TypeError, AttributeError):
        return State()
    return State(stamps)
