# SPDX-License-Identifier: Apache-2.0
"""The packages that a command line names: by names, by patterns, by a file of both, and by their state."""

from __future__ import annotations

import codecs
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NoReturn

from comarmor.patterns.glob import matches, parse
from comarmor.patterns.tokens import SPECIAL
from comarmor.text import did_you_mean, quantity, quote
from comarmor.values import Data
from keymint.errors import Diagnostic, KeymintError, Origin, require_none
from keymint.life.terms import DEFAULT, Threshold
from keymint.names import package_name, subject_of, typed_subject
from keymint.run.run import Run
from keymint.view.tree import MAX_FILE
from keymint.workspace.session import Session

_STANDARD = Path("-")
_LISTED = "'keymint status' lists the packages"
Named = tuple[str, Origin | None]
"""A name or pattern, and its place if a file has it."""


@lru_cache(maxsize=1)  # standard input is there once, and a plan may be made twice
def _listed(run: Run, listed: Path) -> tuple[Named, ...]:
    """Return the names and patterns in a file; ``-`` is standard input.

    Raises:
        KeymintError: the file cannot be read, or names nothing; or as :func:`listed_names`.
    """
    from keymint.command_line.named_files import read_input  # noqa: PLC0415 - not needed for 'provision'

    is_standard = listed == _STANDARD
    content = run.setting.read(MAX_FILE + 1) if is_standard else read_input(run, listed)
    where = Origin("<standard input>" if is_standard else str(listed))
    if not (names := tuple(listed_names(content, where.file))):
        raise KeymintError("names no package", where=where, help="write a name a line", code="names-none")
    return names


class Names(Data):
    """What a command line names, before it is known what that stands for; false if it names nothing: all packages.

    Attributes:
        given: names, and patterns as policies have them.
        listed: a file with more of them.
        state: of those that are named, else of all.

    Options:
        listed: Also the subjects in this file ('-': standard input): a name or pattern on each line; '#' begins a
            comment.
        state: Only packages that are due for renewal, stale (sources or policy changed), or revoked.
    """

    given: tuple[str, ...]
    listed: Path | None = None
    state: str | None = None

    def __bool__(self) -> bool:
        return bool(self.given or self.listed or self.state)

    def _typed(self, run: Run) -> tuple[Named, ...]:
        """Return the names and patterns; errors as :func:`_listed`."""
        return *((each, None) for each in self.given), *(_listed(run, self.listed) if self.listed else ())

    def packages(
        self, run: Run, session: Session, known: Collection[str] | None = (), matched: Collection[str] = (),
        otherwise: str = "", threshold: Threshold = DEFAULT,
    ) -> tuple[str, ...]:  # fmt: skip
        """Return the packages that it stands for, in this order, each once; without a name or pattern, all known ones.

        Args:
            run: the run, which is told that no package is in the state.
            session: the workspace and its profile.
            known: what may be named, by default the source packages; None for any legal name.
            matched: what a pattern finds; by default what may be named.
            otherwise: the hint on a name if no known one is like it.
            threshold: when a package is due.

        Raises:
            KeymintError: a name is illegal or unknown, a pattern is none, or finds nothing; with all of these. Or the
                file cannot be read.
        """
        typed = self._typed(run)
        known = known if known is None else frozenset(known or session.packages())
        every = {subject_of(name): name for name in sorted(matched or known or ())}
        chosen: dict[str, None] = {} if typed else dict.fromkeys(every.values())
        defects: list[Diagnostic] = []
        for text, place in typed:
            try:
                chosen.update(dict.fromkeys(_found(session, text, known, every, otherwise)))
            except KeymintError as error:
                defects += error.at(place).diagnostics
        require_none(dict.fromkeys(defects))
        if self.state is None:
            return tuple(chosen)
        in_state = _in_state(session, self.state, chosen, threshold)
        if not (left := tuple(name for name in chosen if name in in_state)):
            run.console.line(f"no package is {self.state}")
        return left

    def confirm(self, run: Run, verb: str, names: Sequence[str]) -> tuple[Diagnostic, ...]:
        """Ask before something is done to packages that nobody named one by one; see :meth:`Run.confirm`.

        Args:
            run: the run.
            verb: what is done, e.g. ``revoke``.
            names: the packages that a pattern or a state stands for.
        """
        by_name = not self.state and not any(SPECIAL.search(text) for text, _ in self._typed(run))
        if run.resumes or not names or by_name:
            return ()
        subjects = ", ".join(map(subject_of, names))
        message = f"{quantity(len(names), 'package')} to {verb}, not named one by one: {subjects}"
        return run.confirm([Diagnostic.warning("names-by-pattern", message)])


def _found(
    session: Session, text: str, known: Collection[str] | None, matched: Mapping[str, str], otherwise: str
) -> Sequence[str]:
    """Return the packages of a name or a pattern, of those by subject; see :meth:`Names.packages`."""
    if SPECIAL.search(text):
        pattern = parse(typed_subject(text))
        found = [name for subject, name in matched.items() if matches(pattern, subject)]
        return found or _fail(session, f"matches {quote(text)}", otherwise or _LISTED)  # one like it is another robot
    name = package_name(text)
    if known is None or name in known:
        return (name,)
    near = map(subject_of, known) if text.startswith("/") else known
    return _fail(session, repr(name), did_you_mean(text, near, otherwise or f"'keymint create {name}' makes it"))


def _fail(session: Session, what: str, help_: str) -> NoReturn:
    place = session.workspace.shown(session.workspace.src)
    raise KeymintError(f"no package {what} in {place}", help=help_, code="package-unknown")


def _in_state(session: Session, state: str, names: Collection[str], threshold: Threshold) -> Collection[str]:
    """Return those of some packages that are in a state, and perhaps others."""
    # Few runs ask for a state.
    from keymint.life.renewal_schedule import installed_terms, schedule  # noqa: PLC0415
    from keymint.life.workspace_register import withdrawn  # noqa: PLC0415
    from keymint.stages.package_status import package_rows  # noqa: PLC0415
    from keymint.workspace.policy_loading import lazy_policy  # noqa: PLC0415

    if state == "revoked":
        return withdrawn(session)
    if state == "due":
        own = frozenset(session.packages())
        due = schedule(session, installed_terms(session, [name for name in names if name in own]), threshold)
        return [each.name for each in due.enclaves]
    return [row.package for row in package_rows(session, lazy_policy(session)) if row.stale]


def listed_names(content: bytes, file: str) -> Iterator[tuple[str, Origin]]:
    """Yield the names in a list, one a line, with their places; what follows ``#`` is a comment.

    Raises:
        KeymintError: a line is not UTF-8, or has characters that nobody sees.
    """
    for number, line in enumerate(content.removeprefix(codecs.BOM_UTF8).split(b"\n"), 1):
        where = Origin(file, number)
        try:
            name = line.decode().partition("#")[0].strip()
        except UnicodeDecodeError:
            raise KeymintError(
                "the list of subjects is not UTF-8", where=where, help="save it as UTF-8", code="subjects-invalid"
            ) from None
        if not name.isprintable():
            message = f"the subject has characters that cannot be printed: {quote(name)}"
            raise KeymintError(message, where=where, help="remove them", code="subjects-invalid")
        if name:
            yield name, where
