# SPDX-License-Identifier: Apache-2.0
"""Faults in the files of a keystore: modes, links and strays, and exchanged keys and certificates."""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Callable, Iterator, Sequence

from cryptography.hazmat.primitives.asymmetric import ec

from .fault import Fault
from .fault_keystores import (
    SUBJECTS,
    TALKER,
    Keystore,
    each_pair,
    private_pem,
    put,
)

Apply = Callable[[Keystore], None]


# -- modes, links and strays -----------------------------------------------------------------------------------------

_CHECK_ONLY = "what others on this machine may read or write is what 'check' judges: no vendor decides by it"


def _chmod(path: str, mode: int) -> Apply:
    return lambda keystore: (keystore.ws / path).chmod(mode)


def _linked(path: str, *, outside: bool, hard: bool = False) -> Apply:
    def apply(keystore: Keystore) -> None:
        file = keystore.ws / path
        other = keystore.ws.parent / "elsewhere" if outside else file.with_name(f"{file.name}.real")
        shutil.move(file, other)
        if hard:
            os.link(other, file)
        else:
            file.symlink_to(os.path.relpath(other, file.parent))

    return apply


def _stray(path: str, content: Callable[[Keystore], bytes]) -> Apply:
    def apply(keystore: Keystore) -> None:
        file = keystore.ws / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content(keystore))

    return apply


def _folder(path: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        (keystore.ws / path).unlink()
        (keystore.ws / path).mkdir()

    return apply


def _pipe(path: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        (keystore.ws / path).unlink()
        os.mkfifo(keystore.ws / path)

    return apply


TOKEN = b"pkcs11:token=other;object=other;type=private"
TOKENS = ("key", "cert", "identity_ca.cert", "permissions_ca.cert")
"""Files that Fast DDS reads before the PEM file, by ``rmw_fastrtps`` from Jazzy on, if they end in ``.p11``."""


def _on_disk() -> Iterator[Fault]:
    for subject in SUBJECTS:
        place = f"install/enclaves{subject}"
        for mode in (0o644, 0o640, 0o606):
            yield _of_check(f"{subject} key {mode:o}", _chmod(f"{place}/key.pem", mode))
        yield _of_check(f"{subject} permissions for all to write", _chmod(f"{place}/permissions.p7s", 0o666))
        yield _of_check(f"{subject} folder for all to write", _chmod(place, 0o777))
        yield _of_check(f"{subject} private key {0o644:o}", _chmod(f"private/identities{subject}/key.pem", 0o644))
        for name in ("cert.pem", "permissions.p7s", "identity_ca.cert.pem"):
            yield _of_check(f"{subject} {name} by a link to outside", _linked(f"{place}/{name}", outside=True))
        yield _of_check(
            f"{subject} key by a hard link", _linked(f"{place}/key.pem", outside=True, hard=True), check=None
        )
        yield _of_check(f"{subject} a text", _stray(f"{place}/notes.txt", lambda _: b"x"))
        for role in ("identity_ca", "permissions_ca"):
            yield _of_check(
                f"{subject} the key of {role}",
                _stray(f"{place}/{role}.key.pem", lambda ks, r=role: (ks.ws / f"private/{r}.key.pem").read_bytes()),
            )
        for token in TOKENS:
            yield Fault(19, f"{subject} {token}.p11", "dds", _stray(f"{place}/{token}.p11", lambda _: TOKEN),
                        vendors="fastdds from Jazzy on")  # fmt: skip
        for name in ("key.pem", "governance.p7s"):
            yield Fault(19, f"{subject} {name} is a folder", "dds", _folder(f"{place}/{name}"))
        yield Fault(19, f"{subject} permissions are a pipe", "dds", _pipe(f"{place}/permissions.p7s"))
    for name in ("identity_ca", "permissions_ca"):
        yield _of_check(f"the private key of {name} for the group", _chmod(f"private/{name}.key.pem", 0o640))
        copy = _stray(
            f"install/public/{name}.key.pem", lambda ks, n=name: (ks.ws / f"private/{n}.key.pem").read_bytes()
        )
        yield _of_check(f"the private key of {name} in the keystore", copy)
    yield _of_check("private space for all", _chmod("private", 0o755))

    def extra(keystore: Keystore) -> None:
        shutil.copytree(keystore.enclave(TALKER), keystore.ws / "install/enclaves/twin")

    yield Fault(19, "a copy of an enclave by another name", "dds", extra, decides=False, check=True,
                why="its holder has the rights of the original: nothing new")  # fmt: skip


def _of_check(name: str, apply: Apply, *, check: bool | None = True) -> Fault:
    return Fault(19, name, "dds", apply, decides=False, check=check, why=_CHECK_ONLY)


# -- keys ------------------------------------------------------------------------------------------------------------


def exchanged_files(subject: str, donor: str, names: Sequence[str]) -> Apply:
    def apply(keystore: Keystore) -> None:
        for name in names:
            put(keystore.enclave(subject) / name, (keystore.enclave(donor) / name).read_bytes())

    return apply


def _swapped(one: str, two: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        first, second = keystore.enclave(one), keystore.enclave(two)
        for path in [each for each in first.iterdir() if each.is_file()]:
            content = path.read_bytes()
            put(path, (second / path.name).read_bytes())
            put(second / path.name, content)
        for subject in (one, two):
            (keystore.enclave(subject) / "key.pem").chmod(0o600)

    return apply


EXCHANGED = {
    "key": ("key.pem",),
    "certificate": ("cert.pem",),
    "certificate and key": ("cert.pem", "key.pem"),
    "permissions": ("permissions.p7s", "permissions.xml"),
    "all but authorities": ("cert.pem", "key.pem", "permissions.p7s", "permissions.xml"),
}


def new_key(subject: str, *, certified: bool, kept: bool) -> Apply:
    """Give an enclave a key of nobody, with or without a certificate by the real authority for it."""

    def apply(keystore: Keystore) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        path = keystore.enclave(subject) / "key.pem"
        path.write_bytes(private_pem(key))
        if kept:
            (keystore.ws / f"private/identities{subject}/key.pem").write_bytes(private_pem(key))
        if certified:
            put(keystore.enclave(subject) / "cert.pem", keystore.issue(subject, key=key.public_key()))

    return apply


def unregistered(subject: str, donor: str = "") -> Apply:
    """Issue a certificate again that no register knows, perhaps for the key of another."""

    def apply(keystore: Keystore) -> None:
        key = keystore.certificate(donor or subject).public_key()
        pem = keystore.issue(subject, key=key)  # type: ignore[arg-type]
        put(keystore.enclave(subject) / "cert.pem", pem)
        if donor:
            (keystore.enclave(subject) / "key.pem").write_bytes((keystore.enclave(donor) / "key.pem").read_bytes())

    return apply


def _exchanged() -> Iterator[Fault]:
    pairs = list(each_pair())
    for number, (label, names) in enumerate(EXCHANGED.items()):
        for subject, donor in pairs[number % 2 :: 2]:
            yield Fault(20, f"{subject} has {label} of {donor}", "dds", exchanged_files(subject, donor, names))
    for one, two in itertools.combinations(SUBJECTS, 2):
        yield Fault(20, f"{one} and {two} exchanged", "dds", _swapped(one, two))
    for subject in SUBJECTS:
        yield Fault(20, f"{subject} a key of nobody", "dds", new_key(subject, certified=False, kept=False))
        for kept in (False, True):
            name = f"{subject} a key of nobody, certified{', also in private' * kept}"
            yield Fault(
                20, name, "dds", new_key(subject, certified=True, kept=kept), vendors="a thief's key is accepted"
            )
        apply = unregistered(subject)
        yield Fault(
            20, f"{subject} a certificate that no register knows", "dds", apply, vendors="no list can revoke it"
        )
        donor = SUBJECTS[(SUBJECTS.index(subject) + 1) % len(SUBJECTS)]
        name = f"{subject} a certificate for the key of {donor}"
        yield Fault(20, name, "dds", unregistered(subject, donor), vendors="whoever has that key is both")
        yield Fault(20, f"{subject} no key", "dds", lambda ks, s=subject: (ks.enclave(s) / "key.pem").unlink())

    def authorities(keystore: Keystore) -> None:
        one, two = (keystore.ws / f"private/{name}.key.pem" for name in ("identity_ca", "permissions_ca"))
        content = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(content)

    yield Fault(20, "the keys of the authorities", "dds", authorities, decides=False, check=True,
                why="no vendor has these keys: what they signed stays")  # fmt: skip


FAULTS = (*_on_disk(), *_exchanged())
