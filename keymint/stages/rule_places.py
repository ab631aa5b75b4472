# SPDX-License-Identifier: Apache-2.0
"""Say where rules are in the policy now: a package keeps its sources while only the lines of its rules move."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin
from keymint.api import LoadedPolicy
from keymint.errors import KeymintError
from keymint.names import name_of
from keymint.workspace.policy_loading import lazy_policy
from keymint.workspace.session import Session


class RulePlaces:
    """The places of the rules of packages in the policy as it is now.

    Args:
        session: the workspace and its profile.
        policy: its policy; loaded at the first diagnostic about a rule if it is not given.
    """

    def __init__(self, session: Session, policy: LoadedPolicy | None = None) -> None:
        self._session = session
        self._policy = policy
        self._moved = functools.cache(self._moves)

    def in_policy(self, diagnostics: Iterable[Diagnostic], subject: str = "") -> tuple[Diagnostic, ...]:
        """Return diagnostics about built packages with the places that their rules have now.

        Args:
            diagnostics: the diagnostics, which cite the places that the sources of the packages state.
            subject: whose diagnostics these are; if empty, each names its own.
        """
        return tuple(self._now(each, subject or each.subject) for each in diagnostics)

    def _now(self, diagnostic: Diagnostic, subject: str) -> Diagnostic:
        where = diagnostic.where
        if where is None or not subject:
            return diagnostic
        place = self._moved(subject).get(where)
        return replace(diagnostic, where=place) if place else diagnostic

    def _moves(self, subject: str) -> Mapping[Origin, Origin]:
        """Return the rules that moved: their places in the policy by those that the sources state."""
        try:
            stated = self._session.package(name_of(subject)).grant.rules.rules
            if self._policy is None:
                self._policy = lazy_policy(self._session)
            present = self._policy.rules(subject)
        except KeymintError:  # another stage says what is wrong with the package or the policy
            return {}
        now = present.rules if present else ()
        pairs = list(zip(stated, now, strict=False))
        if len(stated) != len(now) or any(old != replace(new, origin=old.origin) for old, new in pairs):
            return {}  # the sources have other rules than the policy
        moved = [(old.origin, new.origin) for old, new in pairs if old.origin != new.origin]
        return {old.alone(): new.alone() for old, new in moved} | dict(moved)  # some diagnostics leave out the includes
