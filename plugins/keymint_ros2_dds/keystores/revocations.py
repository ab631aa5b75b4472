# SPDX-License-Identifier: Apache-2.0
"""The revocation list of a keystore: which one is in force, and what keeps it from being taken over."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from comarmor.errors import Diagnostic
from comarmor.text import counted
from comarmor.values import dataclass
from keymint.api import FoundAuthority, FoundEnclave
from keymint.errors import KeymintError
from keymint.pki import certificates, revocation_lists
from keymint.pki.revocation_lists import RevocationList
from keymint_ros2_dds.enclave_layout import CRL
from keymint_ros2_dds.keystores.contents import Contents
from keymint_ros2_dds.keystores.places import EnclavePlace

_CODE = "adopt-revocations"


@dataclass(frozen=True, slots=True)
class FoundLists:
    """The revocation lists of the authority of identities.

    Attributes:
        lists: those that it signed, by path.
        newest: path of the newest one; empty if there is none.
        findings: findings on other lists, and on those that are not taken over as they are.
    """

    lists: Mapping[str, RevocationList]
    newest: str
    findings: tuple[Diagnostic, ...]


def found_lists(contents: Contents, places: Iterable[EnclavePlace], issuer: FoundAuthority | None) -> FoundLists:
    """Return the revocation lists of a keystore.

    Args:
        contents: what the files of the keystore contain.
        places: where the files of its enclaves are.
        issuer: the authority of identities; None if it was not found.
    """
    if issuer is None:
        return FoundLists({}, "", ())
    used = {enclave.files[CRL] for enclave in places if CRL in enclave.files}
    authority = certificates.load(issuer.certificate)
    lists: dict[str, RevocationList] = {}
    findings = []
    for path in sorted({*contents.revocation_lists, *used}):
        content, place = contents.read(path), contents.place(path)
        if revocation_lists.problem(content, authority):
            message = f"is no revocation list of the authority {issuer.name!r}"
            if path in used:
                help_ = "replace it with the authority's, or remove it, here and on the robot"
                findings.append(contents.error(_CODE, path, f"{message}: no node with it starts", help_))
            else:
                help_ = "nothing, if it concerns no identity of this keystore; it is not taken over"
                findings.append(contents.warning(_CODE, path, message, help_))
            continue
        try:
            lists[path] = revocation_lists.load(content, place)
        except KeymintError:
            message = "has more than one revocation list, or text around it; enclaves would get another file"
            help_ = f"rewrite it, here and on the robots: openssl crl -in {place} -out {place}"
            findings.append(contents.error(_CODE, path, message, help_))
    newest = max(lists, key=lambda each: (lists[each].number, lists[each].this_update), default="")
    return FoundLists(lists, newest, tuple(findings))


def examined(
    contents: Contents, found: FoundLists, enclaves: Sequence[FoundEnclave], *, by_name: bool
) -> Iterator[Diagnostic]:
    """Yield the findings on the newest list: a revocation that got lost would be taken back, so that is an error.

    Args:
        contents: what the files of the keystore contain.
        found: its lists.
        enclaves: the enclaves, examined.
        by_name: enclaves have the list under a fixed name.
    """
    yield from found.findings
    path = found.newest
    if not path:
        return
    newest = found.lists[path]
    yield from _lost(contents, path, found.lists)
    yield from _revoked(contents, path, newest, enclaves)
    if contents.keystore.now >= newest.next_update:
        message = f"ended on {newest.next_update:%Y-%m-%d}: no node with it starts"
        help_ = "issue it again with the tool that made it, here and on the robots"
        yield contents.error(_CODE, path, message, help_)
    if by_name:
        yield from _elsewhere(contents, path, enclaves, len(newest.revocations))
    message = f"revokes {counted(len(newest.revocations), 'certificate')}, which stay revoked"
    yield contents.note(_CODE, path, message, "nothing")


def _lost(contents: Contents, newest: str, lists: Mapping[str, RevocationList]) -> Iterator[Diagnostic]:
    known = {each.serial for each in lists[newest].revocations}
    for path, other in lists.items():
        if lost := [each.serial for each in other.revocations if each.serial not in known]:
            message = f"does not revoke all that {contents.place(path)} revokes, e.g. the serial number {lost[0]:x}"
            help_ = "issue a list with all of it; or remove the older one, if these certificates may be accepted again"
            yield contents.error(_CODE, newest, message, help_)


def _revoked(
    contents: Contents, path: str, newest: RevocationList, enclaves: Iterable[FoundEnclave]
) -> Iterator[Diagnostic]:
    """Yield an error for each enclave whose certificate is revoked."""
    revoked = {each.serial: each for each in newest.revocations}
    for enclave in enclaves:
        if enclave.key_spec is None:  # its certificate is missing or damaged
            continue
        found = revoked.get(certificates.load(enclave.certificate).serial_number)
        if found is not None:
            message = (
                f"its certificate, serial number {found.serial:x}, was revoked on {found.at:%Y-%m-%d} "
                f"({found.reason}) by {contents.place(path)}"
            )
            help_ = (
                "take it out of the keystore; a new one for this name: 'keymint create', build and install afterwards"
            )
            yield contents.error("adopt-revoked", str(enclave.facts["place"]), message, help_, enclave.subject)


def _elsewhere(contents: Contents, newest: str, enclaves: Iterable[FoundEnclave], count: int) -> Iterator[Diagnostic]:
    """Yield an error for each enclave that has another list, or none: the next installation would change it."""
    for enclave in enclaves:
        path = enclave.files.get(CRL)
        if path is None or contents.read(path) != contents.read(newest):
            message = (
                f"{'is missing' if path is None else 'is another list'}, and {contents.place(newest)}, the newest one, "
                f"revokes {counted(count, 'certificate')}"
            )
            help_ = "copy the newest one there, here and on the robot; or leave all lists out, if nothing is revoked"
            own = path or f"{enclave.facts['place']}/{CRL}"
            yield contents.error(_CODE, own, message, help_, enclave.subject)
