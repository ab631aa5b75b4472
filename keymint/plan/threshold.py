# SPDX-License-Identifier: Apache-2.0
"""When a document is due for renewal: after a part of its validity, or some time before its end."""

from __future__ import annotations

from datetime import datetime, timedelta

from comarmor.values import dataclass


@dataclass(frozen=True, slots=True)
class Threshold:
    """When something is due for renewal.

    Attributes:
        share: after this part of its validity, from 0 to 1.
        left: if it ends within this time; None if the share counts. It is due after half of its validity at the
            earliest, so that what is shorter is not renewed again and again.
    """

    share: float = 0.66
    left: timedelta | None = None

    def moment(self, first: datetime, last: datetime) -> datetime:
        """Return from when on something with this validity is due, in whole seconds."""
        if self.left is None:
            after = first + (last - first) * self.share
        else:
            after = max(last - self.left, first + (last - first) / 2)
        return after.replace(microsecond=0)


DEFAULT = Threshold()
"""Two thirds of the validity, as ``step ca renew`` has it."""
