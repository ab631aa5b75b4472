# SPDX-License-Identifier: Apache-2.0
"""Judge the authorities, and the private keys of all.

Keys and certificates of authorities may not match, be replaced, or expire soon. Of the private keys it is asked where
those of authorities are, whether they are stored as asked, and who has seen them.

Others have seen a key that they could read before it was taken over, or that is in a repository: one that git tracks,
or that ``git add`` would add.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

from cryptography import x509

from comarmor.values import replace
from keymint.api import ValidityTerm
from keymint.authority import authority_files, examine
from keymint.authority.authorities import key_copies
from keymint.authority.authority_files import AuthorityFiles, authority_keys, other
from keymint.errors import Defects, Diagnostic, KeymintError, Origin
from keymint.host.git import GIT_MISSING, run_git
from keymint.life import terms
from keymint.life.workspace_register import register_of
from keymint.names import subject_of
from keymint.pki import certificates, keys
from keymint.workspace.installed_enclaves import installed_certificate
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import key_defects
from keymint.workspace.workspace import GITIGNORE


def authorities(session: Session, within: timedelta) -> Iterator[Diagnostic]:
    """Yield the findings on the keys and certificates of all authorities."""
    issuers: dict[str, x509.Certificate] = {}
    fingerprints: dict[str, str] = {}
    for authority in authority_files.in_order(session.profile.authorities):
        files = authority_files.read_files(session, authority)
        key: keys.PublicKey | None = None
        if authority.certificate.key.uri:
            yield from key_copies(files)
        elif files.key is not None:
            try:
                key = authority_files.load_private_key(session, files).public_key()
                fingerprints[authority.name] = keys.fingerprint(key)
            except KeymintError as error:
                yield from key_defects(error)
        if files.content is None:
            message = f"the authority {authority.name!r} has no certificate"
            help_ = f"restore it; {authority_files.new_authority_help(authority.name)}"
            if files.key or authority.certificate.key.uri:
                help_ = "'keymint install' restores it"
            yield Diagnostic.error("authority-missing", message, files.certificate_file, help_)
            continue
        yield from _certificate(files, key, issuers)
        if files.certificate is not None:
            issuers[authority.name] = files.certificate
            fingerprints.setdefault(authority.name, certificates.fingerprint(files.certificate))
            what, period = f"the certificate of {authority.name!r}", certificates.period(files.certificate)
            term = ValidityTerm("authority", what, files.certificate_file, (period,))
            for found in terms.findings([term], session.now, "", within):
                yield replace(found, help=found.help.replace("renew'", f"renew {authority.name}'"))
    with Defects() as defects:
        examine.require_own_keys(session, fingerprints)
    yield from defects.found


def _certificate(
    files: AuthorityFiles, key: keys.PublicKey | None, issuers: Mapping[str, x509.Certificate]
) -> Iterator[Diagnostic]:
    """Check a certificate against its key, the certificates in use, and the profile."""
    spec, certificate = files.authority.certificate, files.certificate
    defects = examine.certificate_contradictions(files, key)
    if certificate is None:
        help_ = "'keymint install' restores it" if files.key else "restore it from a backup"
        defects = tuple(replace(defect, help=help_) for defect in defects)
    yield from defects
    if defects or certificate is None:
        return
    public, issuer = certificates.public_key(certificate), issuers.get(spec.issuer)
    if not authority_files.satisfies(files.content or b"", spec, public, issuer):
        message = f"the certificate of {files.name!r} is not the one that the profile specifies"
        help_ = "run 'keymint install', which reissues it for the same key, and redeploy all enclaves"
        yield Diagnostic.error("authority-drift", message, files.certificate_file, help_)


_MOST = 64 * 1024
"""Bytes up to which a file is searched for a private key."""
_LIST = ("-c", "core.fsmonitor=false", "-c", "core.hooksPath=/dev/null", "ls-files", "-z")
"""Lists files without starting programs that the repository's configuration names."""


# -- private keys ---------------------------------------------------------------------------------------------------


def encryption(session: Session) -> Iterator[Diagnostic]:
    """Yield a warning for each private key of an authority that is stored plain, although the profile asks otherwise.

    The PEM says whether a key is encrypted (:func:`keymint.pki.keys.is_encrypted`), so no password is needed.
    """
    for authority in session.profile.authorities:
        if not authority.certificate.key.password_env:
            continue
        for name in filter(None, (authority.name, other(authority))):
            path = session.workspace.authority_key(name)
            pem = session.tree.try_read(path)
            if pem is not None and not keys.is_encrypted(pem):
                message = f"is not encrypted, although {authority.certificate.origin} asks for that"
                help_ = f"'keymint authority encrypt {authority.name}' encrypts it; backups still hold the plain key"
                yield Diagnostic.warning("key-plain", message, session.workspace.origin(path), help_)


EXPOSURES = frozenset({"key-was-exposed", "key-tracked", "key-exposed", "file-mode"})
"""Codes of findings on secrets that others can read, or could read."""


def exposed_keys(session: Session) -> Iterator[Diagnostic]:
    """Yield a warning for each private key in use, or with a certificate in force, that others could read once.

    The sources remember its fingerprint. A new key has another one, but ends no certificate of the former.
    """
    workspace, trusted = session.workspace, authority_keys(session)
    for each in session.profile.authorities:
        if each.issuance.exposed in trusted:
            where = workspace.origin(workspace.authority_key(each.name))
            help_ = f"'keymint authority replace {each.name}' ends it"
            yield _exposed(f"private key of the authority {each.name!r}", where, help_)
    for name in session.packages():
        with suppress(KeymintError):  # reported with the package
            if fingerprint := session.issuance(name).exposed:
                whose, ends = f"private key of {subject_of(name)}", f"'keymint revoke {name} --reason superseded'"
                certificate = installed_certificate(session, name)
                if certificate and fingerprint == certificates.fingerprint(certificate):
                    help_ = f"'keymint renew --rekey {name}', then {ends}"
                    yield _exposed(whose, session.issuance_place(name), help_, subject_of(name))
                elif any(each.key == fingerprint for each in register_of(session).in_force(name, session.now)):
                    whose = f"former {whose}, whose certificate is in force,"
                    yield _exposed(whose, session.issuance_place(name), f"{ends} ends it", subject_of(name))


def _exposed(whose: str, where: Origin, help_: str, subject: str = "") -> Diagnostic:
    message = f"others could read the {whose} before it was taken over: it counts as exposed"
    return Diagnostic.warning("key-was-exposed", message, where, help_, subject)


# -- git ------------------------------------------------------------------------------------------------------------


def git_exposure(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield the findings on the private keys in all spaces; none without a repository or without git."""
    kept = {name: each for name, each in inputs.environment.items() if not name.startswith("GIT_") or "CONFIG" in name}
    # So git only reads the repository of a space.
    environment = {**kept, "LC_ALL": "C", "GIT_OPTIONAL_LOCKS": "0", "GIT_TERMINAL_PROMPT": "0"}
    for space in inputs.workspace.spaces():
        folder = space.resolve()
        if any(os.path.lexists(above / ".git") for above in (folder, *folder.parents)):
            yield from _of_space(inputs, space, environment)


def _of_space(inputs: Inputs, space: Path, environment: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Yield one finding for all private keys of a space that git tracks, and one for all that it would add."""
    files = (Path(path) for path, is_folder in inputs.tree.walk(space) if not is_folder)
    found = [path for path in files if _is_secret(inputs, path)]
    if not found:
        return
    try:
        tracked = _listed(space, "--cached", environment)
        added = _listed(space, "--others", environment)
    except KeymintError as error:
        defect = error.diagnostics[0]
        if defect.code != GIT_MISSING:
            message = f"whether git tracks private keys is unknown: {defect.message}"
            yield Diagnostic.note("git-unknown", message, inputs.workspace.origin(space))
        return
    end = "'git rm --cached' it, and replace it, since whoever has the repository has it"
    stop = f"write the line '*' into {inputs.workspace.shown(space / GITIGNORE)}"
    for listed, code, what, help_ in (
        (tracked, "key-tracked", "that git tracks", end),
        (added - tracked, "key-exposed", "that 'git add' would take", stop),
    ):
        exposed = [path for path in found if not listed.isdisjoint((path, *path.parents))]
        exposed = [path for path in exposed if not keys.is_all_public(inputs.tree.try_read(path) or b"")]
        if exposed:
            more = f", like {len(exposed) - 1} more" if len(exposed) > 1 else ""
            message = f"is a private key {what}{more}"
            yield Diagnostic.error(code, message, inputs.workspace.origin(exposed[0]), help_)


def _listed(space: Path, which: str, environment: Mapping[str, str]) -> frozenset[Path]:
    """Return the files below a space that git lists; a repository inside of it is one entry."""
    names = run_git((*_LIST, which, "--exclude-standard", "--", "."), space, environment).split(b"\0")
    return frozenset(space / os.fsdecode(name.removesuffix(b"/")) for name in names if name)


def _is_secret(inputs: Inputs, path: Path) -> bool:
    """Tell whether a file contains a private key; in the private space all files do."""
    if path.is_relative_to(inputs.workspace.private):
        return path.name != GITIGNORE
    status = inputs.tree.status(path)
    try:
        return status is not None and status.st_size <= _MOST and keys.has_private_key(inputs.tree.read(path) or b"")
    except KeymintError:
        return False
