# SPDX-License-Identifier: Apache-2.0
"""Faults by grants for others in the permissions of an enclave: by exact names, by containment, by spelling."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from tests.real.handmade import criteria, rule

from .fault import Fault
from .fault_keystores import (
    LISTENER,
    PLAIN,
    PLANNER,
    ROBOT,
    SUBJECTS,
    TALKER,
    Keystore,
    each_pair,
    first_grant,
    new_grant,
)
from .faults_of_permissions import ALL

RIGHTS = {
    "everything": ALL,
    "a topic": rule("allow", criteria("publish", ["rt/zz"])),
    "reading all topics": rule("allow", criteria("subscribe", ["rt/*"])),
    "all but one": rule("deny", criteria("publish", ["rt/tf"])) + ALL,
}
"""Rights that no subject has."""


def _add(host: str, subject_name: Callable[[Keystore], str], rights: str, *, first: bool = False) -> Callable:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(host)
        own = first_grant(document)
        added = new_grant(own, subject_name(keystore), RIGHTS.get(rights, rights))
        (own.addprevious if first else own.addnext)(added)
        keystore.sign_permissions(host, document)

    return apply


def _exact_names() -> Iterator[Fault]:
    for number, (host, victim) in enumerate(each_pair()):
        for rights, first in zip(RIGHTS, (number % 2 == 0, True, False, number % 2 == 1), strict=True):
            name = f"{host} has {rights} for {victim} {'first' if first else 'last'}"
            yield Fault(1, name, "dds", _add(host, lambda ks, v=victim: ks.name(v), rights, first=first))
    for host, victim in each_pair((TALKER, LISTENER, PLANNER)):

        def own_rights(keystore: Keystore, host: str = host, victim: str = victim) -> None:
            document = keystore.permissions(host)
            first_grant(document).addnext(first_grant(keystore.permissions(victim)))
            keystore.sign_permissions(host, document)

        yield Fault(1, f"{host} has the grant of {victim} unchanged", "dds", own_rights, decides=False)
        apply = _add(host, lambda ks, v=victim: ks.name(v).replace(",OU=", ",OU=0"), "everything")
        yield Fault(1, f"{host} has a grant for another generation of {victim}", "dds", apply, decides=False)
    apply = _add(TALKER, lambda _: "CN=/nobody,OU=00", "everything")
    yield Fault(1, "a grant for nobody", "dds", apply, decides=False)
    for host, victim in each_pair(PLAIN):
        apply = _add(host, lambda ks, v=victim: ks.name(v), "everything")
        yield Fault(1, f"{host} has everything for {victim} by plain names", "plain names", apply, subjects=PLAIN)


def _split(name: str) -> tuple[str, str]:
    cn, ou = name.split(",")
    return cn.removeprefix("CN="), ou.removeprefix("OU=")


CONTAINING: dict[str, Callable[[str, str], str]] = {
    "RDN behind": lambda cn, ou: f"CN={cn},OU={ou},O=x",
    "RDN before": lambda cn, ou: f"O=x,CN={cn},OU={ou}",
    "RDN between": lambda cn, ou: f"CN={cn},O=x,OU={ou}",
    "longer path": lambda cn, ou: f"CN={cn}/more,OU={ou}",
    "path before": lambda cn, ou: f"CN=/more{cn},OU={ou}",
    "slash for comma": lambda cn, ou: f"CN={cn}/OU={ou}",
    "bar for comma": lambda cn, ou: f"CN={cn}|OU={ou}",
    "bars for slashes": lambda cn, ou: f"CN={cn.replace('/', '|')},OU={ou}",
    "doubled": lambda cn, ou: f"CN={cn},OU={ou},CN={cn},OU={ou}",
    "reversed path": lambda cn, ou: f"CN=/{'/'.join(reversed(cn[1:].split('/')))}/z,OU={ou}",
    "two generations": lambda cn, ou: f"CN={cn},OU={ou},OU=0",
    "doubled generation": lambda cn, ou: f"CN={cn},OU={ou},OU={ou}",
    "one line": lambda cn, ou: f"/CN=/x{cn}/OU={ou}",
}
"""Names with which every token of an identity's name occurs in the grant's, as Cyclone DDS splits both."""
NEAR = {
    "no generation": lambda cn, _ou: f"CN={cn}/more",
    "letter case": lambda cn, ou: f"CN={cn.upper()}/more,OU={ou}",
    "longer word": lambda cn, ou: f"CN={cn}more,OU={ou}",
    "part of the generation": lambda cn, ou: f"CN={cn}/more,OU={ou[:-1]}",
    "another generation first": lambda cn, ou: f"CN={cn},OU=0,OU={ou}",
}
"""Names that look like it, and fit nothing."""


def _named(victim: str, form: Callable[[str, str], str]) -> Callable[[Keystore], str]:
    return lambda keystore: form(*_split(keystore.name(victim)))


def _containment() -> Iterator[Fault]:
    for number, (label, form) in enumerate(CONTAINING.items()):
        for at, victim in enumerate(SUBJECTS):
            host = SUBJECTS[(at + 1 + number % 4) % len(SUBJECTS)]
            rights = tuple(RIGHTS)[(number + at) % len(RIGHTS)]
            apply = _add(host, _named(victim, form), rights, first=bool(at % 2))
            yield Fault(2, f"{host} has {rights} for {victim} by {label}", "dds", apply, vendors="cyclonedds")
    for label, form in NEAR.items():
        for host, victim in ((TALKER, LISTENER), (LISTENER, ROBOT)):
            apply = _add(host, _named(victim, form), "everything")
            yield Fault(2, f"{host} has nothing for {victim} by {label}", "dds", apply, decides=False)
    for one, two in each_pair((TALKER, LISTENER, PLANNER)):

        def both(keystore: Keystore, one: str = one, two: str = two) -> str:
            return f"{keystore.name(one)},{keystore.name(two)}"

        name = f"{ROBOT} has everything for {one} and {two} in one name"
        yield Fault(2, name, "dds", _add(ROBOT, both, "everything"), vendors="cyclonedds")
    for host, victim in each_pair(PLAIN):
        apply = _add(host, lambda ks, v=victim: f"{ks.name(v)}/more", "everything")
        yield Fault(
            2, f"{host} has everything for {victim} by a longer plain name", "plain names", apply, vendors="cyclonedds",
            subjects=PLAIN,
        )  # fmt: skip


SPELLINGS: dict[str, tuple[Callable[[str, str], str], str]] = {
    "order": (lambda cn, ou: f"OU={ou},CN={cn}", "cyclonedds, fastdds-2.11"),
    "blank after the comma": (lambda cn, ou: f"CN={cn}, OU={ou}", "fastdds-2.11"),
    "blank before the comma": (lambda cn, ou: f"CN={cn} ,OU={ou}", "fastdds-2.11"),
    "blanks round the first sign": (lambda cn, ou: f"CN = {cn},OU={ou}", "fastdds-2.11"),
    "blanks round both signs": (lambda cn, ou: f"CN = {cn}, OU = {ou}", "fastdds-2.11"),
    "quotes": (lambda cn, ou: f'CN="{cn}",OU={ou}', "fastdds-2.11"),
    "quoted generation": (lambda cn, ou: f'CN={cn},OU="{ou}"', "fastdds-2.11"),
    "quotes and order": (lambda cn, ou: f'OU="{ou}",CN="{cn}"', "fastdds-2.11"),
    "order and blanks": (lambda cn, ou: f"OU={ou}, CN={cn}", "fastdds-2.11"),
    "a backslash": (lambda cn, ou: f"CN=\\{cn},OU={ou}", "fastdds-2.11"),
    "a comma at the end": (lambda cn, ou: f"CN={cn},OU={ou},", "cyclonedds, fastdds-2.9, fastdds-2.11"),
    "leading blank": (lambda cn, ou: f" CN={cn},OU={ou}", "cyclonedds, fastdds-2.11"),
}
"""Spellings of a name that a vendor takes for the same, most of them Fast DDS from 2.11 on: it compares attributes."""


def _spellings() -> Iterator[Fault]:
    for number, (label, (form, vendors)) in enumerate(SPELLINGS.items()):
        for at, victim in enumerate(SUBJECTS):
            host = SUBJECTS[(at + 2 + number % 3) % len(SUBJECTS)]
            rights = tuple(RIGHTS)[(number + at) % len(RIGHTS)]
            apply = _add(host, _named(victim, form), rights, first=bool(number % 2))
            yield Fault(3, f"{host} has {rights} for {victim} by {label}", "dds", apply, vendors=vendors)
    for label, form in (
        ("other case", lambda cn, ou: f"CN={cn.upper()},OU={ou}"),
        ("semicolon", lambda cn, ou: f"CN={cn};OU={ou}"),
        ("a plus sign", lambda cn, ou: f"CN={cn}+OU={ou}"),
    ):
        apply = _add(TALKER, _named(LISTENER, form), "everything")
        yield Fault(3, f"{TALKER} has nothing for {LISTENER} by {label}", "dds", apply, decides=False)
    for label, form in (  # no vendor takes them for the same; the standard does
        ("the number of an attribute", lambda cn, ou: f"2.5.4.3={cn},OU={ou}"),
        ("hexadecimal", lambda cn, ou: f"CN=\\2F{cn[1:]},OU={ou}"),
    ):
        apply = _add(TALKER, _named(LISTENER, form), "everything")
        yield Fault(3, f"{TALKER} has everything for {LISTENER} by {label}", "dds", apply, vendors="omg")


FAULTS = (*_exact_names(), *_containment(), *_spellings())
