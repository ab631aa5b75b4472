# SPDX-License-Identifier: Apache-2.0
"""Rights that were signed before: a signed document stays good until it ends, so its holder may still present it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime

from comarmor.errors import Diagnostic, Severity
from keymint.api import BuildType, Counterexample, DocumentComparison, Package
from keymint.errors import KeymintError
from keymint.life.terms import iso_time
from keymint.pki import certificates, smime
from keymint.pki.distinguished_names import to_text
from keymint.workspace.installed_enclaves import CERTIFICATE, INSTALLED
from keymint.workspace.package_build_types import build_types_of
from keymint.workspace.session import Session

RIGHTS_OUTLIVE = "rights-outlive"
"""Code of the finding on earlier rights that are wider than the present ones, and stay good."""


def excess_of(subject: str, found: Counterexample | None, reason: str) -> str:
    """Return in words what an earlier document permits a subject beyond its rights: an example, or why it may."""
    what = f"e.g. to {_endpoint(found)}" if found else f"perhaps: {reason}"
    return f"rights that were signed before allow {subject} more than the policy, {what}"


def outliving_rights(session: Session, name: str, subject: str, excess: str, until: datetime) -> Diagnostic:
    """Return the note on an earlier document of a package.

    Args:
        session: the workspace and its profile.
        name: the package.
        subject: whom the document permits too much.
        excess: what :func:`excess_of` returned.
        until: its end, UTC.
    """
    message = f"{excess}; whoever has its key may present them until {iso_time(until)}"
    help_ = (
        f"'keymint revoke {name} --reason superseded' ends them, as does --revoke-superseded; "
        f"'keymint issued {name} --accept' keeps them"
    )
    return Diagnostic.note(RIGHTS_OUTLIVE, message, session.package_marker(name), help_, subject)


def replaced_rights(
    session: Session, package: Package, before: Mapping[str, bytes], after: Mapping[str, bytes]
) -> Iterator[Diagnostic]:
    """Yield a warning for each signed document of an enclave that permits more than the one that replaces it.

    Also one for each that nobody here installed and that gives other rights; it may lie where another layout has it, as
    in workspaces of 2018.

    Args:
        session: the workspace and its profile.
        package: the package.
        before: the files of its enclave by name.
        after: the files that replace them.
    """
    for build_type in build_types_of(session, package).values():
        if CERTIFICATE in before and (found := _compared(build_type, package, before, after, after[CERTIFICATE])):
            comparison, until = found[0], min(found[1], certificates.load(after[CERTIFICATE]).not_valid_after_utc)
            if (comparison.excess or comparison.reason) and until >= session.now:
                excess = excess_of(package.subject, comparison.excess, comparison.reason)
                note = outliving_rights(session, package.name, package.subject, excess, until)
                yield replace(note, severity=Severity.WARNING)
        for layout in build_type.LAYOUTS.values() if session.state.stamp(INSTALLED, package.name) is None else ():
            folder = session.workspace.install / layout.enclaves / package.name
            there = {file: session.tree.try_read(folder / file) or b"" for file in after}
            if found := _compared(build_type, package, there, after, there[CERTIFICATE]):
                lost, gained = found[0].excess, found[0].missing
                said = [f"only the former ones permit to {_endpoint(lost)}"] if lost else []
                said += [f"only the new ones to {_endpoint(gained)}"] if gained else []
                if said:
                    message = f"the new signed rights differ from those that they replace: {'; '.join(said)}"
                    help_ = (
                        "if that was not intended, see whether the robots have "
                        f"{session.profile.distro}, as <distro> says"
                    )
                    where = session.workspace.origin(folder)
                    yield Diagnostic.warning("rights-changed", message, where, help_, package.subject)


def _compared(
    build_type: BuildType, package: Package, before: Mapping[str, bytes], after: Mapping[str, bytes], certificate: bytes
) -> tuple[DocumentComparison, datetime] | None:
    """Return how an earlier document compares with the rules of a package, and its end; None if it gives no rights.

    Also None if the new document is the same.
    """
    presentation = build_type.presentation
    if presentation is None:
        return None
    with suppress(KeymintError):  # what cannot be read gives no rights
        old, new = (smime.signed_content(files.get(presentation.FILE, b"")) for files in (before, after))
        if old != new and (until := presentation.presented_until(old)):
            return presentation.compared_with(old, to_text(certificates.load(certificate).subject), package), until
    return None


def _endpoint(found: Counterexample) -> str:
    return f"{found.endpoint.action} {found.endpoint.name!r}"
