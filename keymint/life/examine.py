# SPDX-License-Identifier: Apache-2.0
"""Judge what enclaves have before it is replaced: whose keys they are, which rights stay good, and who has no sources.

A signed document stays good until it ends, so its holder may still present it. A key has one owner: with that of
another, each could act as the other.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from itertools import chain

from comarmor.values import replace
from keymint import api
from keymint.api import BuildType, Counterexample, Package
from keymint.authority.authority_files import authority_keys
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.life.terms import iso_time
from keymint.life.workspace_register import register_of
from keymint.names import subject_of
from keymint.pki import certificates, keys, smime
from keymint.pki.distinguished_names import to_text
from keymint.workspace import installed_enclaves
from keymint.workspace.installed_enclaves import CERTIFICATE, INSTALLED, enclave_names, installed_certificate
from keymint.workspace.package_build_types import build_types_of
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import IDENTITY_KEYS, key_place, key_remedy, known_fingerprint, recorded_key

_AGAIN = "make a new key on the robot: 'keymint request --rekey', with --discard if a request waits for its answer"
RIGHTS_OUTLIVE = "rights-outlive"
"""Code of the finding on earlier rights that are wider than the present ones, and stay good."""
IGNORED, ORPHANED = "enclave-ignored", "enclave-orphaned"
"""Codes of the findings on installed enclaves without a visible source package."""


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
        f"'keymint issued {name} --tolerate' keeps them"
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
            folder = f"{session.workspace.install / layout.enclaves}/{package.name}"
            if not session.tree.try_read(f"{folder}/{CERTIFICATE}"):
                continue  # without it nobody can present the rest, and a new fleet has nothing there
            there = {file: session.tree.try_read(f"{folder}/{file}") or b"" for file in after}
            if found := _compared(build_type, package, there, after, there[CERTIFICATE]):
                lost, gained = found[0].excess, found[0].missing
                said = [f"only the former ones permit to {_endpoint(lost)}"] if lost else []
                said += [f"only the new ones to {_endpoint(gained)}"] if gained else []
                if said:
                    message = f"the new signed rights differ from those that they replace: {'; '.join(said)}"
                    help_ = f"if unintended, see whether the robots have {session.profile.distro}, as <distro> says"
                    where = session.workspace.origin(folder)
                    yield Diagnostic.warning("rights-changed", message, where, help_, package.subject)


def _compared(
    build_type: BuildType, package: Package, before: Mapping[str, bytes], after: Mapping[str, bytes], certificate: bytes
) -> tuple[api.DocumentComparison, datetime] | None:
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


# -- owners of keys --------------------------------------------------------------------------------------------------


class Keyring:
    """The known keys of subjects and authorities, to compare the stored key of a subject with.

    Args:
        session: the workspace and its profile, with the authorities as they will be.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._authorities = authority_keys(session)
        self._requested: dict[str, str] = {}

    def require_own(self, package: Package, key: keys.PublicKey) -> str:
        """Require that the key of a package is its subject's, and nobody else's; returns its fingerprint.

        Args:
            package: the package.
            key: its public key.

        Raises:
            KeymintError: it is an authority's key, was replaced, or belongs to another subject.
        """
        name, session = package.name, self._session
        if package.issuance.public_key:
            return self.require_free(name, key)
        state, fingerprint = session.state, keys.fingerprint(key)
        if fingerprint in self._authorities:
            owner = f"the authority {self._authorities[fingerprint]!r}"
            raise _shared(session, name, owner, "key-of-authority")
        known = known_fingerprint(session, name)
        if known and known != fingerprint:
            message = f"is not the private key that {subject_of(name)} had: it was replaced"
            raise KeymintError(message, where=key_place(session, name), help=key_remedy(name), code="key-replaced")
        if recorded_key(state, IDENTITY_KEYS, name) != fingerprint:  # so it may not be its own
            for other in self._owners.get(fingerprint, ()):
                if other != name:
                    raise _shared(session, name, subject_of(other))
        return fingerprint

    def require_free(self, name: str, key: keys.PublicKey) -> str:
        """Require that a key whose private half is elsewhere is nobody else's; returns its fingerprint.

        It may differ from the one that the subject had: an authority decided so in the sources.

        Args:
            name: the package.
            key: its public key.

        Raises:
            KeymintError: it is an authority's key, or belongs to another subject.
        """
        fingerprint = keys.fingerprint(key)
        owner = f"the authority {self._authorities[fingerprint]!r}" if fingerprint in self._authorities else ""
        others = [other for other in self._owners.get(fingerprint, ()) if other != name]
        if owner or others:
            raise KeymintError(
                f"the public key of {subject_of(name)} is that of {owner or subject_of(others[0])}",
                where=self._session.issuance_place(name),
                help="make a new key with 'keymint request' on the machine of this subject, then run 'keymint sign'",
                code="key-of-authority" if owner else "key-shared",
            )
        return fingerprint

    def require_certifiable(self, package: Package, public_key: bytes, where: Origin) -> None:
        """Require that a key which a request brings can be certified for a package.

        Args:
            package: the package.
            public_key: the key, PEM.
            where: the file of the request.

        Raises:
            KeymintError: it is of another kind, was revoked, or is an authority's, another package's, or one that an
                earlier request brought for another package.
        """
        name, session, key = package.name, self._session, keys.public_from_pem(public_key, where)
        spec, fingerprint = package.identity.key, keys.fingerprint(key)
        if not keys.fits(key, spec):
            message = f"is not for {keys.key_description(spec)}, which {package.identity.origin} asks for"
            help_ = "make a key of that kind on the robot (keymint request --key-type), or change the sources"
            raise KeymintError(message, where=where, help=help_, code="key-kind")
        if reason := register_of(session).barred(fingerprint):
            message = f"is for a key that was revoked ({reason})"
            raise KeymintError(message, where=where, help=_AGAIN, code="key-barred")
        self.require_free(name, key)
        of_packages = (
            f"has the key of {subject_of(other)}, so that each could act as the other"
            for other in session.packages()
            if other != name and session.issuance(other).public_key == public_key
        )
        certified = (
            f"has a key that was certified for /{each.name} before"
            for each in register_of(session).certificates.values()
            if each.key == fingerprint and each.name not in {"", name}
        )
        message = next(chain(of_packages, certified), "")
        if not message and (other := self._requested.setdefault(fingerprint, name)) != name:
            message = f"has the key that {subject_of(other)} asks a certificate for"
        if message:
            raise KeymintError(message, where=where, help=_AGAIN, code="key-shared")

    @functools.cached_property
    def _owners(self) -> Mapping[str, Sequence[str]]:
        """Packages by the fingerprints of their keys."""
        recorded = self._session.state.stamps.get(IDENTITY_KEYS, {})
        owners: dict[str, list[str]] = {}
        for name in sorted({*recorded, *enclave_names(self._session)}):
            if name in recorded:
                owners.setdefault(recorded[name].inputs, []).append(name)
            elif certificate := installed_certificate(self._session, name):
                owners.setdefault(certificates.fingerprint(certificate), []).append(name)
        return owners


def shared_keys(inputs: Inputs, fingerprints: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Yield an error for each key that two packages have; takes fingerprints by package."""
    owners: dict[str, str] = {}
    for name, fingerprint in fingerprints.items():
        other = owners.setdefault(fingerprint, name)
        if other != name:
            found = _shared(inputs, name, subject_of(other)).diagnostics
            yield from (replace(each, subject=subject_of(name)) for each in found)


def _shared(inputs: Inputs, name: str, owner: str, code: str = "key-shared") -> KeymintError:
    """Return the error for a subject that has the key of another one, or of an authority."""
    message = f"is the private key of {owner} as well, so that each could act as the other"
    return KeymintError(message, where=key_place(inputs, name), help=key_remedy(name), code=code)


# -- enclaves without sources ----------------------------------------------------------------------------------------


def orphan_findings(session: Session, *, pruned: bool = False) -> Iterator[Diagnostic]:
    """Yield a finding for each installed enclave without a visible source package.

    Args:
        session: the workspace and its profile.
        pruned: those that no marker hides are removed.
    """
    for name, marker in installed_enclaves.unknown_enclaves(session):
        subject = subject_of(name)
        if marker is not None:
            message = f"hides the source package of the installed enclave {subject}, which is not checked or updated"
            where, help_ = session.workspace.origin(marker), "remove this file, or the enclave"
            yield Diagnostic.warning(IGNORED, message, where, help_, subject)
        elif not pruned:
            message = f"the enclave {subject} is installed, but has no source package"
            where = session.workspace.origin(session.enclave_folder(name))
            help_ = f"'keymint create {name}' makes the package again; 'keymint install --prune' removes the enclave"
            yield Diagnostic.warning(ORPHANED, message, where, help_, subject)
