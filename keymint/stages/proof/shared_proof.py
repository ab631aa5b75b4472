# SPDX-License-Identifier: Apache-2.0
"""What proofs need of the documents over all packages: their files, and tasks about claims across subjects."""

from __future__ import annotations

from collections.abc import Mapping

from keymint import __version__
from keymint.api import BuildOptions
from keymint.authority.authority_files import chains_digest
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.stages.shared_documents import STAGE, build_shared, load_packages, record_key, sources_digest, users
from keymint.stages.shared_install import installed_shared
from keymint.view.stamps import digest, digest_files
from keymint.workspace.installed_enclaves import INSTALLED, enclave_files, installed
from keymint.workspace.session import Session, once


@once
def installed_documents(session: Session, build_type: str) -> Mapping[str, bytes]:
    """Return the installed shared documents of a build type, by path; none if it has none.

    Raises:
        KeymintError: one cannot be read; or there is no record of the documents, and a package has defects.
    """
    if build_type not in users(session):
        return {}
    if built := session.state.stamp(STAGE, record_key(build_type)):
        return installed_shared(session, built.outputs)
    accepting = BuildOptions(allow_vendor_specific=True)
    made = build_shared(session, build_type, load_packages(session, build_type), accepting)
    return installed_shared(session, made.documents)


@once
def documents_digest(session: Session, build_type: str) -> str:
    """Return the digest of the installed shared documents of a build type, or of why they cannot be read."""
    if build_type not in users(session):
        return ""
    try:
        return digest_files(installed_documents(session, build_type))
    except KeymintError as error:
        return digest(repr(error.diagnostics))


def enclaves_of(session: Session, build_type: str) -> Mapping[str, Mapping[str, bytes]]:
    """Return the files of a build type in the installed enclaves, by subject and name."""
    own = session.plugins.build_type(build_type).files(session.profile.layout)
    found: dict[str, Mapping[str, bytes]] = {}
    for name in users(session)[build_type]:
        files, _ = enclave_files(session, name)  # unreadable ones are findings on the enclave
        if files:
            found[subject_of(name)] = {file: content for file, content in files.items() if file in own}
    return found


def inputs_digest(session: Session, build_type: str, enclaves: Mapping[str, Mapping[str, bytes]]) -> str:
    """Return the digest of everything that claims across subjects depend on, except the policy.

    Args:
        session: the workspace and its profile.
        build_type: name of the build type.
        enclaves: files of its enclaves.
    """
    of_enclaves = (part for subject, files in enclaves.items() for part in (subject, digest_files(files)))
    sources = sources_digest(session, build_type)
    return digest(sources, documents_digest(session, build_type), chains_digest(session), __version__, *of_enclaves)


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
