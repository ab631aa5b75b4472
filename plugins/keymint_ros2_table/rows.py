# SPDX-License-Identifier: Apache-2.0
"""The columns of a table of rules, its rows as texts, and how a CSV file (RFC 4180) with a header gives them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from comarmor.language.attachments import strip
from comarmor.text import did_you_mean, quantity, quote
from comarmor.values import Data
from keymint.errors import KeymintError, Origin

REQUIRED = ("subject", "kind", "permission", "object", "qualifier")
OPTIONAL = ("audit", "source")
COLUMNS = (*REQUIRED, *OPTIONAL)
MOST_ROWS = 200_000
"""The most rows of a table."""
_LONGEST_SOURCE = 500


class TableRow(Data):
    """A row of a table, as it is written: the texts of :data:`COLUMNS` but the source.

    Attributes:
        where: where the row is, with what its column ``source`` says.
        origin: where its rules come from: the same, but without a number that changes when other rows of a database do,
            if there is a source.
        subject: expression of subjects.
        kind: kind of the object, or ``include``.
        permission: one permission of that kind.
        object: expression of objects.
        qualifier: ALLOW or DENY.
        audit: whether requests are logged.
    """

    where: Origin
    origin: Origin
    subject: str
    kind: str
    permission: str
    object: str
    qualifier: str
    audit: str


def column_order(header: Sequence[str], where: Origin) -> tuple[int, ...]:
    """Return the position of each of :data:`COLUMNS` in a header; -1 for an optional one that is not there.

    Raises:
        KeymintError: a column is missing, unknown or there twice.
    """
    for at, name in enumerate(header):
        if name not in COLUMNS:
            help_ = did_you_mean(name, COLUMNS, f"known are {', '.join(COLUMNS)}")
            raise KeymintError(f"the column {quote(name)} is unknown", where=where, code="table-header", help=help_)
        if name in header[:at]:
            message = f"there are two columns {quote(name)}"
            raise KeymintError(message, where=where, help="remove one of them", code="table-header")
    if missing := [name for name in REQUIRED if name not in header]:
        help_ = f"expected are {', '.join(REQUIRED)}, and perhaps {' and '.join(OPTIONAL)}"
        raise KeymintError(f"the column {missing[0]} is missing", where=where, code="table-header", help=help_)
    return tuple(header.index(name) if name in header else -1 for name in COLUMNS)


def row_origin(file: str, number: int, source: str) -> Origin:
    """Return the place of a row, with its source.

    Args:
        file: path of the table as the user would type it.
        number: the row's line in a CSV file, or its number in a view, from 1.
        source: what the row says about where it comes from; may be empty.

    Raises:
        KeymintError: the source is too long.
    """
    if not source:
        return Origin(file, number)
    if len(source) > _LONGEST_SOURCE:
        message = f"the source is longer than {_LONGEST_SOURCE} characters"
        raise KeymintError(message, where=Origin(file, number), code="table-value")
    return Origin(file, number, source=source)


_MOST_CHARACTERS = 1 << 20
"""The most characters of a row."""
_ENOUGH = 3
"""Names of columns by which a header is recognised, also if it has defects."""


def is_header(line: str) -> bool:
    """Tell whether the first line of a text is that of a table of rules, perhaps with defects or other separators."""
    words = line.replace(";", ",").replace("\t", ",").replace('"', "").split(",")
    return len({word.strip().lower() for word in words}.intersection(COLUMNS)) >= _ENOUGH


def rows_of_csv(content: bytes, file: str) -> Iterator[TableRow | KeymintError]:
    """Yield the rows of a CSV file; the error of a row in place of it.

    Args:
        content: the file.
        file: its path as the user would type it.

    Raises:
        KeymintError: the file as a whole cannot be read, with its line.
    """
    records = _records(content, file)
    header = next(records, None)
    if header is None:
        help_ = f"expected the header {','.join(COLUMNS)}"
        raise KeymintError("the table is empty", where=Origin(file), help=help_, code="table-header")
    names = [name.strip() for name in header[1]]
    if len(names) == 1 and is_header(names[0]):
        message, help_ = "the columns are not separated by commas", f"expected the header {','.join(COLUMNS)}"
        raise KeymintError(message, where=Origin(file, 1), help=help_, code="table-header")
    order = column_order(names, Origin(file, header[0]))
    written = (record for record in records if record[1])  # not the empty lines
    for number, (line, fields) in enumerate(written, 1):
        if number > MOST_ROWS:
            message = f"the table has more than the {MOST_ROWS:,} rows allowed"
            raise KeymintError(message, where=Origin(file, line), code="table-limit")
        if len(fields) != len(names):
            message = f"the row has {quantity(len(fields), 'field')}, expected {len(names)} as in the header"
            help_ = 'a field with a comma is written in quotes: "a,b"'
            yield KeymintError(message, where=Origin(file, line), help=help_, code="table-row")
            continue
        *texts, source = (strip(fields[at]) if at >= 0 else "" for at in order)
        try:
            where = row_origin(file, line, source)
            yield TableRow(where, where, *texts)
        except KeymintError as error:
            yield error


def _records(content: bytes, file: str) -> Iterator[tuple[int, list[str]]]:
    """Yield each record, with its first line."""
    try:
        content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where, help_ = Origin(file, content.count(b"\n", 0, error.start) + 1), "save it as CSV in UTF-8"
        raise KeymintError("the table is not UTF-8", where=where, help=help_, code="table-encoding") from None
    text = io.TextIOWrapper(io.BytesIO(content), "utf-8-sig", newline="")  # as a str it may take four times the memory
    size = 0

    def lines() -> Iterator[str]:
        nonlocal size
        while each := text.readline(_MOST_CHARACTERS):
            size += len(each)
            if size >= _MOST_CHARACTERS:
                raise csv.Error(f"more than {_MOST_CHARACTERS:,} characters")
            yield each

    reader = csv.reader(lines(), strict=True)
    line = 1
    try:
        for fields in reader:
            yield line, fields
            line, size = reader.line_num + 1, 0
    except csv.Error as error:
        message = f"the row is not valid CSV: {error}"
        help_ = 'a field with a quote is written in quotes, with the quote doubled: "a""b"'
        raise KeymintError(message, where=Origin(file, line), help=help_, code="table-row") from None
