# SPDX-License-Identifier: Apache-2.0
"""Answers of workers as bytes: JSON of data types.

Unlike a pickle, an answer cannot make its reader carry out anything: it is read as data of the one type that is
expected, field by field.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from keymint.errors import KeymintError

Answer = TypeVar("Answer")


def dump(value: object) -> bytes:
    """Return a value of data types as JSON."""
    # The library does not write names that are not UTF-8; JSON's own escapes can.
    return json.dumps(msgspec.to_builtins(value, enc_hook=_plain), separators=(",", ":")).encode()


def load(content: object, kind: Any) -> Any:
    """Return the value of a type that :func:`dump` wrote.

    Raises:
        KeymintError: the content is not bytes, not JSON, or not of this type.
    """
    if not isinstance(content, bytes):
        raise _refused(f"a {type(content).__name__} in place of bytes")
    try:
        return msgspec.convert(json.loads(content), kind, dec_hook=_path)
    except (ValueError, RecursionError, msgspec.ValidationError) as error:
        raise _refused(str(error)) from error


def _refused(why: str) -> KeymintError:
    return KeymintError(
        f"a worker answered something else than it was asked: {why}",
        help="find out what runs on the cluster before you use it again",
        code="executor-answer",
    )


def _plain(value: object) -> object:
    if isinstance(value, Path):
        return str(value)
    raise NotImplementedError(type(value).__name__)


def _path(kind: type, value: object) -> object:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError(kind.__name__)
