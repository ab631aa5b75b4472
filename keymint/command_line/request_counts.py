# SPDX-License-Identifier: Apache-2.0
"""Read hints for the order of rules: how often subjects request access, from a CSV file of counts or from a graph.

A file of counts is CSV (RFC 4180) with a header line::

    subject,permission,object,count
    /amr1/nav,ros_publish,/amr1/cmd_vel,36000

A column ``partition`` is optional. In a graph every edge counts once.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence

from comarmor.rules import KIND_OF
from comarmor.text import did_you_mean, quantity
from keymint.api import Hint, graph_json
from keymint.api.graph import Edge, Object
from keymint.errors import Defects, KeymintError, Origin

COLUMNS = ("subject", "permission", "object", "count")
OPTIONAL = ("partition",)
MAX_COUNT = 2**63
_INVALID = "hints-invalid"


def load_hints(content: bytes, name: str) -> tuple[Hint, ...]:
    """Return the requested edges of a file with their counts, sorted.

    Args:
        content: a graph in JSON, or counts in CSV; UTF-8.
        name: the file as the user would type it, for messages.

    Raises:
        KeymintError: the file is neither; with a diagnostic for every invalid line.
    """
    if graph_json.recognises(content):
        return tuple(Hint(edge, 1) for edge in graph_json.load(content, name).edges)
    rows = csv.reader(graph_json.decoded_text(content, name, _INVALID).splitlines(), strict=True)
    counts: Counter[Edge] = Counter()
    defects = Defects()
    try:
        columns = [each.strip() for each in next(rows, [])]
        if len(set(columns)) != len(columns) or not set(COLUMNS) <= set(columns) <= {*COLUMNS, *OPTIONAL}:
            message = f"the first line is {','.join(columns)!r}, not the names of the columns"
            raise _error(name, 1, message, f"write {','.join(COLUMNS)!r}, or use a graph by 'keymint discover'")
        for row in filter(None, rows):
            with defects:
                edge, times = _counted(columns, row, name, rows.line_num)
                counts[edge] += times
    except csv.Error as error:
        raise _error(name, rows.line_num, f"not CSV: {error}") from None
    defects.require_none()
    return tuple(Hint(edge, times) for edge, times in sorted(counts.items()))


def _counted(columns: Sequence[str], fields: Sequence[str], name: str, line: int) -> tuple[Edge, int]:
    if len(fields) != len(columns):
        raise _error(name, line, f"has {quantity(len(fields), 'field')} instead of {len(columns)}")
    row = dict(zip(columns, fields, strict=True))
    subject, permission, text = (row[column].strip() for column in ("subject", "permission", "object"))
    if not graph_json.legal_subject(subject):
        raise _error(name, line, f"{subject!r} is not a subject name", "write the full name, e.g. '/robot/arm'")
    kind = KIND_OF.get(permission)
    if kind is None:
        help_ = did_you_mean(permission, KIND_OF, f"one of {', '.join(KIND_OF)}")
        raise _error(name, line, f"there is no permission {permission!r}", help_)
    partition = row.get("partition", "").strip()
    if not text or not graph_json.legal_text(text) or not graph_json.legal_text(partition):
        raise _error(name, line, "the object, or its partition, is empty, too long or has control characters")
    count = row["count"].strip()
    if not (count.isascii() and count.isdigit() and len(count) < len(str(MAX_COUNT))):
        raise _error(name, line, f"{count!r} is not a count", "write an integer from 0")
    if partition and kind != "topic":
        raise _error(name, line, f"a {kind} has no partition", "leave it empty")
    return Edge(subject, permission, Object(kind, text, (partition,) if partition else ())), int(count)


def _error(name: str, line: int, message: str, help_: str = "") -> KeymintError:
    return KeymintError(message, where=Origin(name, line), help=help_, code=_INVALID)
