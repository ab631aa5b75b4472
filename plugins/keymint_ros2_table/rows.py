# SPDX-License-Identifier: Apache-2.0
"""The columns of a table of rules, and its rows as texts."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.errors import ComArmorError, Origin, library_name
from comarmor.text import did_you_mean, quoted
from comarmor.values import dataclass

REQUIRED = ("subject", "kind", "permission", "object", "qualifier")
OPTIONAL = ("audit", "source")
COLUMNS = (*REQUIRED, *OPTIONAL)
MOST_ROWS = 200_000
"""The most rows of a table."""
_LONGEST_SOURCE = 500


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row of a table, as it is written.

    Attributes:
        subject: expression of subjects.
        kind: kind of the object, or ``include``.
        permission: one permission of that kind.
        object: expression of objects.
        qualifier: ALLOW or DENY.
        audit: whether requests are logged.
        where: where the row is, with what its column ``source`` says.
        origin: where its rules come from: the same, but without a number that changes when other rows of a database do,
            if there is a source.
    """

    subject: str
    kind: str
    permission: str
    object: str
    qualifier: str
    audit: str
    where: Origin
    origin: Origin

    @classmethod
    def of(cls, texts: Sequence[str], where: Origin, origin: Origin | None = None) -> TableRow:
        """Return the row with the texts of all columns but the source, in the order of :data:`COLUMNS`."""
        subject, kind, permission, object_, qualifier, audit = texts
        return cls(subject, kind, permission, object_, qualifier, audit, where, origin or where)


def column_order(header: Sequence[str], where: Origin) -> tuple[int, ...]:
    """Return the position of each of :data:`COLUMNS` in a header; -1 for an optional one that is not there.

    Raises:
        ComArmorError: a column is missing, unknown or there twice.
    """
    for at, name in enumerate(header):
        if name not in COLUMNS:
            raise ComArmorError(
                f"the column {quoted(name)} is unknown", where=where, code="table-header",
                help=did_you_mean(name, COLUMNS, f"known are {', '.join(COLUMNS)}"),
            )  # fmt: skip
        if name in header[:at]:
            raise ComArmorError(
                f"there are two columns {quoted(name)}", where=where, help="remove one of them", code="table-header"
            )
    if missing := [name for name in REQUIRED if name not in header]:
        raise ComArmorError(
            f"the column {missing[0]} is missing", where=where, code="table-header",
            help=f"expected are {', '.join(REQUIRED)}, and perhaps {' and '.join(OPTIONAL)}",
        )  # fmt: skip
    return tuple(header.index(name) if name in header else -1 for name in COLUMNS)


def row_origin(file: str, number: int, source: str) -> Origin:
    """Return the place of a row: its source, the table in brackets, and the number of the row.

    If there is a source, the place names no file that exists, so that nothing takes the row for a part of that file:
    rules of the policy library are treated in their own way.

    Args:
        file: path of the table as the user would type it.
        number: the row's line in a CSV file, or its number in a view, from 1.
        source: what the row says about where it comes from; may be empty.

    Raises:
        ComArmorError: the source is too long, or names the policy library.
    """
    if not source:
        return Origin(file, number)
    if len(source) > _LONGEST_SOURCE:
        raise ComArmorError(
            f"the source is longer than {_LONGEST_SOURCE} characters", where=Origin(file, number), code="table-value"
        )
    shown = f"{source} [{file.rpartition('/')[2]}]"
    if library_name(shown) is not None:
        raise ComArmorError(
            "the source names a file of the policy library, which this row is not from", where=Origin(file, number),
            help="name what the row was made from, or leave it empty", code="table-value",
        )  # fmt: skip
    return Origin(shown, number)
