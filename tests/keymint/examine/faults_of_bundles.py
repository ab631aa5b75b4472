# SPDX-License-Identifier: Apache-2.0
"""Faults of enclaves whose keys robots made, and forged bundles."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import timedelta

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from comarmor.errors import Origin
from keymint.pki import cms
from keymint.robots import bundle
from keymint.robots.bundle import Manifest, dump
from tests.signers import by_sros2

from .fault import Fault
from .fault_keystores import (
    DAY,
    LISTENER,
    PLANNER,
    SUBJECTS,
    Issuer,
    Keystore,
    first_grant,
    new_grant,
    private_pem,
    stranger,
    written,
)
from .faults_of_keystores import exchanged_files, new_key, unregistered
from .faults_of_lists import replaced_lists
from .faults_of_permissions import ALL
from .faults_of_rollovers import granted, opened, revokes, widened_rights

Files = dict[str, bytes]


def _in_place() -> Iterator[Fault]:
    """Yield faults of enclaves whose key is on a robot."""
    for at, subject in enumerate(SUBJECTS):
        other = SUBJECTS[(at + 1) % len(SUBJECTS)]
        for label, apply in _of_enclave(subject, other).items():
            if label not in {"no key", "key of another"}:
                yield Fault(21, f"{subject} made its key: {label}", "requested", apply)

        def stray(keystore: Keystore, subject: str = subject) -> None:
            path = keystore.enclave(subject) / "key.pem"
            path.write_bytes(private_pem(ec.generate_private_key(ec.SECP256R1())))
            path.chmod(0o600)

        yield Fault(21, f"{subject} made its key: a key of nobody beside its certificate", "requested", stray)


def _of_enclave(subject: str, other: str) -> Mapping[str, Callable[[Keystore], None]]:
    """Return faults of an enclave; a bundle of it must not leave, whatever its key is."""
    return {
        "all of ROS": widened_rights(subject, "install", "all of ROS"),
        "another topic": widened_rights(subject, "install", "another topic"),
        "everything for another": granted(subject, other, "install"),
        "writing opened": opened(subject, "install", "writing"),
        "names that nobody has opened": opened(subject, "install", "names that nobody has"),
        "the living revoked": revokes(subject, other, "install"),
        "permissions of another": exchanged_files(subject, other, ("permissions.p7s", "permissions.xml")),
        "certificate of another": exchanged_files(subject, other, ("cert.pem",)),
        "certificate that no register knows": unregistered(subject),
        "no permissions": lambda ks: (ks.enclave(subject) / "permissions.p7s").unlink(),
        "no certificate": lambda ks: (ks.enclave(subject) / "cert.pem").unlink(),
        "a list that is over": replaced_lists([subject], lambda ks: ks.revocation_list([], end=-timedelta(hours=1))),
    }


def outgoing() -> Iterator[tuple[str, str, Callable[[Keystore], None]]]:
    """Yield faults of the workspace ``dds``, with the enclave of which no bundle may leave."""
    for at, subject in enumerate(SUBJECTS):
        other = SUBJECTS[(at + 2) % len(SUBJECTS)]
        more = {
            "key of another": exchanged_files(subject, other, ("key.pem",)),
            "a key of nobody": new_key(subject, certified=True, kept=False),
        }
        for label, apply in {**_of_enclave(subject, other), **more}.items():
            yield f"{subject} {label}", subject, apply


@dataclass(frozen=True)
class Forged:
    """A bundle that must not be accepted.

    Attributes:
        name: what is wrong.
        files: changes the files of the enclave.
        manifest: changes the manifest.
        signer: who signs the manifest; None for nobody: the old signature stays.
    """

    name: str
    files: Callable[[Keystore, str, Files], None] = lambda _ks, _subject, _files: None
    manifest: Callable[[Manifest], Manifest] = lambda manifest: manifest
    signer: Callable[[Keystore, str], Issuer] | None = lambda keystore, subject: keystore.issuer("identity_ca", subject)

    def content(self, keystore: Keystore, subject: str, genuine: bytes) -> bytes:
        """Return the forged bundle made of a genuine one."""
        read = bundle.read(genuine, Origin("genuine"))
        files = dict(read.files)
        self.files(keystore, subject, files)
        if self.signer is None:
            members = dict(bundle.unpack(genuine, Origin("genuine")))
            members.update(files)
            return bundle.pack({name: data for name, data in members.items() if name in files or "manifest" in name})
        issuer = self.signer(keystore, subject)
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in sorted(files.items())}
        encoded = dump(replace(self.manifest(read.manifest), files=digests))
        signature = cms.sign(encoded, issuer.certificate, issuer.key)
        return bundle.pack({**files, bundle.MANIFEST: encoded, bundle.SIGNATURE: signature})


def _put(name: str, content: Callable[[Keystore, str], bytes]) -> Callable[[Keystore, str, Files], None]:
    def change(keystore: Keystore, subject: str, files: Files) -> None:
        files[name] = content(keystore, subject)

    return change


def _other(subject: str) -> str:
    return LISTENER if subject != LISTENER else PLANNER


def _of_other(name: str) -> Callable[[Keystore, str, Files], None]:
    return _put(name, lambda ks, subject: (ks.enclave(_other(subject)) / name).read_bytes())


def _signed_by(role: str, signer: Callable[[Keystore, str], Issuer]) -> Callable[[Keystore, str, Files], None]:
    def content(keystore: Keystore, subject: str) -> bytes:
        document = keystore.permissions(subject) if role == "permissions" else keystore.governance()
        found = signer(keystore, subject)
        return by_sros2(written(document), found.certificate, found.key)

    return _put(f"{role}.p7s", content)


def _for_nobody(keystore: Keystore, subject: str) -> bytes:
    document = keystore.permissions(subject)
    own = first_grant(document)
    own.addnext(new_grant(own, "CN=/nobody,OU=00", ALL))
    own.getparent().remove(own)  # type: ignore[union-attr]
    found = keystore.issuer("permissions_ca", subject)
    return by_sros2(written(document), found.certificate, found.key)


def _stranger(role: str) -> Callable[[Keystore, str, Files], None]:
    return _put(f"{role}.cert.pem", lambda _ks, _s: stranger(role).certificate.public_bytes(Encoding.PEM))


def _dropped(name: str) -> Callable[[Keystore, str, Files], None]:
    def change(_keystore: Keystore, _subject: str, files: Files) -> None:
        del files[name]

    return change


def _by_stranger(keystore: Keystore, _subject: str) -> bytes:
    return keystore.revocation_list([], issuer=stranger("identity_ca"))


def _revoking_itself(keystore: Keystore, subject: str) -> bytes:
    return keystore.revocation_list([keystore.certificate(subject).serial_number])


FORGED = (
    Forged("permissions of another", _of_other("permissions.p7s")),
    Forged("certificate of another", _of_other("cert.pem")),
    Forged("key of another", _of_other("key.pem")),
    Forged("permissions by a stranger", _signed_by("permissions", lambda _ks, _s: stranger("permissions_ca"))),
    Forged("governance by a stranger", _signed_by("governance", lambda _ks, _s: stranger("permissions_ca"))),
    Forged("permissions by itself", _signed_by("permissions", lambda ks, s: ks.with_key(ks.certificate(s)))),
    Forged("permissions by the wrong authority", _signed_by("permissions", lambda ks, s: ks.issuer("identity_ca", s))),
    Forged("permissions for nobody", _put("permissions.p7s", _for_nobody)),
    Forged("another identity authority", _stranger("identity_ca"), signer=None),
    Forged("another permissions authority", _stranger("permissions_ca")),
    Forged("no permissions", _dropped("permissions.p7s")),
    Forged("no governance", _dropped("governance.p7s")),
    Forged("a list that revokes it", _put("crl.pem", _revoking_itself)),
    Forged("a list that is over", _put("crl.pem", lambda ks, _: ks.revocation_list([], end=-timedelta(hours=1)))),
    Forged("a list of a stranger", _put("crl.pem", _by_stranger)),
    Forged("certificate over", _put("cert.pem", lambda ks, s: ks.issue(s, begin=-30 * DAY, end=-DAY))),
    Forged("certificate begins tomorrow", _put("cert.pem", lambda ks, s: ks.issue(s, begin=DAY))),
    Forged("an issue before", manifest=lambda manifest: replace(manifest, issue=manifest.issue - 1)),
    Forged("for another enclave", manifest=lambda manifest: replace(manifest, enclave="/somebody")),
    Forged("by a namesake of the authority", signer=lambda _ks, _s: stranger("identity_ca")),
    Forged("by the permissions authority", signer=lambda ks, s: ks.issuer("permissions_ca", s)),
    Forged("by its own key", signer=lambda ks, s: ks.with_key(ks.certificate(s))),
    *(Forged(f"unsigned {name} of another", _of_other(name), signer=None)
      for name in ("permissions.p7s", "cert.pem", "key.pem", "permissions.xml")),
    Forged("unsigned, no governance", _dropped("governance.p7s"), signer=None),
)  # fmt: skip
"""Bundles that no robot may take: by the real authority where nothing else is said."""

FAULTS = (*_in_place(),)
