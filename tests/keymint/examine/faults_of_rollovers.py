# SPDX-License-Identifier: Apache-2.0
"""Faults in each phase in which an authority is replaced, in the keystore in force and in the next one."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

from cryptography.hazmat.primitives.serialization import Encoding

from .fault import Fault
from .fault_keystores import (
    CAMERA,
    LISTENER,
    PLANNER,
    ROBOT,
    TALKER,
    Keystore,
    first_grant,
    new_grant,
    put,
    stranger,
)
from .faults_of_lists import LIST, Apply
from .faults_of_permissions import ALL, WIDENED
from .faults_of_signers import OPENED

STAGED = "install.next"


def widened_rights(subject: str, space: str, label: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(subject, space)
        WIDENED[label](first_grant(document))
        keystore.sign_permissions(subject, document, space)

    return apply


def granted(subject: str, victim: str, space: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(subject, space)
        own = first_grant(document)
        own.addnext(new_grant(own, keystore.name(victim, space), ALL))
        keystore.sign_permissions(subject, document, space)

    return apply


def opened(subject: str, space: str, label: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        document = keystore.governance(space)
        OPENED[label](document)
        keystore.sign_governance([subject], document, space)

    return apply


def _copied(name: str, subject: str, donor: str, space: str, source: str = "") -> Apply:
    """Copy a file of another enclave, or of another space."""
    return lambda ks: put(ks.enclave(subject, space) / name, (ks.enclave(donor, source or space) / name).read_bytes())


def _removed(name: str, subject: str, space: str) -> Apply:
    return lambda ks: (ks.enclave(subject, space) / name).unlink()


def _mode(name: str, subject: str, space: str, mode: int) -> Apply:
    return lambda ks: (ks.enclave(subject, space) / name).chmod(mode)


def _trusts_stranger(role: str, subject: str, space: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        path = keystore.enclave(subject, space) / f"{role}.cert.pem"
        put(path, stranger(role).certificate.public_bytes(Encoding.PEM))

    return apply


def revokes(subject: str, victim: str, space: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        serial = keystore.certificate(victim, space).serial_number
        issuer = keystore.issuer("identity_ca", subject, space)
        put(keystore.enclave(subject, space) / LIST, keystore.revocation_list([serial], issuer=issuer))

    return apply


def _everywhere(space: str) -> Iterator[tuple[str, Apply]]:
    """Yield faults that are the same in each keystore."""
    yield f"{TALKER} all of ROS", widened_rights(TALKER, space, "all of ROS")
    yield f"{PLANNER} reading", widened_rights(PLANNER, space, "reading")
    yield f"{TALKER} has everything for {LISTENER}", granted(TALKER, LISTENER, space)
    yield f"{CAMERA} has everything for {ROBOT}", granted(CAMERA, ROBOT, space)
    yield f"{LISTENER} opened writing", opened(LISTENER, space, "writing")
    yield f"{TALKER} opened names that nobody has", opened(TALKER, space, "names that nobody has")
    yield f"{TALKER} has the permissions of {LISTENER}", _copied("permissions.p7s", TALKER, LISTENER, space)
    yield f"{TALKER} has the key of {LISTENER}", _copied("key.pem", TALKER, LISTENER, space)
    yield f"{LISTENER} has the certificate of {ROBOT}", _copied("cert.pem", LISTENER, ROBOT, space)
    yield f"{LISTENER} has no certificate", _removed("cert.pem", LISTENER, space)
    yield f"{ROBOT} has no key", _removed("key.pem", ROBOT, space)
    yield f"{ROBOT} has no permissions", _removed("permissions.p7s", ROBOT, space)
    yield f"{TALKER} trusts a stranger for identities", _trusts_stranger("identity_ca", TALKER, space)
    yield f"{TALKER} trusts a stranger for permissions", _trusts_stranger("permissions_ca", TALKER, space)
    yield f"{PLANNER} revokes {CAMERA}", revokes(PLANNER, CAMERA, space)


_LATER = "every certificate of this phase is trusted; the next phase needs what is missing"


def _staged() -> Iterator[Fault]:
    for kind in ("staged identity", "staged permissions"):
        for space in ("install", STAGED):
            for label, apply in _everywhere(space):
                yield Fault(17, f"{kind} {space} {label}", kind, apply)
            yield Fault(
                17, f"{kind} {space} {TALKER} key for all", kind, _mode("key.pem", TALKER, space, 0o644), decides=False,
                check=True, why="modes are what 'check' judges",
            )  # fmt: skip
        role = kind.split()[1]
        names = ("cert.pem", "identity_ca.cert.pem") if role == "identity" else ("permissions.p7s", "governance.p7s")
        for name in names:
            for subject in (TALKER, PLANNER):
                label = f"{kind} {STAGED} {subject} still has the present {name}"
                yield Fault(17, label, kind, _copied(name, subject, subject, STAGED, "install"))
                label = f"{kind} install {subject} has the next {name}"
                yield Fault(17, label, kind, _copied(name, subject, subject, "install", STAGED))

        def gone(keystore: Keystore) -> None:
            shutil.rmtree(keystore.enclave(PLANNER, STAGED))

        yield Fault(17, f"{kind} {STAGED} lacks {PLANNER}", kind, gone, vendors="all after the switch")


def _phases() -> Iterator[Fault]:
    for kind in ("distributed", "reissued", "ended"):
        for label, apply in _everywhere("install"):
            yield Fault(17, f"{kind} {label}", kind, apply)
        for subject in (TALKER, PLANNER):

            def former(keystore: Keystore, subject: str = subject) -> None:
                source = keystore.stage(0, subject) / "identity_ca.cert.pem"
                put(keystore.enclave(subject) / "identity_ca.cert.pem", source.read_bytes())

            later = kind == "distributed"
            yield Fault(
                17, f"{kind} {subject} trusts the former authority alone", kind, former, decides=not later,
                check=True, why=_LATER if later else "",
            )  # fmt: skip

            def old_certificate(keystore: Keystore, subject: str = subject) -> None:
                put(keystore.enclave(subject) / "cert.pem", (keystore.stage(0, subject) / "cert.pem").read_bytes())

            if kind == "ended":
                yield Fault(17, f"{kind} {subject} has its former certificate", kind, old_certificate)


FAULTS = (*_staged(), *_phases())
