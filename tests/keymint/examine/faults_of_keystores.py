# SPDX-License-Identifier: Apache-2.0
"""Faults in the files of a keystore: revocation lists, phases of a rollover, modes and strays, exchanged keys."""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

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
    each_pair,
    first_grant,
    new_grant,
    private_pem,
    put,
    stranger,
)
from .faults_of_permissions import ALL, WIDENED
from .faults_of_signers import OPENED

ALIVE = (TALKER, LISTENER, ROBOT, PLANNER)
"""The enclaves that are left after the camera was revoked."""
Apply = Callable[[Keystore], None]
LIST = "crl.pem"


def _subsets(subjects: Sequence[str]) -> Iterator[tuple[str, ...]]:
    for size in range(1, len(subjects) + 1):
        yield from itertools.combinations(subjects, size)


def _said(subjects: Sequence[str]) -> str:
    return " ".join(subjects)


def _lists(subjects: Sequence[str], content: Callable[[Keystore], bytes | None]) -> Apply:
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
            yield Fault(14, f"{label} in {_said(subjects)}", "revoked", _lists(subjects, content))
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
        yield Fault(15, f"list {number} in {_said(subjects)}", "revoked", _lists(subjects, _of_stage(number)))
    for subjects in _subsets(ALIVE):
        yield Fault(
            15, f"list 3, with the same revocations, in {_said(subjects)}", "revoked", _lists(subjects, _of_stage(3)),
            decides=False, check=True, why="it revokes the same certificates: only its number and dates are older",
        )  # fmt: skip

        def fewer(keystore: Keystore) -> bytes:
            return keystore.revocation_list([_stolen(keystore)], number=7)

        name = f"a newer number and fewer revocations in {_said(subjects)}"
        yield Fault(15, name, "revoked", _lists(subjects, fewer))


def _living() -> Iterator[Fault]:
    for host, victim in itertools.product(SUBJECTS, SUBJECTS):

        def alone(keystore: Keystore, victim: str = victim) -> bytes:
            return keystore.revocation_list([keystore.certificate(victim).serial_number])

        yield Fault(16, f"{host} revokes {victim}", "dds", _lists([host], alone))
    for host, victim in itertools.product(ALIVE, ALIVE):

        def beside(keystore: Keystore, victim: str = victim) -> bytes:
            return keystore.revocation_list(_current(keystore) | {keystore.certificate(victim).serial_number})

        yield Fault(16, f"{host} revokes {victim} beside the thief", "revoked", _lists([host], beside))
    for host in SUBJECTS:
        for label, begin, end in (
            ("is over", -30 * DAY, -DAY),
            ("begins tomorrow", DAY, 30 * DAY),
            ("is over since a minute", -DAY, timedelta(minutes=-1)),
        ):

            def dated(keystore: Keystore, begin: timedelta = begin, end: timedelta = end) -> bytes:
                return keystore.revocation_list([], begin=begin, end=end)

            yield Fault(16, f"{host} has a list that {label}", "dds", _lists([host], dated))

        def foreign(keystore: Keystore) -> bytes:
            serial = keystore.certificate(LISTENER).serial_number
            return keystore.revocation_list([serial], issuer=stranger("identity_ca"))

        yield Fault(16, f"{host} has a list by a namesake of the authority", "dds", _lists([host], foreign))

        def harmless(keystore: Keystore) -> bytes:
            return keystore.revocation_list([7], number=1)

        yield Fault(
            16, f"{host} has a list that revokes nobody that was issued", "dds", _lists([host], harmless), decides=False,
            check=None, why="it refuses nobody; whether the register knows it is another question",
        )  # fmt: skip


# -- rollovers -------------------------------------------------------------------------------------------------------

STAGED = "install.next"


def _rights(subject: str, space: str, label: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(subject, space)
        WIDENED[label](first_grant(document))
        keystore.sign_permissions(subject, document, space)

    return apply


def _granted(subject: str, victim: str, space: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(subject, space)
        own = first_grant(document)
        own.addnext(new_grant(own, keystore.name(victim, space), ALL))
        keystore.sign_permissions(subject, document, space)

    return apply


def _opened(subject: str, space: str, label: str) -> Apply:
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


def _revokes(subject: str, victim: str, space: str) -> Apply:
    def apply(keystore: Keystore) -> None:
        serial = keystore.certificate(victim, space).serial_number
        issuer = keystore.issuer("identity_ca", subject, space)
        put(keystore.enclave(subject, space) / LIST, keystore.revocation_list([serial], issuer=issuer))

    return apply


def _everywhere(space: str) -> Iterator[tuple[str, Apply]]:
    """Yield faults that are the same in each keystore."""
    yield f"{TALKER} all of ROS", _rights(TALKER, space, "all of ROS")
    yield f"{PLANNER} reading", _rights(PLANNER, space, "reading")
    yield f"{TALKER} has everything for {LISTENER}", _granted(TALKER, LISTENER, space)
    yield f"{CAMERA} has everything for {ROBOT}", _granted(CAMERA, ROBOT, space)
    yield f"{LISTENER} opened writing", _opened(LISTENER, space, "writing")
    yield f"{TALKER} opened names that nobody has", _opened(TALKER, space, "names that nobody has")
    yield f"{TALKER} has the permissions of {LISTENER}", _copied("permissions.p7s", TALKER, LISTENER, space)
    yield f"{TALKER} has the key of {LISTENER}", _copied("key.pem", TALKER, LISTENER, space)
    yield f"{LISTENER} has the certificate of {ROBOT}", _copied("cert.pem", LISTENER, ROBOT, space)
    yield f"{LISTENER} has no certificate", _removed("cert.pem", LISTENER, space)
    yield f"{ROBOT} has no key", _removed("key.pem", ROBOT, space)
    yield f"{ROBOT} has no permissions", _removed("permissions.p7s", ROBOT, space)
    yield f"{TALKER} trusts a stranger for identities", _trusts_stranger("identity_ca", TALKER, space)
    yield f"{TALKER} trusts a stranger for permissions", _trusts_stranger("permissions_ca", TALKER, space)
    yield f"{PLANNER} revokes {CAMERA}", _revokes(PLANNER, CAMERA, space)


_LATER = "every certificate of this phase is trusted; the next phase needs what is missing"


def _rollovers() -> Iterator[Fault]:
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
            uri = b"pkcs11:token=other;object=other;type=private"
            yield Fault(19, f"{subject} {token}.p11", "dds", _stray(f"{place}/{token}.p11", lambda _: uri),
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


def _files(subject: str, donor: str, names: Sequence[str]) -> Apply:
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


def _new_key(subject: str, *, certified: bool, kept: bool) -> Apply:
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


def _unregistered(subject: str, donor: str = "") -> Apply:
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
            yield Fault(20, f"{subject} has {label} of {donor}", "dds", _files(subject, donor, names))
    for one, two in itertools.combinations(SUBJECTS, 2):
        yield Fault(20, f"{one} and {two} exchanged", "dds", _swapped(one, two))
    for subject in SUBJECTS:
        yield Fault(20, f"{subject} a key of nobody", "dds", _new_key(subject, certified=False, kept=False))
        for kept in (False, True):
            name = f"{subject} a key of nobody, certified{', also in private' * kept}"
            yield Fault(
                20, name, "dds", _new_key(subject, certified=True, kept=kept), vendors="a thief's key is accepted"
            )
        apply = _unregistered(subject)
        yield Fault(
            20, f"{subject} a certificate that no register knows", "dds", apply, vendors="no list can revoke it"
        )
        donor = SUBJECTS[(SUBJECTS.index(subject) + 1) % len(SUBJECTS)]
        name = f"{subject} a certificate for the key of {donor}"
        yield Fault(20, name, "dds", _unregistered(subject, donor), vendors="whoever has that key is both")
        yield Fault(20, f"{subject} no key", "dds", lambda ks, s=subject: (ks.enclave(s) / "key.pem").unlink())

    def authorities(keystore: Keystore) -> None:
        one, two = (keystore.ws / f"private/{name}.key.pem" for name in ("identity_ca", "permissions_ca"))
        content = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(content)

    yield Fault(20, "the keys of the authorities", "dds", authorities, decides=False, check=True,
                why="no vendor has these keys: what they signed stays")  # fmt: skip


FAULTS = (*_missing(), *_older(), *_living(), *_rollovers(), *_on_disk(), *_exchanged())
