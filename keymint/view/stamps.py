# SPDX-License-Identifier: Apache-2.0
"""Stamps: which inputs led to which outputs, so that a stage knows what it has done.

The record saves work and recognises manual edits. If it is lost, every stage recomputes its result and compares it with
the existing files.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from typing import Any, Self, TypeVar

from comarmor.values import dataclass

_V = TypeVar("_V")

MAX_RECORD = 1 << 30
"""Largest record in bytes; an enclave needs about 2,400."""
VERSION = 3
_DIGEST = 64
"""Characters of a digest; longer texts are written once."""
_OF_STAMP = 512
"""About the bytes that a stamp takes in a record."""
_AT_ONCE = 256
"""Stamps that become text together."""
_SEAL, _END = b',"sha256":"', b'"}\n'
"""Text around the digest at the end of a record, which detects damage."""


def digest(*parts: bytes | memoryview | str) -> str:
    """Return the SHA-256, in hex, of several parts, each prefixed with its length to keep them distinct."""
    pieces: list[bytes | memoryview] = []
    for part in parts:
        data = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part  # any name on disk
        pieces += (len(data).to_bytes(8, "big"), data)
    if len(parts) > 1:
        return hashlib.sha256(b"".join(pieces)).hexdigest()
    hashed = hashlib.sha256()
    for piece in pieces:  # which may be a large file
        hashed.update(piece)
    return hashed.hexdigest()


class CompactMapping(Mapping[str, _V]):
    """Values by name that take little memory where many have the same names, as the folders of a fleet do.

    Args:
        names: the names; equal ones are kept once by whoever makes many.
        values: their values.
    """

    __slots__ = ("_names", "_values")

    def __init__(self, names: tuple[str, ...], values: tuple[_V, ...]) -> None:
        self._names, self._values = names, values

    def __getitem__(self, name: str) -> _V:
        if name not in self._names:
            raise KeyError(name)
        return self._values[self._names.index(name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._names, self._values)

    @classmethod
    def of(cls, values: Mapping[str, _V]) -> Self:
        """Return the mapping with the same values."""
        return cls(one_of(tuple(values)), tuple(values.values()))


@functools.lru_cache(maxsize=64)
def one_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return one object for equal names, so that they are kept once."""
    return names


def digest_files(files: Mapping[str, bytes]) -> str:
    """Return one digest over files by name."""
    return digest(*(part for name in sorted(files) for part in (name, files[name])))


@dataclass(frozen=True, slots=True)
class Stamp:
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

    def compact(self) -> Stamp:
        """Return the same stamp, which takes little memory."""
        outputs = CompactMapping.of(self.outputs)
        return Stamp(self.inputs, outputs, self.secret, self.context, self.lifetimes, self.build_types)


@dataclass(frozen=True, slots=True)
class State:
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

    def updated(self, stage: str, stamps: Mapping[str, Stamp], removed: Iterable[str] = ()) -> State:
        """Return the state with stamps of one stage added or replaced, and some removed."""
        gone = set(removed)
        merged = {name: stamp for name, stamp in self.stamps.get(stage, {}).items() if name not in gone}
        return State({**self.stamps, stage: {**merged, **stamps}})

    def dump(self) -> bytes:
        """Return the record as bytes; equal states give equal bytes.

        Long texts, and what the stamps of a stage have in common, are written once and referred to by number.
        """
        texts: dict[str, int] = {}
        shapes: dict[tuple[tuple[str, ...], ...], int] = {}

        def brief(text: str) -> str | int:
            return text if len(text) <= _DIGEST else texts.setdefault(text, len(texts))

        def row(stamp: Stamp) -> list[Any]:
            files = tuple(sorted(stamp.outputs))
            shape = files, tuple(sorted(stamp.secret)), stamp.build_types
            values = [brief(stamp.outputs[file]) for file in files]
            number = shapes.setdefault(shape, len(shapes))
            return [stamp.inputs, number, values, brief(stamp.context), brief(stamp.lifetimes)]

        # Some stamps at a time become text: what the rows of a large fleet take is more than the stamps.
        body = io.BytesIO()
        body.seek(_OF_STAMP * sum(map(len, self.stamps.values())))  # or it would be copied as it grows
        body.write(b" ")
        body.seek(0)
        body.write(b'{"stamps":{')
        for number, (stage, of_stage) in enumerate(sorted(self.stamps.items())):
            body.write(f"{'},' if number else ''}{_json(stage)}:{{".encode())
            names = sorted(of_stage)
            for at in range(0, len(names), _AT_ONCE):
                rows = _json({name: row(of_stage[name]) for name in names[at : at + _AT_ONCE]})
                body.write(f"{',' if at else ''}{rows[1:-1]}".encode())
        body.write(f'{"}" if self.stamps else ""}}},"shapes":{_json([*shapes])},"texts":['.encode())
        for number, text in enumerate(texts):
            body.write(f"{',' if number else ''}{_json(text)}".encode())
        body.write(f'],"version":{VERSION}'.encode())
        body.truncate()
        return _sealed(body)


_json = json.JSONEncoder(separators=(",", ":"), sort_keys=True).encode


def sealed_document(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON that ends with its digest; equal documents give equal bytes."""
    body = io.BytesIO()
    body.write(_json(document).removesuffix("}").encode())
    return _sealed(body)


def _sealed(body: io.BytesIO) -> bytes:
    with body.getbuffer() as content:
        seal = digest(content).encode()
    body.write(b"".join((_SEAL, seal, _END)))
    return body.getvalue()  # which is no copy


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
    document = unsealed_document(content, VERSION) or {}
    try:
        texts = tuple(map(str, document["texts"]))
        shapes = [tuple(tuple(map(str, names)) for names in shape) for shape in document["shapes"]]

        def stamp(
            inputs: str, number: int, values: Sequence[str | int], context: str | int, lifetimes: str | int
        ) -> Stamp:
            files, secret, build_types = shapes[number]
            outputs = dict(zip(files, map(whole, values), strict=True))
            return Stamp(str(inputs), outputs, secret, whole(context), whole(lifetimes), build_types)

        def whole(brief: str | int) -> str:
            return texts[brief] if isinstance(brief, int) else str(brief)

        return State(
            {
                str(stage): {str(name): stamp(*row) for name, row in of_stage.items()}
                for stage, of_stage in document["stamps"].items()
            }
        )
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        return State()
