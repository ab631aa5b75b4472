# SPDX-License-Identifier: Apache-2.0
"""The rules about the files of an enclave, and what vouches for them and for the router's file.

An enclave cannot vouch for itself, and no session or router looks at the signature over the router's file: CMS in DER
(RFC 5652), for Keymint and ``openssl cms``. So proofs compare both with the authorities of the workspace
(:func:`differences`); ``keymint check`` also says what the sources would make otherwise (:func:`check`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import timedelta
from functools import lru_cache

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from comarmor.text import quote
from comarmor.values import replace
from keymint.api import EnclaveFiles, Inspection, TrustAnchor, ValidityTerm
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.names import name_of
from keymint.pki import certificates, cms, der, extensions
from keymint.pki.examine import IdentityCheck, anchor_defects, certificate_terms
from keymint_ros2_zenoh.decision import first_common_name, lacking_usage, names_host
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, ROUTER, SESSION, SIGNATURE
from keymint_ros2_zenoh.examine import configurations
from keymint_ros2_zenoh.identities import common_name, enclaves_of, router_of
from keymint_ros2_zenoh.settings import ACCESS, IDENTITY, is_router, settings_of

_RESTORED = "'keymint install' restores it"
_INSTALL = "'keymint build' and 'keymint install' write the document of the sources"


def differences(enclave: EnclaveFiles) -> tuple[Diagnostic, ...]:
    """Return what the workspace's authorities do not vouch for; see :meth:`keymint.api.Prover.differences`."""
    anchors = enclave.anchors
    identity, access = anchors.authorities[IDENTITY], anchors.authorities[ACCESS]
    if missing := tuple(anchor_defects((identity, access))):
        return missing
    rules = IdentityCheck(enclave.files, enclave.folder, _RESTORED)
    needed = (CERTIFICATE, IDENTITY_CA) if anchors.public_key else (CERTIFICATE, KEY, IDENTITY_CA)
    own = (*rules.inventory(needed), *rules.anchored(IDENTITY_CA, identity), *rules.identity(identity.chain, anchors))
    # An encrypted key cannot be read without its password.
    readable = (each for each in own if each.code != "key-password")
    return (*readable, *router_differences(enclave.shared, enclave.shared_folder, access))


def router_differences(shared: Mapping[str, bytes], shared_folder: str, access: TrustAnchor) -> tuple[Diagnostic, ...]:
    """Return why the router's file is not what the authority that signs the rights signed.

    Args:
        shared: installed shared files by path.
        shared_folder: the folder of these paths, as the user would type it.
        access: the authority.
    """
    if absent := tuple(IdentityCheck(shared, shared_folder, _RESTORED).inventory((ROUTER, SIGNATURE))):
        return absent
    problem = signature_problem(shared[ROUTER], shared[SIGNATURE], access.chain)
    if not problem:
        return ()
    help_ = "find out who wrote it before 'keymint install' signs the file that the sources build"
    return (Diagnostic.error("zenoh-signature", problem, Origin(f"{shared_folder}/{SIGNATURE}"), help_),)


@lru_cache(maxsize=16)  # all enclaves rest on the same file
def signature_problem(content: bytes, signature: bytes, authority: bytes) -> str:
    """Return why a signature is not one by an authority over a router's configuration; empty if it is.

    Args:
        content: the router's configuration.
        signature: the detached signature.
        authority: PEM of the authority that must have made it, first.
    """
    try:
        parsed = cms.parse(signature)
    except ValueError as error:
        return f"is not a detached signature: {error}"
    signer = certificates.load_first(authority, with_lists=True)
    if cms.verify(parsed, content, signer):
        return ""
    if parsed.certificate != der.der_of(signer):  # compared unread: it may be damaged
        return "is by another certificate than that of the authority that signs the rights"
    return "is not over the configuration beside it: one of them was altered, or is older than the other"


def terms(enclave: EnclaveFiles) -> tuple[ValidityTerm, ...]:
    """Return the periods of the certificates of an enclave; see :meth:`keymint.api.Prover.terms`.

    Rights have no dates: they end with the certificate.

    Raises:
        KeymintError: a file is missing, or is no certificate.
    """
    return tuple(certificate_terms(enclave.files, enclave.folder, (CERTIFICATE, IDENTITY_CA)))


def check(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on one installed enclave; codes are stable."""
    return tuple(_EnclaveCheck(inspection).findings())


def check_shared(inspection: Inspection) -> tuple[Diagnostic, ...]:
    """Return findings on the router's configuration; its signature is one of the trust anchors. Codes are stable."""
    content, file = inspection.files.get(ROUTER), f"{inspection.folder}/{ROUTER}"
    if content is None:
        return ()  # reported already
    names = {package.subject: common_name(package) for package in enclaves_of(inspection.packages)}

    def of_router(found: Configuration) -> Iterator[Diagnostic]:
        yield from configurations.holders(found, names)
        for subject, name in names.items():  # certificates that the router knows by another name, or not at all
            try:
                shown = first_common_name(inspection.enclaves[subject][CERTIFICATE])
            except (KeyError, KeymintError):  # reported elsewhere
                continue
            if shown != name:
                message = f"the certificate of {subject} has the common name {quote(shown)}, not {quote(name)}"
                place = Origin(f"{inspection.folder}/enclaves{subject}/{CERTIFICATE}")
                help_ = f"'keymint install {name_of(subject)}' writes it again"
                yield Diagnostic.error("zenoh-common-name", message, place, help_, subject)

    return tuple(configurations.check_findings(content, inspection.documents[ROUTER], file, _INSTALL, of_router))


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
        for each in configurations.check_findings(
            content, built, file, help_, lambda found: configurations.pin_findings(found, router)
        ):
            yield replace(each, subject=self._subject, help=each.help or help_)
