# SPDX-License-Identifier: Apache-2.0
"""What a keystore of another tool has, and what is wrong with it: the answer to ``keymint adopt``.

A revocation that got lost would be taken back, so that is an error. Whether vendors take the list of an enclave, and
whether it revokes the certificate beside it, are rules about every enclave
(:mod:`keymint_ros2_dds.examine.enclave_rules`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from cryptography import x509

from comarmor.text import hexadecimal, quantity
from comarmor.values import replace
from keymint.api import FoundAuthority, FoundEnclave, FoundKeystore, KeystoreFiles, TrustAnchor
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.pki import certificates, extensions, foreign_authorities, keys, revocation_lists
from keymint.pki.distinguished_names import to_text
from keymint.pki.revocation_lists import RevocationList
from keymint_ros2_dds import enclave_layout as layout
from keymint_ros2_dds.examine.adopted_enclave import dates_of, examine_enclave, exposure, is_exposed
from keymint_ros2_dds.examine.enclave_rules import AUTHORITY_FILES
from keymint_ros2_dds.keystores import foreign_documents
from keymint_ros2_dds.keystores.keystore_contents import FORMS, contents, places

_READ = frozenset(name for form in layout.LAYOUTS for name in layout.files(form))
"""Names of the files that participants read."""
_REVOCATIONS = "adopt-revocations"
_NAMES = {layout.IDENTITY_ROLE: "identity_ca", layout.PERMISSIONS_ROLE: "permissions_ca"}
BOTH = "ca"
"""Name of an authority that has both roles."""


def examine_keystore(keystore: KeystoreFiles) -> FoundKeystore:
    """Return what a keystore has: see :meth:`keymint.api.KeystoreReader.found`.

    Raises:
        KeymintError: it has no enclave.
    """
    return _ForeignKeystore(keystore).found()


class _ForeignKeystore:
    """One keystore under examination."""

    def __init__(self, keystore: KeystoreFiles) -> None:
        self._contents = contents(keystore)
        self._form, self._places, self._kept = places(self._contents)
        self._findings: list[Diagnostic] = []

    def found(self) -> FoundKeystore:
        """Return what the keystore has."""
        content, form = self._contents, self._form
        trusted = self._authorities()
        issuer = next((each for each in trusted if layout.IDENTITY_ROLE in each.roles), None)
        newest = self._newest_list(issuer) if issuer else ""
        listed = {layout.CRL: newest} if newest and not form else {}
        anchors = {
            role: TrustAnchor(each.name, str(content.place(each.file)), each.certificate)
            for each in trusted
            for role in each.roles
        }
        enclaves: list[FoundEnclave] = []
        for place in self._places:
            enclave, own = examine_enclave(content, replace(place, files={**place.files, **listed}), anchors)
            enclaves.append(enclave)
            self._findings += own
        defaults = self._defaults(enclaves, trusted)
        self._judge_doubles(enclaves)
        secrets = {content.read(path) for each in trusted for path in each.key_files}
        self._judge_keys(secrets)
        return FoundKeystore(
            form=FORMS[form],
            layout=form,
            subject_format="sros2" if all(each.subject_name == f"CN={each.subject}" for each in enclaves) else "",
            authorities=trusted,
            enclaves=tuple(enclaves),
            kept=tuple(path for path in self._kept if content.read(path) not in secrets),  # nor links to them
            defaults=defaults,
            diagnostics=tuple(self._findings),
            revocation_lists={issuer.name: content.read(newest)} if issuer and newest else {},
        )

    def _error(self, code: str, path: str, message: str, help_: str, subject: str = "") -> None:
        self._findings.append(Diagnostic.error(code, message, self._contents.place(path), help_, subject))

    def _defaults(self, enclaves: Sequence[FoundEnclave], trusted: Sequence[FoundAuthority]) -> Mapping[str, bytes]:
        """Return the governance as the source of all packages; report why it cannot become that."""
        governed = [each for each in enclaves if layout.GOVERNANCE_XML in each.documents]
        signer = next((each.name for each in trusted if layout.PERMISSIONS_ROLE in each.roles), "")
        if not governed or not signer:
            return {}
        first, document = governed[0], governed[0].documents[layout.GOVERNANCE_XML]
        path = first.files[layout.GOVERNANCE_P7S]
        for other in governed:
            if not foreign_documents.is_same(document, other.documents[layout.GOVERNANCE_XML]):
                than = f"{first.subject}, {self._contents.place(path)}"
                message = f"protects other topics or domains than the governance of {than}"
                help_ = "all participants of a domain need the same: adopt these enclaves as a keystore of their own"
                self._error("adopt-governance", other.files[layout.GOVERNANCE_P7S], message, help_, other.subject)
        made = foreign_documents.governance_source(document, signer)
        if made is None:
            message = "has several domain rules, and a profile's defaults have one"
            help_ = "sign a governance with one domain rule, which may have several domains"
            self._error("adopt-governance", path, message, help_)
        return {} if made is None else {layout.GOVERNANCE: made}

    def _judge_keys(self, secrets: Collection[bytes]) -> None:
        """Report each file that robots need and must not have, and each of which nobody can tell.

        Args:
            secrets: the files with an authority's private key.
        """
        content = self._contents
        own = {enclave.files[layout.KEY] for enclave in self._places if layout.KEY in enclave.files}
        needed = {path: each for each in self._places for name, path in each.files.items() if name in _READ}
        for path, enclave in needed.items():
            if content.read(path) in secrets:
                message = "has the private key of an authority, and participants read this file"
                help_ = "give the enclave a key of its own, and leave the authority's to private/"
                self._error("adopt-key-shared", path, message, help_, enclave.subject)
        sealed = set(map(content.read, content.sealed))
        for path in self._kept:
            if path in own or content.read(path) not in sealed:
                continue
            message = (
                "has a private key that cannot be read, perhaps an authority's, where robots' files are taken from"
            )
            help_ = "move it out of that folder, e.g. to private/, if no robot needs it; else decrypt it (openssl pkey)"
            self._error("adopt-key-sealed", path, message, help_)

    def _judge_doubles(self, enclaves: Sequence[FoundEnclave]) -> None:
        """Report a subject or a key that two enclaves have."""
        seen: dict[str, FoundEnclave] = {}
        for each in enclaves:
            key = keys.fingerprint(keys.public_of(each.key)) if each.key else ""
            for what, name in ((f"the subject {each.subject}", each.subject), ("one private key", key)):
                other = seen.setdefault(name, each) if name else each
                if other is not each:
                    message = f"has {what}, like {other.subject} ({other.facts['place']})"
                    help_ = "each enclave needs a name and a key of its own: remove one, or make a new key for it"
                    self._error("adopt-doubled", str(each.facts["place"]), message, help_, each.subject)

    # -- authorities -------------------------------------------------------------------------------------------------

    def _authorities(self) -> tuple[FoundAuthority, ...]:
        """Return the authorities that the first enclaves trust.

        The other enclaves are compared with them (:meth:`keymint_ros2_dds.examine.enclave_rules.EnclaveRules.trust`).
        """
        trusted: dict[str, str] = {}
        for role, name in AUTHORITY_FILES.items():
            for enclave in self._places:
                if path := enclave.files.get(name) or enclave.files.get(layout.CA):
                    trusted.setdefault(role, path)
        by_content: dict[bytes, list[str]] = {}
        for role, path in trusted.items():
            by_content.setdefault(self._contents.read(path), []).append(role)
        judged = (self._authority(trusted[roles[0]], roles) for roles in map(tuple, by_content.values()))
        found = tuple(filter(None, judged))
        if len({each.facts["fingerprint"] for each in found}) < len(found):
            message = "both authorities have one and the same key"
            help_ = "make a certificate for one of them alone the file of both"
            self._error("adopt-authority-key", found[0].file, message, help_)
        return found

    def _authority(self, path: str, roles: tuple[str, ...]) -> FoundAuthority | None:
        contents = self._contents
        content, where = contents.read(path), contents.place(path)
        try:
            certificate = foreign_authorities.require_authority(content, where)
        except KeymintError as error:
            self._findings += error.diagnostics
            return None
        if content != certificates.to_pem(certificate):
            message = "has text around its certificate, or encodes it in another way; enclaves would get another file"
            help_ = f"rewrite it, here and on the robots: openssl x509 -in {where} -out {where}"
            self._error("adopt-encoding", path, message, help_)
        if not certificates.is_issued_by(certificate, certificate):
            message = f"was issued by {to_text(certificate.issuer)!r}, and not by itself"
            help_ = "Keymint takes over self-signed authorities only; Cyclone DDS refuses others as well"
            self._error("adopt-intermediate", path, message, help_)
        name, end = BOTH if len(roles) > 1 else _NAMES[roles[0]], certificate.not_valid_after_utc
        if end < contents.keystore.now:
            message = f"expired on {end:%Y-%m-%d}: no participant starts"
            help_ = f"'keymint authority renew {name}' afterwards"
            self._findings.append(Diagnostic.warning("adopt-authority-expired", message, where, help_))
        key_paths = contents.keys_of(certificate)
        for each in key_paths:
            self._findings += exposure(contents, each, "")
        self._findings += self._improvable(certificate, roles, name, where)
        public = certificates.public_key(certificate)
        kind = keys.kind_of(public)
        facts: dict[str, Any] = {
            "subject_name": to_text(certificate.subject),
            "fingerprint": keys.fingerprint(public),
            "key_kind": f"RSA {kind.size}" if kind.algorithm == "rsa" else kind.curve,
            **dates_of(certificate),
            "key_usage": extensions.usages(certificate),
            "subject_key_identifier": extensions.value(certificate, x509.SubjectKeyIdentifier) is not None,
            "authority_key_identifier": extensions.value(certificate, x509.AuthorityKeyIdentifier) is not None,
            "path_length": getattr(extensions.value(certificate, x509.BasicConstraints), "path_length", None),
            "key_file": str(contents.place(key_paths[0])) if key_paths else None,
        }
        key = keys.pem_of(contents.read(key_paths[0]), public) if key_paths else b""
        exposed = any(is_exposed(contents, each) for each in key_paths)
        return FoundAuthority(name, roles, content, path, key, tuple(key_paths), facts, exposed)

    def _improvable(
        self, certificate: x509.Certificate, roles: Sequence[str], name: str, where: Origin
    ) -> Iterator[Diagnostic]:
        """Yield a note for a private key that is not here, and for what the certificate lacks, or has too much of.

        Each is the matter of a later step. A key that is here and is not taken is a warning.
        """
        contents = self._contents
        if not contents.keys_of(certificate):
            message = (
                f"has no private key here: the authority {name!r} is taken over without it, and signs nothing here"
            )
            help_ = f"'keymint authority import {name} {where} --key FILE' brings it later"
            own = {enclave.files.get(layout.KEY) for enclave in self._places}
            certified = {keys.fingerprint(certificates.public_key(each)) for each in contents.certificates.values()}
            others = (path for key, paths in contents.keys.items() if key not in certified for path in paths)
            reasons = dict.fromkeys(others, "is the key of another certificate")
            reasons |= dict.fromkeys(contents.sealed, "is encrypted or a container")
            not_taken = [f"{contents.place(path)} {why}" for path, why in reasons.items() if path not in own]
            if contents.sealed:
                help_ = f"if it is the encrypted one: decrypt it (openssl pkey), then {help_}"
            made = Diagnostic.warning if not_taken else Diagnostic.note
            yield made("adopt-authority-elsewhere", "; ".join((message, *not_taken)), where, help_)
        if len(roles) > 1:
            message = (
                "issues identities and signs permissions: on old vendors, any identity can sign permissions for itself"
            )
            help_ = "CVE-2023-24010; 'keymint harden authority' makes a second one afterwards"
            yield Diagnostic.note("adopt-one-authority", message, where, help_)
        lacks = ", and ".join(each.message for each in foreign_authorities.defects(certificate, name, where))
        if lacks:
            yield Diagnostic.note("adopt-extensions", lacks, where, "'keymint harden identifiers' adds it afterwards")

    # -- revocation lists --------------------------------------------------------------------------------------------

    def _newest_list(self, issuer: FoundAuthority) -> str:
        """Return the path of the revocation list in force, empty if there is none.

        Args:
            issuer: the authority of identities.
        """
        contents, authority = self._contents, certificates.load(issuer.certificate)
        used = {enclave.files[layout.CRL] for enclave in self._places if layout.CRL in enclave.files}
        lists: dict[str, RevocationList] = {}
        for path in sorted({*contents.revocation_lists, *used}):
            content, place = contents.read(path), contents.place(path)
            if revocation_lists.problem(content, authority):
                if path not in used:  # else it is reported with the enclave
                    message = f"is no revocation list of the authority {issuer.name!r}"
                    help_ = "no action needed if it concerns no identity of this keystore; it is not taken over"
                    self._findings.append(Diagnostic.warning(_REVOCATIONS, message, place, help_))
                continue
            try:
                lists[path] = revocation_lists.load(content, place)
            except KeymintError:
                message = "has more than one revocation list, or text around it; enclaves would get another file"
                help_ = f"rewrite it, here and on the robots: openssl crl -in {place} -out {place}"
                self._error(_REVOCATIONS, path, message, help_)
        newest = max(lists, key=lambda each: (lists[each].number, lists[each].this_update), default="")
        if newest:
            self._judge_lists(newest, lists)
        return newest

    def _judge_lists(self, newest: str, lists: Mapping[str, RevocationList]) -> None:
        """Report what the newest list lacks, and each enclave that has another one, or none.

        The next installation would change that enclave.
        """
        contents, place = self._contents, self._contents.place(newest)
        known = {each.serial for each in lists[newest].revocations}
        for path, other in lists.items():
            if lost := [each.serial for each in other.revocations if each.serial not in known]:
                serial = hexadecimal(lost[0])
                message = f"does not revoke all that {contents.place(path)} revokes, e.g. the serial number {serial}"
                accepted = "if these certificates may be accepted again"
                help_ = f"issue a list with all of it; or remove the older one, {accepted}"
                self._error(_REVOCATIONS, newest, message, help_)
        count = quantity(len(lists[newest].revocations), "certificate")
        for enclave in self._places if self._form == "sros2" else ():
            own = enclave.files.get(layout.CRL)
            if own is None or contents.read(own) != contents.read(newest):
                problem = "is missing" if own is None else "is another list"
                message = f"{problem}, and {place}, the newest one, revokes {count}"
                help_ = (
                    "copy the newest one there, here and on the robot; or leave all lists out, if nothing is revoked"
                )
                self._error(_REVOCATIONS, own or f"{enclave.place}/{layout.CRL}", message, help_, enclave.subject)
        self._findings.append(Diagnostic.note(_REVOCATIONS, f"revokes {count}, which stay revoked", place, "nothing"))
