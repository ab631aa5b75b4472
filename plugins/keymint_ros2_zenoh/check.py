# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: findings on installed enclaves, and on the router's configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import timedelta
from itertools import chain

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from comarmor.errors import Diagnostic, Origin
from comarmor.text import quoted
from keymint.api import Inspection, SharedInspection
from keymint.errors import KeymintError
from keymint.names import name_of
from keymint.pki import extensions
from keymint.pki.identity_check import IdentityCheck
from keymint_ros2_zenoh import configuration_requirements
from keymint_ros2_zenoh.decision.admission import first_common_name, lacking_usage, names_host
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.emission import common_name, enclaves_of, router_of
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SESSION
from keymint_ros2_zenoh.settings import is_router, settings_of

_INSTALL = "'keymint build' and 'keymint install' write the document of the sources"


def check(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on one installed enclave; codes are stable."""
    return tuple(_EnclaveCheck(inspection).findings())


def check_all(inspections: Sequence[Inspection]) -> tuple[Diagnostic, ...]:  # noqa: ARG001 - an interface
    """Return nothing: what concerns several enclaves stands in the router's file."""
    return ()


def check_shared(inspection: SharedInspection) -> tuple[Diagnostic, ...]:
    """Return findings on the router's configuration; its signature is one of the trust anchors. Codes are stable."""
    content, file = inspection.files.get(ROUTER), f"{inspection.folder}/{ROUTER}"
    if content is None:
        return ()  # reported already
    names = {package.subject: common_name(package) for package in enclaves_of(inspection.packages)}

    def of_router(found: Configuration) -> Iterator[Diagnostic]:
        yield from configuration_requirements.holders(found, names, file)
        yield from _installed_names(inspection, names)

    return tuple(_examined(content, inspection.documents[ROUTER], file, _INSTALL, of_router))


def _examined(
    content: bytes, built: bytes, file: str, help_: str, more: Callable[[Configuration], Iterable[Diagnostic]]
) -> Iterator[Diagnostic]:
    """Yield findings on a configuration.

    Args:
        content: the installed one.
        built: what the sources build.
        file: the installed file as the user would type it.
        help_: help for findings without one.
        more: returns further findings on what it says.
    """
    if content != built:
        message = "the sources build another document: they changed, or the built one was edited by hand"
        yield Diagnostic.warning("drift", message, Origin(file), help_)
    try:
        found = read(content, file)
    except KeymintError as error:
        yield from error.diagnostics
        return
    usual = (
        configuration_requirements.as_built(found, read(built, file), file),
        configuration_requirements.open_default(found, file),
    )
    for each in (*chain(*usual), *configuration_requirements.entries(found), *more(found)):
        yield replace(each, help=each.help or help_)


def _installed_names(inspection: SharedInspection, names: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Yield certificates that the router knows by another name, or not at all."""
    for subject, name in names.items():
        try:
            shown = first_common_name(inspection.enclaves[subject][CERTIFICATE])
        except (KeyError, KeymintError):  # reported elsewhere
            continue
        if shown != name:
            message = f"the certificate of {subject} has the common name {quoted(shown)}, not {quoted(name)}"
            place = Origin(f"{inspection.folder}/enclaves{subject}/{CERTIFICATE}")
            help_ = f"'keymint install {name_of(subject)}' writes it again"
            yield Diagnostic.error("zenoh-common-name", message, place, help_, subject)


class _EnclaveCheck(IdentityCheck):
    """One enclave under inspection."""

    def __init__(self, inspection: Inspection) -> None:
        package = inspection.package
        restore = f"'keymint install {package.name}' writes it again"
        super().__init__(inspection.files, inspection.folder, restore, package.subject)
        self._inspection = inspection
        self._package = package
        self._is_router = is_router(package)

    def findings(self) -> Iterator[Diagnostic]:
        elsewhere = [KEY] if self._package.issuance.public_key else []
        needed = (CERTIFICATE, KEY, IDENTITY_CA, *(() if self._is_router else (SESSION,)))
        yield from self.inventory(name for name in needed if name not in elsewhere)
        if self._is_router and SESSION in self._files:
            message = "is the configuration of a session, but this enclave is the router's"
            yield self._warning("file-unexpected", SESSION, message, "remove it")
        yield from self.certificate_period((self._inspection.now, timedelta(days=self._inspection.within_days)))
        if self.certificate is not None:
            yield from self._usage(self.certificate)
        yield from self._session()

    def _usage(self, certificate: x509.Certificate) -> Iterator[Diagnostic]:
        """Yield what a certificate lacks, or has too much: a router is a server of its host, all others are clients."""
        usage = extensions.value(certificate, x509.ExtendedKeyUsage)
        if lacking := lacking_usage(certificate, server=self._is_router):
            message = f"its extendedKeyUsage lacks {lacking}, and Zenoh refuses it"
            yield self._error("zenoh-key-usage", CERTIFICATE, message)
        if not self._is_router and usage is not None and ExtendedKeyUsageOID.SERVER_AUTH in usage:
            message = "is also for servers: its holder could pretend to be a router where names are not checked"
            yield self._warning("zenoh-key-usage", CERTIFICATE, message, self._restore)
        host = settings_of(self._package).router.host
        if self._is_router and not names_host(certificate, host):
            message = f"its subjectAltName lacks the router's host {host!r}, so that no session connects to it"
            yield self._error("zenoh-host-name", CERTIFICATE, message)

    def _session(self) -> Iterator[Diagnostic]:
        """Yield what is unsafe about the configuration of the sessions."""
        content, built = self._files.get(SESSION), self._inspection.documents.get(SESSION)
        if content is None or built is None:  # a router has none
            return
        name, file = self._package.name, f"{self._inspection.folder}/{SESSION}"
        help_ = f"'keymint build -f {name}' and 'keymint install {name}' write the document of the sources"
        router = common_name(router_of(self._package))
        for each in _examined(
            content, built, file, help_, lambda found: configuration_requirements.pin_findings(found, router, file)
        ):
            yield replace(each, subject=self._subject, help=each.help or help_)
