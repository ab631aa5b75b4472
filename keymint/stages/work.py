# SPDX-License-Identifier: Apache-2.0
"""What is planned so far, and the workspace as it will be then."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import Self

from comarmor.errors import Diagnostic
from comarmor.values import dataclass
from keymint.store.changes import Plan
from keymint.view.stamps import State
from keymint.workspace.session import Inputs, Session


@dataclass(frozen=True, slots=True)
class Work:
    """What is planned so far, and the workspace as it will be once that is carried out.

    This is the only place that adds a plan to others and takes it into account for those that follow.

    Attributes:
        session: the workspace after all plans, with its profile as it is then.
        parts: the plans in the order in which they are carried out, each with the name of what made it, or none.
    """

    session: Session
    parts: tuple[tuple[str, Plan], ...] = ()

    @classmethod
    def after(cls, inputs: Inputs, plan: Plan) -> Self:
        """Return the work that begins with the plan of a profile.

        Raises:
            KeymintError: the new profile has defects.
        """
        return cls(inputs.after(plan).session(), (("", plan),))

    def then(self, plan: Plan, part: str = "", *, before: str = "") -> Self:
        """Return this work followed by a plan that was made on top of it.

        Args:
            plan: the plan. If it changes the profile, that is loaded again.
            part: what made it.
            before: the plan takes its place before this part, which was needed to make it and is carried out later.

        Raises:
            KeymintError: the changed profile has defects.
        """
        if not plan.steps and not plan.first and plan.state is self.session.state:
            return self.noting(*plan.diagnostics) if plan.diagnostics else self
        after = self.session.after(plan)
        profile = f"{self.session.workspace.profile}/"
        if any(f"{change.folder}/".startswith(profile) for change in plan.changes()):
            after = after.session()
        names = [name for name, _ in self.parts]
        place = names.index(before) if before and before in names else len(names)
        return replace(self, session=after, parts=(*self.parts[:place], (part, plan), *self.parts[place:]))

    def noting(self, *diagnostics: Diagnostic, part: str = "") -> Self:
        """Return this work with further diagnostics."""
        noted = Plan((), self.session.state, diagnostics)
        return replace(self, parts=(*self.parts, (part, noted))) if diagnostics else self

    def recording(self, state: State) -> Self:
        """Return this work with another record."""
        return replace(self, session=replace(self.session, state=state))

    def of(self, *names: str) -> Plan:
        """Return the plan of some parts, or of all if none is named; its record is that of the whole work."""
        parts = (plan for name, plan in self.parts if name in names or not names)
        return replace(reduce(Plan.then, parts, Plan((), self.session.state)), state=self.session.state)

    @property
    def plan(self) -> Plan:
        """All plans as one."""
        return self.of()
