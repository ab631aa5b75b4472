# SPDX-License-Identifier: Apache-2.0
"""Rows of CSV files."""

from __future__ import annotations

import pytest
from keymint_ros2_table.rows import TableRow, is_header, rows_of_csv

from comarmor.errors import ComArmorError
from tests.plugins.keymint_ros2_table.tables import HEADER


def rows(text: str | bytes) -> list[TableRow | ComArmorError]:
    return list(rows_of_csv(text if isinstance(text, bytes) else text.encode(), "t.csv"))


def message(text: str | bytes) -> str:
    with pytest.raises(ComArmorError) as error:
        rows(text)
    return str(error.value.diagnostics[0])


def test_columns_in_any_order_blanks_quotes_and_empty_lines() -> None:
    found = rows('source,object,subject,qualifier,permission,kind\n\n"a, ""b""\nc", /x ,/s,ALLOW,p,k\r\n')
    (row,) = found
    assert isinstance(row, TableRow)
    assert (row.subject, row.kind, row.permission, row.object, row.qualifier, row.audit) == (
        "/s", "k", "p", "/x", "ALLOW", ""
    )  # fmt: skip
    assert (row.where.file, row.where.line, row.where.source) == ("t.csv", 3, 'a, "b"\nc')
    assert str(row.where) == 'a, "b"\nc [t.csv]:3'
    assert row.origin == row.where


def test_a_byte_order_mark_is_no_part_of_the_header() -> None:
    assert rows(b"\xef\xbb\xbf" + HEADER.encode()) == []


def test_an_escaped_blank_at_the_end_stays() -> None:
    (row,) = rows(HEADER + "/s,k,p, /x\\  ,ALLOW,,\n")
    assert isinstance(row, TableRow)
    assert row.object == "/x\\ "


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "t.csv: the table is empty (expected the header subject,kind,permission,object,qualifier,audit,source)"),
        (HEADER.replace(",", ";"), "t.csv:1: the columns are not separated by commas"),
        (HEADER.replace("kind", "knd"), "t.csv:1: the column 'knd' is unknown (did you mean 'kind'?)"),
        (HEADER.replace("kind,", ""), "t.csv:1: the column kind is missing"),
        (HEADER.replace("audit", "kind"), "t.csv:1: there are two columns 'kind'"),
        (HEADER.encode() + b"/s,k,p,/\xff,ALLOW,,\n", "t.csv:2: the table is not UTF-8"),
        (HEADER + '/s,k,p,"/x"y,ALLOW,,\n', "t.csv:2: the row is not valid CSV"),
        (HEADER + '/s,k,p,"/x\n', "t.csv:2: the row is not valid CSV"),
    ],
)
def test_a_file_that_cannot_be_read(text: str | bytes, said: str) -> None:
    assert message(text).startswith(said)


def test_a_row_with_other_fields_and_one_with_a_long_source_are_errors_of_the_row() -> None:
    found = rows(f"{HEADER}/s,k,p\n/s,k,p,/x,ALLOW,,{'a' * 501}\n/s,k,p,/x,ALLOW,,ok\n")
    *errors, row = found
    assert isinstance(row, TableRow)
    assert [str(each).partition(" (")[0] for each in errors] == [
        "t.csv:2: the row has 3 fields, expected 7 as in the header",
        "t.csv:3: the source is longer than 500 characters",
    ]


def test_there_may_be_no_more_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("keymint_ros2_table.rows.MOST_ROWS", 2)
    assert len(rows(HEADER + 2 * "/s,k,p,/x,ALLOW,,\n")) == 2
    assert message(HEADER + 3 * "/s,k,p,/x,ALLOW,,\n") == "t.csv:4: the table has more than the 2 rows allowed"


@pytest.mark.parametrize(
    ("line", "is_one"),
    [(HEADER, True), (HEADER.replace(",", ";"), True), ("Subject\tObject\tKind", True), ("a,b,c", False), ("", False)],
)
def test_headers(line: str, is_one: bool) -> None:
    assert is_header(line) is is_one
