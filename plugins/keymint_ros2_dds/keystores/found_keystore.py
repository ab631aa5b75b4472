# SPDX-License-Identifier: Apache-2.0
"""What a keystore of another tool has: the answer to ``keymint adopt``."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic
from keymint.api import FoundAuthority, FoundEnclave, FoundKeystore, KeystoreFiles, TrustAnchor
from keymint.pki import keys
from keymint_ros2_dds.authority_roles import IDENTITY
from keymint_ros2_dds.authority_roles import PERMISSIONS as SIGNS
from keymint_ros2_dds.enclave_layout import CRL, GOVERNANCE, GOVERNANCE_P7S, GOVERNANCE_XML, KEY, LAYOUTS, files
from keymint_ros2_dds.keystores import governance_as_source
from keymint_ros2_dds.keystores.enclave_places import FORMS, Places, places
from keymint_ros2_dds.keystores.file_contents import Contents, contents
from keymint_ros2_dds.keystores.found_authorities import authorities
from keymint_ros2_dds.keystores.found_enclaves import examined
from keymint_ros2_dds.keystores.found_revocations import newest_list

_READ = frozenset(name for layout in LAYOUTS for name in files(layout))
"""Names of the files that participants read."""


def found(keystore: KeystoreFiles) -> FoundKeystore:
    """Return what a keystore has: see :meth:`keymint.api.KeystoreReader.found`.

    Raises:
        KeymintError: it has no enclave.
    """
    content = contents(keystore)
    where = places(content)
    trusted, diagnostics = authorities(content, where.enclaves)
    issuer = next((each for each in trusted if IDENTITY in each.roles), None)
    newest, of_lists = newest_list(content, where, issuer) if issuer else ("", [])
    diagnostics += of_lists
    listed = {CRL: newest} if newest and not where.layout else {}
    anchors = {
        role: TrustAnchor(each.name, str(content.place(each.file)), each.certificate)
        for each in trusted
        for role in each.roles
    }
    enclaves: list[FoundEnclave] = []
    for place in where.enclaves:
        enclave, own = examined(content, replace(place, files={**place.files, **listed}), anchors)
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
