# SPDX-License-Identifier: Apache-2.0
"""Read the rows of a CSV file (RFC 4180) in UTF-8, with a header."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import strip
from comarmor.text import counted
from keymint_ros2_table.rows import COLUMNS, MOST_ROWS, TableRow, column_order, row_origin

_NAMES = frozenset(COLUMNS)
_MOST_CHARACTERS = 1 << 20
"""The most characters of a row."""
_ENOUGH = 3
"""Names of columns by which a header is recognised, also if it has defects."""


def is_header(line: str) -> bool:
    """Tell whether the first line of a text is that of a table of rules, perhaps with defects or other separators."""
    words = line.replace(";", ",").replace("\t", ",").replace('"', "").split(",")
    return len({word.strip().lower() for word in words} & _NAMES) >= _ENOUGH


def rows_of(content: bytes, file: str) -> Iterator[TableRow | ComArmorError]:
    """Yield the rows of a CSV file; the error of a row in place of it.

    Args:
        content: the file.
        file: its path as the user would type it.

    Raises:
        ComArmorError: the file as a whole cannot be read, with its line.
    """
    records = _records(_text(content, file), file)
    header = next(records, None)
    if header is None:
        raise ComArmorError(
            "the table is empty", where=Origin(file), help=f"expected the header {','.join(COLUMNS)}",
            code="table-header",
        )  # fmt: skip
    names = [name.strip() for name in header[1]]
    if len(names) == 1 and is_header(names[0]):
        raise ComArmorError(
            "the columns are not separated by commas", where=Origin(file, 1),
            help=f"expected the header {','.join(COLUMNS)}", code="table-header",
        )  # fmt: skip
    order = column_order(names, Origin(file, header[0]))
    written = (record for record in records if record[1])  # not the empty lines
    for number, (line, fields) in enumerate(written, 1):
        if number > MOST_ROWS:
            raise ComArmorError(
                f"the table has more than the {MOST_ROWS:,} rows allowed", where=Origin(file, line), code="table-limit"
            )
        if len(fields) != len(names):
            yield ComArmorError(
                f"the row has {counted(len(fields), 'field')}, expected {len(names)} as in the header",
                where=Origin(file, line), help='a field with a comma is written in quotes: "a,b"', code="table-row",
            )  # fmt: skip
            continue
        *texts, source = (strip(fields[at]) if at >= 0 else "" for at in order)
        try:
            yield TableRow.of(texts, row_origin(file, line, source))
        except ComArmorError as error:
            yield error


def _text(content: bytes, file: str) -> io.TextIOWrapper:
    try:
        content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ComArmorError(
            "the table is not UTF-8", where=Origin(file, line), help="save it as CSV in UTF-8", code="table-encoding"
        ) from None
    return io.TextIOWrapper(io.BytesIO(content), "utf-8-sig", newline="")  # a text of it may take four times the memory


def _records(text: io.TextIOWrapper, file: str) -> Iterator[tuple[int, list[str]]]:
    """Yield each record, with its first line."""
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
        raise ComArmorError(
            f"the row is not valid CSV: {error}", where=Origin(file, line),
            help='a field with a quote is written in quotes, with the quote doubled: "a""b"', code="table-row",
        ) from None  # fmt: skip
