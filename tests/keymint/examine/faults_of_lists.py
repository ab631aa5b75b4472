# SPDX-License-Identifier: Apache-2.0
"""Faults in revocation lists: missing, older, or revoking the living."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta

from cryptography import x509

from .fault import Fault
from .fault_keystores import (
    CAMERA,
    DAY,
    LISTENER,
    PLANNER,
    ROBOT,
    SUBJECTS,
    TALKER,
    Keystore,
    put,
    stranger,
)

ALIVE = (TALKER, LISTENER, ROBOT, PLANNER)
"""The enclaves that are left after the camera was revoked."""
Apply = Callable[[Keystore], None]
LIST = "crl.pem"


def _subsets(subjects: Sequence[str]) -> Iterator[tuple[str, ...]]:
    for size in range(1, len(subjects) + 1):
        yield from itertools.combinations(subjects, size)


def _said(subjects: Sequence[str]) -> str:
    return " ".join(subjects)


def replaced_lists(subjects: Sequence[str], content: Callable[[Keystore], bytes | None]) -> Apply:
    """Replace the lists of enclaves; remove them for None."""

    def apply(keystore: Keystore) -> None:
        found = content(keystore)
        for subject in subjects:
            if found is None:
                (keystore.enclave(subject) / LIST).unlink()
            else:
                put(keystore.enclave(subject) / LIST, found)

    return apply


def _stolen(keystore: Keystore) -> int:
    return x509.load_pem_x509_certificate((keystore.stage(0, CAMERA) / "cert.pem").read_bytes()).serial_number


def _current(keystore: Keystore) -> set[int]:
    found = x509.load_pem_x509_crl((keystore.stage(4, TALKER) / LIST).read_bytes())
    return {each.serial_number for each in found}


def _missing() -> Iterator[Fault]:
    forms: dict[str, Callable[[Keystore], bytes | None]] = {
        "no list": lambda _: None,
        "an empty file": lambda _: b"",
        "a list of nobody": lambda ks: ks.revocation_list([]),
        "a list of all but the thief": lambda ks: ks.revocation_list(_current(ks) - {_stolen(ks)}),
    }
    for label, content in forms.items():
        for subjects in _subsets(ALIVE):
            yield Fault(14, f"{label} in {_said(subjects)}", "revoked", replaced_lists(subjects, content))
    path = "public/identity_ca.crl.pem"
    yield Fault(
        14, "no public list", "revoked", lambda ks: (ks.ws / path).unlink(), decides=False, check=True, prove=None,
        why="no vendor reads the public list; 'check' misses it",
    )  # fmt: skip
    for subjects in _subsets(ALIVE):

        def second(keystore: Keystore, subjects: tuple[str, ...] = subjects) -> None:
            for subject in subjects:
                path = keystore.enclave(subject) / LIST
                put(path, keystore.revocation_list([]) + path.read_bytes())

        yield Fault(14, f"a list of nobody in front in {_said(subjects)}", "revoked", second)


def _of_stage(number: int) -> Callable[[Keystore], bytes]:
    return lambda keystore: (keystore.stage(number, TALKER) / LIST).read_bytes()


def _older() -> Iterator[Fault]:
    for number, subjects in itertools.product((1, 2), _subsets(ALIVE)):
        yield Fault(15, f"list {number} in {_said(subjects)}", "revoked", replaced_lists(subjects, _of_stage(number)))
    for subjects in _subsets(ALIVE):
        yield Fault(
            15,
            f"list 3, with the same revocations, in {_said(subjects)}",
            "revoked",
            replaced_lists(subjects, _of_stage(3)),
            decides=False,
            check=True,
            why="it revokes the same certificates: only its number and dates are older",
        )

        def fewer(keystore: Keystore) -> bytes:
            return keystore.revocation_list([_stolen(keystore)], number=7)

        name = f"a newer number and fewer revocations in {_said(subjects)}"
        yield Fault(15, name, "revoked", replaced_lists(subjects, fewer))


def _living() -> Iterator[Fault]:
    for host, victim in itertools.product(SUBJECTS, SUBJECTS):

        def alone(keystore: Keystore, victim: str = victim) -> bytes:
            return keystore.revocation_list([keystore.certificate(victim).serial_number])

        yield Fault(16, f"{host} revokes {victim}", "dds", replaced_lists([host], alone))
    for host, victim in itertools.product(ALIVE, ALIVE):

        def beside(keystore: Keystore, victim: str = victim) -> bytes:
            return keystore.revocation_list(_current(keystore) | {keystore.certificate(victim).serial_number})

        yield Fault(16, f"{host} revokes {victim} beside the thief", "revoked", replaced_lists([host], beside))
    for host in SUBJECTS:
        for label, begin, end in (
            ("is over", -30 * DAY, -DAY),
            ("begins tomorrow", DAY, 30 * DAY),
            ("is over since a minute", -DAY, timedelta(minutes=-1)),
        ):

            def dated(keystore: Keystore, begin: timedelta = begin, end: timedelta = end) -> bytes:
                return keystore.revocation_list([], begin=begin, end=end)

            yield Fault(16, f"{host} has a list that {label}", "dds", replaced_lists([host], dated))

        def foreign(keystore: Keystore) -> bytes:
            serial = keystore.certificate(LISTENER).serial_number
            return keystore.revocation_list([serial], issuer=stranger("identity_ca"))

        yield Fault(16, f"{host} has a list by a namesake of the authority", "dds", replaced_lists([host], foreign))

        def harmless(keystore: Keystore) -> bytes:
            return keystore.revocation_list([7], number=1)

        yield Fault(
            16, f"{host} has a list that revokes nobody that was issued", "dds", replaced_lists([host], harmless),
            decides=False, check=None, why="it refuses nobody; whether the register knows it is another question",
        )  # fmt: skip


FAULTS = (*_missing(), *_older(), *_living())
