# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: findings on installed enclaves, and on the router's configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin
from comarmor.text import quoted
from keymint.api import Inspection, SharedInspection
from keymint.errors import KeymintError
from keymint.names import name_of
from keymint_ros2_zenoh.credentials import check_credentials, first_common_name
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.documents.read import read
from keymint_ros2_zenoh.emission import common_name, enclaves_of
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SESSION
from keymint_ros2_zenoh.hazards import hazards
from keymint_ros2_zenoh.settings import is_router

_INSTALL = "'keymint build' and 'keymint install' write the document of the sources"


def check(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on one installed enclave; codes are stable."""
    return tuple(_enclave(inspection))


def check_all(inspections: Sequence[Inspection]) -> tuple[Diagnostic, ...]:  # noqa: ARG001 - an interface
    """Return nothing: what concerns several enclaves stands in the router's file."""
    return ()


def check_shared(inspection: SharedInspection) -> tuple[Diagnostic, ...]:
    """Return findings on the router's configuration; its signature is one of the trust anchors. Codes are stable."""
    return tuple(_router(inspection))


def _enclave(inspection: Inspection) -> Iterator[Diagnostic]:
    package = inspection.package
    names = (CERTIFICATE, KEY, IDENTITY_CA, *(() if is_router(package) else (SESSION,)))
    restore = f"'keymint install {package.name}' writes it again"
    for name in names:
        if name not in inspection.files and not (name == KEY and package.issuance.public_key):
            where = Origin(f"{inspection.folder}/{name}")
            yield Diagnostic.error("file-missing", "is missing", where, restore, package.subject)
    if is_router(package) and SESSION in inspection.files:
        where = Origin(f"{inspection.folder}/{SESSION}")
        message = "is the configuration of a session, but this enclave is the router's"
        yield Diagnostic.warning("file-unexpected", message, where, "remove it", package.subject)
    yield from check_credentials(inspection)
    found, built = inspection.files.get(SESSION), inspection.documents.get(SESSION)
    if found is None or built is None or is_router(package):
        return
    file = f"{inspection.folder}/{SESSION}"
    help_ = f"'keymint build -f {package.name}' and 'keymint install {package.name}' write the document of the sources"
    for each in (*_drift(found, built, file, help_), *_session(found, built, file)):
        yield replace(each, subject=package.subject, help=each.help or help_)


def _drift(found: bytes, built: bytes, file: str, help_: str) -> Iterator[Diagnostic]:
    if found != built:
        message = "the sources build another document: they changed, or the built one was edited by hand"
        yield Diagnostic.warning("drift", message, Origin(file), help_)


def _session(found: bytes, built: bytes, file: str) -> Iterator[Diagnostic]:
    """Yield what is unsafe about a session's configuration."""
    try:
        configuration = read(found, file)
    except KeymintError as error:
        yield from error.diagnostics
        return
    expected = read(built, file)
    yield from hazards(configuration, expected, file)
    [router] = expected.access_control.subjects
    names = [subject.common_names for subject in configuration.access_control.subjects]
    if names != [router.common_names]:
        message = (
            f"the only subject of its access control must be the router, {quoted(router.common_names[0])}: otherwise "
            "others can stand for the router"
        )
        where = configuration.place("access_control/subjects", file)
        yield Diagnostic.error("zenoh-router-pin", message, where)


def _router(inspection: SharedInspection) -> Iterator[Diagnostic]:
    found, built = inspection.files.get(ROUTER), inspection.documents.get(ROUTER)
    file = f"{inspection.folder}/{ROUTER}"
    if found is None:
        return  # reported already
    if built is not None:
        yield from _drift(found, built, file, _INSTALL)
    try:
        configuration = read(found, file)
    except KeymintError as error:
        yield from error.diagnostics
        return
    findings = list(hazards(configuration, read(built, file), file)) if built is not None else []
    for each in (*findings, *_subjects(inspection, configuration, file)):
        yield replace(each, help=each.help or _INSTALL)


def _subjects(inspection: SharedInspection, configuration: Configuration, file: str) -> Iterator[Diagnostic]:
    """Yield subjects without a package, packages without a subject, and certificates that the router does not know."""
    enclaves = {package.subject: common_name(package) for package in enclaves_of(inspection.packages)}
    named = {name: subject for subject in configuration.access_control.subjects for name in subject.common_names}
    for name, entry in named.items():
        if name not in enclaves.values():
            message = f"the common name {quoted(name)} has rights, but no package of the workspace has it"
            yield Diagnostic.error("zenoh-subject-unknown", message, entry.where)
    where = configuration.place("access_control/subjects", file)
    for subject, name in enclaves.items():
        if name not in named:
            message = f"the common name {quoted(name)} is missing: {subject} has no rights"
            yield Diagnostic.error("zenoh-subject-missing", message, where, _INSTALL, subject)
            continue
        shown = _installed_name(inspection.enclaves.get(subject, {}))
        if shown not in {None, name}:
            message = f"the certificate of {subject} has the common name {quoted(shown or '')}, not {quoted(name)}"
            place = Origin(f"{inspection.folder}/enclaves{subject}/{CERTIFICATE}")
            help_ = f"'keymint install {name_of(subject)}' writes it again"
            yield Diagnostic.error("zenoh-common-name", message, place, help_, subject)


def _installed_name(files: Mapping[str, bytes]) -> str | None:
    """Return the common name of an installed certificate; None if it cannot be read, which is reported elsewhere."""
    try:
        return first_common_name(files[CERTIFICATE])
    except (KeyError, KeymintError):
        return None
