# SPDX-License-Identifier: Apache-2.0
"""What proofs need of the documents over all packages: their files, and tasks about claims across subjects."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence

from keymint import __version__
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.plan.enclaves import INSTALLED, enclave_files, installed
from keymint.plan.shared_documents import Users, record_key, shared_folder, sources_digest, users
from keymint.plan.shared_install import shared_files
from keymint.session import Session
from keymint.state import digest, digest_files


class SharedReader:
    """Reads the installed shared documents, once.

    Args:
        session: the workspace and its profile.
        unsigned: the documents are about to be signed: messages cite the unsigned ones in the build space.
    """

    def __init__(self, session: Session, *, unsigned: bool) -> None:
        self._session = session
        workspace = session.workspace
        self.folder = workspace.shown(shared_folder(session) if unsigned else workspace.install)
        """The folder that paths are relative to, as messages show it."""

    @functools.cached_property
    def users(self) -> Users:
        """The packages of each build type that has shared documents; errors as :func:`users`."""
        return users(self._session)

    def files(self, build_type: str) -> Mapping[str, bytes]:
        """Return the installed shared documents of a build type, by path; none if it has none.

        Raises:
            KeymintError: one cannot be read.
        """
        found = self._read.get(build_type, {})
        if isinstance(found, KeymintError):
            raise KeymintError.of(found.diagnostics)
        return found

    def digest(self, build_type: str) -> str:
        """Return the digest of the installed shared documents of a build type, or of why they cannot be read."""
        return self._digests.get(build_type, "")

    @functools.cached_property
    def _read(self) -> Mapping[str, Mapping[str, bytes] | KeymintError]:
        found: dict[str, Mapping[str, bytes] | KeymintError] = {}
        for name, names in self.users.items():
            try:
                found[name] = shared_files(self._session, name, names)
            except KeymintError as error:
                found[name] = error
        return found

    @functools.cached_property
    def _digests(self) -> Mapping[str, str]:
        return {
            name: digest(repr(found.diagnostics)) if isinstance(found, KeymintError) else digest_files(found)
            for name, found in self._read.items()
        }

    def enclaves(self, build_type: str) -> Mapping[str, Mapping[str, bytes]]:
        """Return the files of a build type in the installed enclaves, by subject and name."""
        own = self._session.plugins.build_type(build_type).files(self._session.profile.layout)
        found: dict[str, Mapping[str, bytes]] = {}
        for name in self.users[build_type]:
            files, _ = enclave_files(self._session, name)  # unreadable ones are findings on the enclave
            if files:
                found[subject_of(name)] = {file: content for file, content in files.items() if file in own}
        return found

    def inputs_digest(
        self, names: Sequence[str], enclaves: Mapping[str, Mapping[str, bytes]], build_type: str, chains: str
    ) -> str:
        """Return the digest of everything that claims across subjects depend on, except the policy.

        Args:
            names: the packages of the build type.
            enclaves: files of their enclaves.
            build_type: name of the build type.
            chains: digest of the certificates of the authorities.
        """
        of_enclaves = (part for subject, files in enclaves.items() for part in (subject, digest_files(files)))
        return digest(sources_digest(self._session, names), self.digest(build_type), chains, __version__, *of_enclaves)


def affected(before: Session, after: Session) -> tuple[str, ...]:
    """Return the packages with an enclave whose shared documents a plan installs, sorted.

    Args:
        before: the workspace before the plan.
        after: the workspace after it.
    """
    names: set[str] = set()
    for build_type, of_type in users(after).items():
        key = record_key(build_type)
        if before.state.stamp(INSTALLED, key) != after.state.stamp(INSTALLED, key):
            names |= set(of_type)
    return tuple(sorted(names.intersection(installed(after)))) if names else ()
