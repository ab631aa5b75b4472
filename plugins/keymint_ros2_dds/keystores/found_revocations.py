# SPDX-License-Identifier: Apache-2.0
"""The revocation list of a keystore: which one is in force, and what keeps it from being taken over.

A revocation that got lost would be taken back, so that is an error. Whether vendors take the list of an enclave, and
whether it revokes the certificate beside it, are rules about every enclave (:mod:`keymint_ros2_dds.examine`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from comarmor.errors import Diagnostic
from comarmor.text import counted
from keymint.api import FoundAuthority
from keymint.errors import KeymintError
from keymint.pki import certificates, revocation_lists
from keymint.pki.revocation_lists import RevocationList
from keymint_ros2_dds.enclave_layout import CRL
from keymint_ros2_dds.keystores.enclave_places import EnclavePlace, Places
from keymint_ros2_dds.keystores.file_contents import Contents

_CODE = "adopt-revocations"


def newest_list(contents: Contents, where: Places, issuer: FoundAuthority) -> tuple[str, list[Diagnostic]]:
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
                findings.append(contents.warning(_CODE, path, message, help_))
            continue
        try:
            lists[path] = revocation_lists.load(content, place)
        except KeymintError:
            message = "has more than one revocation list, or text around it; enclaves would get another file"
            help_ = f"rewrite it, here and on the robots: openssl crl -in {place} -out {place}"
            findings.append(contents.error(_CODE, path, message, help_))
    newest = max(lists, key=lambda each: (lists[each].number, lists[each].this_update), default="")
    if newest:
        findings += _lost(contents, newest, lists)
        count = counted(len(lists[newest].revocations), "certificate")
        if where.layout == "sros2":
            findings += _elsewhere(contents, newest, where.enclaves, count)
        findings.append(contents.note(_CODE, newest, f"revokes {count}, which stay revoked", "nothing"))
    return newest, findings


def _lost(contents: Contents, newest: str, lists: Mapping[str, RevocationList]) -> Iterator[Diagnostic]:
    known = {each.serial for each in lists[newest].revocations}
    for path, other in lists.items():
        if lost := [each.serial for each in other.revocations if each.serial not in known]:
            message = f"does not revoke all that {contents.place(path)} revokes, e.g. the serial number {lost[0]:x}"
            help_ = "issue a list with all of it; or remove the older one, if these certificates may be accepted again"
            yield contents.error(_CODE, newest, message, help_)


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
            yield contents.error(_CODE, own, message, help_, enclave.subject)
