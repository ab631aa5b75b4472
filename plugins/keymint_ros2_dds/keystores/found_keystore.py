# SPDX-License-Identifier: Apache-2.0
"""What a keystore of another tool has: the answer to ``keymint adopt``.

A revocation that got lost would be taken back, so that is an error. Whether vendors take the list of an enclave, and
whether it revokes the certificate beside it, are rules about every enclave (:mod:`keymint_ros2_dds.examine`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic
from comarmor.text import counted
from keymint.api import FoundAuthority, FoundEnclave, FoundKeystore, KeystoreFiles, TrustAnchor
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, revocation_lists
from keymint.pki.revocation_lists import RevocationList
from keymint_ros2_dds.authority_roles import IDENTITY
from keymint_ros2_dds.authority_roles import PERMISSIONS as SIGNS
from keymint_ros2_dds.enclave_layout import CRL, GOVERNANCE, GOVERNANCE_P7S, GOVERNANCE_XML, KEY, LAYOUTS, files
from keymint_ros2_dds.keystores import governance_as_source
from keymint_ros2_dds.keystores.enclave_places import FORMS, EnclavePlace, Places, places
from keymint_ros2_dds.keystores.file_contents import Contents, contents
from keymint_ros2_dds.keystores.found_authorities import authorities
from keymint_ros2_dds.keystores.found_enclaves import examine_enclave

_READ = frozenset(name for layout in LAYOUTS for name in files(layout))
"""Names of the files that participants read."""
_REVOCATIONS = "adopt-revocations"


def examine_keystore(keystore: KeystoreFiles) -> FoundKeystore:
    """Return what a keystore has: see :meth:`keymint.api.KeystoreReader.found`.

    Raises:
        KeymintError: it has no enclave.
    """
    content = contents(keystore)
    where = places(content)
    trusted, diagnostics = authorities(content, where.enclaves)
    issuer = next((each for each in trusted if IDENTITY in each.roles), None)
    newest, of_lists = _newest_list(content, where, issuer) if issuer else ("", [])
    diagnostics += of_lists
    listed = {CRL: newest} if newest and not where.layout else {}
    anchors = {
        role: TrustAnchor(each.name, str(content.place(each.file)), each.certificate)
        for each in trusted
        for role in each.roles
    }
    enclaves: list[FoundEnclave] = []
    for place in where.enclaves:
        enclave, own = examine_enclave(content, replace(place, files={**place.files, **listed}), anchors)
        enclaves.append(enclave)
        diagnostics += own
    defaults, of_governance = _defaults(content, enclaves, trusted)
    diagnostics += of_governance
    diagnostics += _doubled(content, enclaves)
    secrets = {content.read(path) for each in trusted for path in each.key_files}
    diagnostics += _in_the_way(content, where, secrets)
    return FoundKeystore(
        form=FORMS[where.layout],
        layout=where.layout,
        subject_format="sros2" if all(each.subject_name == f"CN={each.subject}" for each in enclaves) else "",
        authorities=trusted,
        enclaves=tuple(enclaves),
        kept=tuple(path for path in where.kept if content.read(path) not in secrets),  # nor links to them
        defaults=defaults,
        diagnostics=tuple(diagnostics),
        revocation_lists={issuer.name: content.read(newest)} if issuer and newest else {},
    )


def _defaults(
    content: Contents, enclaves: Sequence[FoundEnclave], trusted: Sequence[FoundAuthority]
) -> tuple[Mapping[str, bytes], list[Diagnostic]]:
    """Return the governance as the source of all packages, and why it cannot become that."""
    governed = [each for each in enclaves if GOVERNANCE_XML in each.documents]
    signer = next((each.name for each in trusted if SIGNS in each.roles), "")
    if not governed or not signer:
        return {}, []
    findings = []
    first, document = governed[0], governed[0].documents[GOVERNANCE_XML]
    path = first.files[GOVERNANCE_P7S]
    for other in governed:
        if not governance_as_source.is_same(document, other.documents[GOVERNANCE_XML]):
            message = f"protects other topics or domains than the governance of {first.subject}, {content.place(path)}"
            help_ = "all participants of a domain need the same: adopt these enclaves as a keystore of their own"
            own = other.files[GOVERNANCE_P7S]
            findings.append(content.error("adopt-governance", own, message, help_, other.subject))
    made = governance_as_source.source(document, signer)
    if made is None:
        message = "has several domain rules, and a profile's defaults have one"
        help_ = "sign a governance with one domain rule, which may have several domains"
        findings.append(content.error("adopt-governance", path, message, help_))
        return {}, findings
    return {GOVERNANCE: made}, findings


def _in_the_way(content: Contents, where: Places, secrets: Collection[bytes]) -> Iterator[Diagnostic]:
    """Yield an error for each file that robots need and must not have, and for each that nobody can tell.

    Args:
        content: what the files of the keystore contain.
        where: where they are.
        secrets: the files with an authority's private key.
    """
    own = {enclave.files[KEY] for enclave in where.enclaves if KEY in enclave.files}
    needed = {path: each for each in where.enclaves for name, path in each.files.items() if name in _READ}
    for path, enclave in needed.items():
        if content.read(path) in secrets:
            message = "has the private key of an authority, and participants read this file"
            help_ = "give the enclave a key of its own, and leave the authority's to private/"
            yield content.error("adopt-key-shared", path, message, help_, enclave.subject)
    sealed = set(map(content.read, content.sealed))
    for path in where.kept:
        if path in own or content.read(path) not in sealed:
            continue
        message = "has a private key that cannot be read, perhaps an authority's, where robots' files are taken from"
        help_ = "move it out of that folder, e.g. to private/, if no robot needs it; else decrypt it (openssl pkey)"
        yield content.error("adopt-key-sealed", path, message, help_)


def _doubled(content: Contents, enclaves: Sequence[FoundEnclave]) -> Iterator[Diagnostic]:
    """Yield an error for a subject or a key that two enclaves have."""
    seen: dict[str, FoundEnclave] = {}
    for each in enclaves:
        key = keys.fingerprint(keys.public_of(each.key)) if each.key else ""
        for what, name in ((f"the subject {each.subject}", each.subject), ("one private key", key)):
            other = seen.setdefault(name, each) if name else each
            if other is not each:
                message = f"has {what}, like {other.subject} ({other.facts['place']})"
                help_ = "each enclave needs a name and a key of its own: remove one, or make a new key for it"
                yield content.error("adopt-doubled", str(each.facts["place"]), message, help_, each.subject)


# -- revocation lists -----------------------------------------------------------------------------------------------


def _newest_list(contents: Contents, where: Places, issuer: FoundAuthority) -> tuple[str, list[Diagnostic]]:
    """Return the path of the revocation list in force, empty if there is none, and the findings on all lists.

    Args:
        contents: what the files of the keystore contain.
        where: where they are.
        issuer: the authority of identities.
    """
    used = {enclave.files[CRL] for enclave in where.enclaves if CRL in enclave.files}
    authority = certificates.load(issuer.certificate)
    lists: dict[str, RevocationList] = {}
    findings: list[Diagnostic] = []
    for path in sorted({*contents.revocation_lists, *used}):
        content, place = contents.read(path), contents.place(path)
        if revocation_lists.problem(content, authority):
            if path not in used:  # else it is reported with the enclave
                message = f"is no revocation list of the authority {issuer.name!r}"
                help_ = "nothing, if it concerns no identity of this keystore; it is not taken over"
                findings.append(contents.warning(_REVOCATIONS, path, message, help_))
            continue
        try:
            lists[path] = revocation_lists.load(content, place)
        except KeymintError:
            message = "has more than one revocation list, or text around it; enclaves would get another file"
            help_ = f"rewrite it, here and on the robots: openssl crl -in {place} -out {place}"
            findings.append(contents.error(_REVOCATIONS, path, message, help_))
    newest = max(lists, key=lambda each: (lists[each].number, lists[each].this_update), default="")
    if newest:
        findings += _lost(contents, newest, lists)
        count = counted(len(lists[newest].revocations), "certificate")
        if where.layout == "sros2":
            findings += _elsewhere(contents, newest, where.enclaves, count)
        findings.append(contents.note(_REVOCATIONS, newest, f"revokes {count}, which stay revoked", "nothing"))
    return newest, findings


def _lost(contents: Contents, newest: str, lists: Mapping[str, RevocationList]) -> Iterator[Diagnostic]:
    known = {each.serial for each in lists[newest].revocations}
    for path, other in lists.items():
        if lost := [each.serial for each in other.revocations if each.serial not in known]:
            message = f"does not revoke all that {contents.place(path)} revokes, e.g. the serial number {lost[0]:x}"
            help_ = "issue a list with all of it; or remove the older one, if these certificates may be accepted again"
            yield contents.error(_REVOCATIONS, newest, message, help_)


def _elsewhere(contents: Contents, newest: str, enclaves: Sequence[EnclavePlace], count: str) -> Iterator[Diagnostic]:
    """Yield an error for each enclave that has another list, or none: the next installation would change it."""
    for enclave in enclaves:
        path = enclave.files.get(CRL)
        if path is None or contents.read(path) != contents.read(newest):
            message = (
                f"{'is missing' if path is None else 'is another list'}, and {contents.place(newest)}, the newest one, "
                f"revokes {count}"
            )
            help_ = "copy the newest one there, here and on the robot; or leave all lists out, if nothing is revoked"
            own = path or f"{enclave.place}/{CRL}"
            yield contents.error(_REVOCATIONS, own, message, help_, enclave.subject)
