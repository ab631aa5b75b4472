# SPDX-License-Identifier: Apache-2.0
"""What a run that installs is asked for."""

from __future__ import annotations

from dataclasses import replace

from comarmor.values import dataclass
from keymint.api import BuildOptions


@dataclass(frozen=True, slots=True)
class InstallRequest:
    """What a run that installs is asked for; all that conducts the stages gets the whole of it.

    Attributes:
        force: discard manual edits.
        renew: replace the private keys of subjects.
        prune: remove installed enclaves that have no source package.
        new_authority: authorities that get a new key and certificate.
        prove: refuse what is not proven.
        allow_vendor_specific: prove by the standards only; vendors may differ.
        strict: exceptions of claims count as not proven.
        revoke_superseded: revoke the certificates of packages whose new signed rights are narrower.
        build: options of the build; None for those that each package was built with last.
    """

    force: bool = False
    renew: bool = False
    prune: bool = False
    new_authority: tuple[str, ...] = ()
    prove: bool = True
    allow_vendor_specific: bool = False
    strict: bool = False
    revoke_superseded: bool = False
    build: BuildOptions | None = None

    def resumed(self, *, resumes: bool) -> InstallRequest:
        """Return what is left to do if an interrupted run made the new keys already."""
        return replace(self, new_authority=(), renew=False) if resumes else self
