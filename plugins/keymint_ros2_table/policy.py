# SPDX-License-Identifier: Apache-2.0
"""Make a policy of the rows of tables: a profile for each expression of subjects, and a rule for each row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

from keymint_comarmor import require_policies
from keymint_comarmor.loaded import ComArmorPolicy

import comarmor
from comarmor.language import attachments
from comarmor.language.attachments import PLACEHOLDERS, TunableReference
from comarmor.language.loading import load_included
from comarmor.language.syntax import Attachment, Inclusion, Profile, ProfileRule, expected_of_subject
from comarmor.patterns.expression import literal
from comarmor.rules import PERMISSIONS, Effect
from comarmor.text import did_you_mean, quote
from comarmor.values import Data, field, replace
from keymint.api import PolicySource
from keymint.errors import Defects, Diagnostic, KeymintError, Origin, require_none
from keymint_ros2_table.files import read
from keymint_ros2_table.rows import TableRow

INCLUDE = "include"
"""The kind of a row whose object is a file of the policy library; its rules are those of the subjects."""
_AUDIT = {"": False, "0": False, "1": True, "false": False, "true": True}
_MOST_DIAGNOSTICS = 100
_MOST_CHARACTERS = 32 * 2**20
"""The most characters of all expressions."""
_Part = ProfileRule | Inclusion


def load(
    sources: Sequence[PolicySource],
    library: Path | None = None,
    library_shown: Path | None = None,
    _packages: object = None,
) -> ComArmorPolicy:
    """Load tables as one policy; see :meth:`keymint.api.PolicyType.load`.

    Raises:
        KeymintError: with ``file:row`` of each defect, and the source of the row.
    """
    maker = _PolicyMaker(library, library_shown)
    for source in sources:
        require_policies([source], "a CSV file or an SQLite database")
        maker.add(source.path)
    require_none(maker.defects.found)
    profiles = (
        Profile(text, False, (subject,), (), tuple(maker.parts[text]), subject.where)
        for text, subject in maker.subjects.items()
    )
    return ComArmorPolicy(comarmor.Policy(tuple(profiles), MappingProxyType(maker.seen)))


class _PolicyMaker(Data, frozen=False):
    """Collects the rules of rows by subject, and every defect.

    Attributes:
        library: folder of the policy library.
        library_shown: its path in origins.
        seen: fingerprints of all files.
        subjects: the subjects of each profile, by their expression.
        parts: the rules of each profile.
        defects: all that were found.
        included: the rules of files of the library.
        characters: those of the expressions so far.
    """

    library: Path | None
    library_shown: Path | None
    seen: dict[Path, bytes] = field(default_factory=dict)
    subjects: dict[str, Attachment] = field(default_factory=dict)
    parts: dict[str, list[_Part]] = field(default_factory=dict)
    defects: Defects = field(default_factory=Defects)
    included: dict[str, tuple[_Part, ...]] = field(default_factory=dict)
    characters: int = 0

    def add(self, path: Path) -> None:
        """Add the rules of a table."""
        with self.defects:
            rows, seen = read(path)
            self.seen |= seen
            for row in rows:
                self._collect(row)

    def _collect(self, row: TableRow | KeymintError) -> None:
        """Collect the rules of a row, or its defects.

        Raises:
            KeymintError: with the last one of too many.
        """
        try:
            if isinstance(row, KeymintError):
                raise row
            subject = self._subject(row)
            self.parts.setdefault(subject, []).extend(self._of(row))
        except KeymintError as error:
            self.parts.clear()  # there is no policy
            is_limit = any(each.code == "table-limit" for each in error.diagnostics)
            if is_limit or len(self.defects.found) >= _MOST_DIAGNOSTICS:
                raise
            self.defects.found += error.diagnostics

    def _subject(self, row: TableRow) -> str:
        """Return the expression of a row's subjects."""
        if row.subject not in self.subjects:
            subject = self._expression("subject", row.subject, row.where)
            if subject.value:
                message = "the subject cannot contain {name} or {namespace}"
                raise KeymintError(message, where=row.where, help="use a wildcard", code="brace")
            if expected := expected_of_subject(subject.text):
                message = f"{quote(literal(subject.text) or '')} is not a legal name of a subject"
                raise KeymintError(message, where=row.where, help=expected, code="subject-name")
            self.subjects[row.subject] = replace(subject, where=row.origin)
        return row.subject

    def _of(self, row: TableRow) -> tuple[_Part, ...]:
        """Return the rules of a row."""
        if row.kind == INCLUDE:
            return self._include(row)
        if row.kind not in PERMISSIONS:
            raise _unknown("kind", row.kind, (*PERMISSIONS, INCLUDE), row.where)
        if row.permission not in PERMISSIONS[row.kind]:
            raise _unknown(f"permission of {row.kind}", row.permission, PERMISSIONS[row.kind], row.where)
        if row.qualifier not in tuple(Effect):
            raise _unknown("qualifier", row.qualifier, tuple(Effect), row.where)
        if row.audit.lower() not in _AUDIT:
            raise _unknown("value of audit", row.audit, ("0", "1", "false", "true"), row.where)
        name = replace(self._expression("object", row.object, row.where), where=row.origin)
        audit = _AUDIT[row.audit.lower()]
        return (ProfileRule(Effect(row.qualifier), row.kind, (row.permission,), (name,), (), audit, row.origin),)

    def _expression(self, column: str, text: str, where: Origin) -> Attachment:
        if not text:
            raise KeymintError(f"the {column} is empty", where=where, help="for any name write *", code="expression")
        if not text.isprintable():
            raise KeymintError(
                f"the {column} has characters that cannot be printed: {quote(text)}", where=where, code="expression"
            )
        self.characters += len(text)
        if self.characters > _MOST_CHARACTERS:
            message = f"the expressions have more than the {_MOST_CHARACTERS:,} characters allowed"
            raise KeymintError(message, where=where, code="table-limit")
        try:
            pieces = attachments.parse(text)
        except KeymintError as error:
            raise error.at(where) from None
        value = tuple(piece for piece in pieces if not isinstance(piece, TunableReference))
        if len(value) != len(pieces):
            raise KeymintError(
                f"the {column} cannot contain a tunable: {quote(text)}", where=where,
                help=f"a table has none; write a row for each value, or {' or '.join(PLACEHOLDERS)}", code="brace",
            )  # fmt: skip
        return Attachment.of(value, where)

    def _include(self, row: TableRow) -> tuple[_Part, ...]:
        """Return the rules of a file of the library, which the row includes."""
        if row.permission or row.qualifier or _AUDIT.get(row.audit.lower(), True):
            raise KeymintError(
                "a row that includes a file has no permission, qualifier or audit", where=row.where,
                help="leave them empty: the file has its own", code="table-value",
            )  # fmt: skip
        if row.object not in self.included:
            if self.library is None:
                message = "there is no policy library to include from"
                raise KeymintError(message, where=row.where, code="include-missing")
            try:
                policy = load_included(row.object, row.where.file, self.library, self.library_shown)
            except KeymintError as error:
                raise KeymintError.of(_placed_at(each, row.where) for each in error.diagnostics) from None
            self.seen |= policy.seen
            self.included[row.object] = policy.profiles[0].parts
        return tuple(_moved(part, row.origin) for part in self.included[row.object])


def _moved(part: _Part, where: Origin) -> _Part:
    """Return rules of an included file as a row includes them: the last place of each chain is the row."""
    if isinstance(part, Inclusion):
        return Inclusion(part.rules, (*part.chain[:-1], where))
    names = tuple(replace(each, where=_included(each.where, where)) for each in part.attachments)
    return replace(part, attachments=names, where=_included(part.where, where))


def _placed_at(diagnostic: Diagnostic, where: Origin) -> Diagnostic:
    """Return a defect of an included file as a row includes it, or of the include itself as one of the row."""
    inner = diagnostic.where
    return replace(diagnostic, where=_included(inner, where) if inner and inner.chain else where)


def _included(inner: Origin, where: Origin) -> Origin:
    return replace(inner, chain=(*inner.chain[:-1], where))


def _unknown(what: str, value: str, known: Sequence[str], where: Origin) -> KeymintError:
    message = f"{quote(value)} is no {what}" if value else f"the {what} is missing"
    help_ = did_you_mean(value, known, f"expected {', '.join(known)}")
    return KeymintError(message, where=where, help=help_, code="table-value")
