# SPDX-License-Identifier: Apache-2.0
"""Faults in permissions: rules that are wider, narrower or in another order; dates, domains and generations."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator
from datetime import timedelta

from cryptography import x509
from lxml import etree

from tests.real.handmade import criteria, rule

from .fault import Fault
from .fault_keystores import (
    CAMERA,
    DAY,
    LISTENER,
    PLANNER,
    SUBJECTS,
    TALKER,
    Keystore,
    first_grant,
    put,
    rules_of,
)

Edit = Callable[[etree._Element], None]
ALL = rule("allow", criteria("publish", ["*"]) + criteria("subscribe", ["*"]))


# -- rules -----------------------------------------------------------------------------------------------------------


def _edited(subject: str, edit: Edit) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(subject)
        edit(first_grant(document))
        keystore.sign_permissions(subject, document)

    return apply


def _topics(grant: etree._Element, effect: str = "allow") -> list[etree._Element]:
    return list(grant.iterfind(f"{effect}_rule/*/topics/topic"))


def _renamed(change: Callable[[str], str], at: int = 0) -> Edit:
    def edit(grant: etree._Element) -> None:
        topic = _topics(grant)[at]
        topic.text = change(topic.text or "")

    return edit


def _inserted(text: str, *, first: bool = False) -> Edit:
    def edit(grant: etree._Element) -> None:
        rules = rules_of(grant)
        for each in list(etree.fromstring(f"<r>{text}</r>")):
            if first:
                rules[0].addprevious(each)
            else:
                rules[-1].addnext(each)
                rules.append(each)

    return edit


def _default(grant: etree._Element) -> None:
    default = grant.find("default")
    assert default is not None
    default.text = "ALLOW"


def _without(path: str) -> Edit:
    def edit(grant: etree._Element) -> None:
        found = grant.find(path)
        assert found is not None
        holder = found.getparent()
        assert holder is not None
        holder.remove(found)

    return edit


def _one_more(topic: str) -> Edit:
    def edit(grant: etree._Element) -> None:
        etree.SubElement(next(grant.iterfind("allow_rule/*/topics")), "topic").text = topic

    return edit


def _both_directions(grant: etree._Element) -> None:
    for allow in grant.findall("allow_rule"):
        for one, two in (("publish", "subscribe"), ("subscribe", "publish")):
            for each in allow.findall(one):
                copy = etree.fromstring(etree.tostring(each))
                copy.tag = two
                each.addnext(copy)
        ordered = sorted(allow, key=lambda each: ("domains", "publish", "subscribe").index(each.tag))
        allow[:] = ordered


WIDENED: dict[str, Edit] = {
    "a star behind": _renamed(lambda name: f"{name}*"),
    "a star behind the last": _renamed(lambda name: f"{name}*", -1),
    "a question mark": _renamed(lambda name: f"{name[:-1]}?"),
    "a class": _renamed(lambda name: f"{name[:-1]}[!_]"),
    "all of ROS": _renamed(lambda _: "rt/*"),
    "everything": _renamed(lambda _: "*", -1),
    "another topic": _one_more("rt/new"),
    "a pattern": _one_more("rt/z?"),
    "another rule": _inserted(rule("allow", criteria("publish", ["rt/zz"]))),
    "another rule first": _inserted(ALL, first=True),
    "reading": _inserted(rule("allow", criteria("subscribe", ["rt/zz*"]))),
    "default": _default,
    "the other direction": _both_directions,
    "a deny, and then more": _inserted(
        rule("deny", criteria("publish", ["rt/new"])) + rule("allow", criteria("publish", ["rt/n*"]))
    ),
}


def _widened() -> Iterator[Fault]:
    for label, edit in WIDENED.items():
        for subject in SUBJECTS:
            # Fast DDS reads a default of ALLOW, and never uses it.
            vendors = "omg, cyclonedds" if label == "default" else "all"
            yield Fault(4, f"{subject} {label}", "dds", _edited(subject, edit), decides=None, vendors=vendors)
    yield Fault(4, f"{TALKER} without its deny", "dds", _edited(TALKER, _without("deny_rule")), decides=None)

    def narrower_deny(grant: etree._Element) -> None:
        _topics(grant, "deny")[0].text = "rt/status/secre"

    yield Fault(4, f"{TALKER} denies another", "dds", _edited(TALKER, narrower_deny), decides=None)


NARROWED: dict[str, Edit] = {
    "no first topic": _renamed(lambda _: "rt/elsewhere"),
    "no last topic": _renamed(lambda _: "rt/elsewhere", -1),
    "other case": _renamed(str.upper),
    "a blank in front": _renamed(lambda name: f"rt/ {name[3:]}"),
    "a letter less": _renamed(lambda name: name[:-1]),
    "a deny in front": _inserted(rule("deny", criteria("publish", ["*"]) + criteria("subscribe", ["*"])), first=True),
    "a deny of what is read": _inserted(rule("deny", criteria("subscribe", ["r*"])), first=True),
    "a deny of what is written": _inserted(rule("deny", criteria("publish", ["r*"])), first=True),
    "no first rule": _without("allow_rule"),
    "another partition": lambda grant: _partitions(grant, "elsewhere"),
}


def _partitions(grant: etree._Element, name: str) -> None:
    for each in grant.iterfind("allow_rule/*/topics"):
        holder = etree.Element("partitions")
        etree.SubElement(holder, "partition").text = name
        each.addnext(holder)


def _narrowed() -> Iterator[Fault]:
    for label, edit in NARROWED.items():
        for subject in SUBJECTS:
            # The topic check of Cyclone DDS 0.10 ignores directions: any deny of an endpoint's topic decides.
            decides = True if label.startswith("a deny") else None
            yield Fault(5, f"{subject} {label}", "dds", _edited(subject, edit), decides=decides)
    for subject in SUBJECTS:
        late = _inserted(rule("deny", criteria("publish", ["*"]) + criteria("subscribe", ["*"])))
        yield Fault(5, f"{subject} a deny at the end", "dds", _edited(subject, late), decides=None)


def _order(seed: int, what: str) -> Edit:
    def edit(grant: etree._Element) -> None:
        chance = random.Random(seed)
        if what == "rules":
            rules = rules_of(grant)
            places = [grant.index(each) for each in rules]
            shuffled = rules[:]
            while shuffled == rules and len(rules) > 1:
                chance.shuffle(shuffled)
            for each in rules:
                grant.remove(each)
            for place, each in zip(places, shuffled, strict=True):
                grant.insert(place, each)
            return
        for holder in grant.iterfind("allow_rule/*/topics"):
            holder[:] = chance.sample(list(holder), len(holder))

    return edit


def _split_topics(grant: etree._Element) -> None:
    """Give each topic of a rule a rule of its own: the same rights."""
    for allow in grant.findall("allow_rule"):
        domains = allow.find("domains")
        assert domains is not None
        for each in reversed(list(allow)):
            for topic in each.iterfind("topics/topic"):
                copy = etree.fromstring(rule("allow", criteria(each.tag, [topic.text or ""])))
                allow.addnext(copy)
        grant.remove(allow)


def _doubled_rules(grant: etree._Element) -> None:
    for each in rules_of(grant):
        each.addnext(etree.fromstring(etree.tostring(each)))


def _reordered() -> Iterator[Fault]:
    for number in range(30):
        yield Fault(6, f"{TALKER} rules {number}", "dds", _edited(TALKER, _order(number, "rules")), decides=None)
    for number, subject in itertools.product(range(3), SUBJECTS):
        yield Fault(6, f"{subject} topics {number}", "dds", _edited(subject, _order(number, "topics")), decides=None)
    for subject in SUBJECTS:
        yield Fault(6, f"{subject} a rule for each topic", "dds", _edited(subject, _split_topics), decides=None)
        yield Fault(6, f"{subject} each rule twice", "dds", _edited(subject, _doubled_rules), decides=None)
    last = _inserted(rule("deny", criteria("publish", ["rt/status/secret"])))

    def deny_last(grant: etree._Element) -> None:
        _without("deny_rule")(grant)
        last(grant)

    yield Fault(6, f"{TALKER} its deny at the end", "dds", _edited(TALKER, deny_last), decides=None)


# -- dates and domains -----------------------------------------------------------------------------------------------


def _dated(
    subject: str, begin: timedelta | None, end: timedelta | None, suffix: str = ""
) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        def edit(grant: etree._Element) -> None:
            for tag, moved in (("not_before", begin), ("not_after", end)):
                if moved is not None:
                    found = grant.find(f"validity/{tag}")
                    assert found is not None
                    found.text = f"{keystore.now + moved:%Y-%m-%dT%H:%M:%S}{suffix}"

        _edited(subject, edit)(keystore)

    return apply


def _certified(subject: str, begin: timedelta, end: timedelta) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        put(keystore.enclave(subject) / "cert.pem", keystore.issue(subject, begin=begin, end=end))

    return apply


_BOUNDED = "rights do not change; when they end, 'prove' says so, and 'check' compares with the sources"


def _dates() -> Iterator[Fault]:
    for subject in SUBJECTS:
        for label, begin, end in (
            ("grant over since yesterday", -30 * DAY, -DAY),
            ("grant over since a minute", None, timedelta(minutes=-1)),
            ("grant begins tomorrow", DAY, None),
            ("grant begins after its end", 400 * DAY, 300 * DAY),
            ("grant begins in an hour", timedelta(hours=1), None),
        ):
            yield Fault(7, f"{subject} {label}", "dds", _dated(subject, begin, end))
        for label, end in (("grant ends tomorrow", DAY), ("grant ends in nine years", 9 * 365 * DAY)):
            yield Fault(
                7, f"{subject} {label}", "dds", _dated(subject, None, end), decides=False, check=True, why=_BOUNDED
            )
        for label, begin, end in (
            ("certificate over", -30 * DAY, -DAY),
            ("certificate begins tomorrow", DAY, 300 * DAY),
            ("certificate over since a minute", -DAY, timedelta(minutes=-1)),
        ):
            yield Fault(7, f"{subject} {label}", "dds", _certified(subject, begin, end))
        yield Fault(
            7, f"{subject} certificate for eight years that no register knows", "dds",
            _certified(subject, -DAY, 8 * 365 * DAY), vendors="all, later", prove=True,
        )  # fmt: skip
    for subject in (TALKER, PLANNER):
        beyond = _dated(subject, None, timedelta(days=365 * 300))
        yield Fault(7, f"{subject} grant ends in 300 years", "dds", beyond, vendors="cyclonedds")
        early = _dated(subject, timedelta(hours=2), None, "+05:00")
        yield Fault(7, f"{subject} grant begins by a zone", "dds", early, vendors="fastdds")


def _in_domains(text: str) -> Edit:
    def edit(grant: etree._Element) -> None:
        for domains in grant.iter("domains"):
            for each in list(domains):
                domains.remove(each)
            for each in etree.fromstring(f"<d>{text}</d>"):
                domains.append(each)

    return edit


DOMAINS = {
    "another": "<id>1</id>",
    "five": "<id>5</id>",
    "a range beyond": "<id_range><min>1</min><max>230</max></id_range>",
}
MORE_DOMAINS = {
    "one more": "<id>0</id><id>1</id>",
    "a range": "<id_range><min>0</min><max>5</max></id_range>",
    "all": "<id_range><min>0</min><max>230</max></id_range>",
    "one more in front": "<id>5</id><id>0</id>",
}


def _domains() -> Iterator[Fault]:
    for subject in SUBJECTS:
        for label, text in DOMAINS.items():
            yield Fault(8, f"{subject} {label}", "dds", _edited(subject, _in_domains(text)), decides=None)
        for label, text in MORE_DOMAINS.items():
            name = f"{subject} {label}"
            yield Fault(8, name, "dds", _edited(subject, _in_domains(text)), decides=None, vendors="a peer with it")
        same = "<id_range><min>0</min><max>0</max></id_range>"
        yield Fault(8, f"{subject} the same as a range", "dds", _edited(subject, _in_domains(same)), decides=None)
    for label, text in {**DOMAINS, **MORE_DOMAINS}.items():
        for subjects in ((TALKER,), (LISTENER, CAMERA), SUBJECTS):

            def everywhere(keystore: Keystore, text: str = text, subjects: tuple[str, ...] = subjects) -> None:
                document = keystore.governance()
                _in_domains(text)(document)
                keystore.sign_governance(subjects, document)
                for subject in subjects:
                    _edited(subject, _in_domains(text))(keystore)

            yield Fault(8, f"{label} in governance as well, of {len(subjects)}", "dds", everywhere)


# -- who signs -------------------------------------------------------------------------------------------------------


def _replaced(subject: str, number: int, files: tuple[str, ...], *, donor: str = "") -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        for name in files:
            put(keystore.enclave(subject) / name, (keystore.stage(number, donor or subject) / name).read_bytes())

    return apply


PERMISSIONS_FILES = ("permissions.p7s", "permissions.xml")


def _generations() -> Iterator[Fault]:
    for subject, number in itertools.product(SUBJECTS, (0, 1)):
        for label, files in (
            ("permissions", PERMISSIONS_FILES),
            ("certificate", ("cert.pem",)),
            ("certificate and permissions", ("cert.pem", *PERMISSIONS_FILES)),
            ("signed permissions alone", ("permissions.p7s",)),
        ):
            name = f"{subject} {label} of generation {number}"
            yield Fault(9, name, "generations", _replaced(subject, number, files))
        other = SUBJECTS[(SUBJECTS.index(subject) + 1) % len(SUBJECTS)]
        apply = _replaced(subject, number, PERMISSIONS_FILES, donor=other)
        yield Fault(9, f"{subject} permissions of generation {number} of {other}", "generations", apply)

        def appended(keystore: Keystore, subject: str = subject, number: int = number) -> None:
            from .fault_keystores import parsed

            document = keystore.permissions(subject)
            old = first_grant(parsed((keystore.stage(number, subject) / "permissions.xml").read_bytes()))
            first_grant(document).addnext(old)
            keystore.sign_permissions(subject, document)

        name = f"{subject} a grant of generation {number} behind its own"
        yield Fault(9, name, "generations", appended, decides=False)
    for subject in SUBJECTS:
        apply = _replaced(subject, 0, PERMISSIONS_FILES)
        yield Fault(9, f"{subject} wider permissions of the same generation", "narrowed", apply, decides=None)
        name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, subject)])

        def plain(keystore: Keystore, subject: str = subject, name: x509.Name = name) -> None:
            put(keystore.enclave(subject) / "cert.pem", keystore.issue(subject, name=name))

        yield Fault(9, f"{subject} a certificate without generation", "generations", plain)


FAULTS = (
    *_widened(), *_narrowed(), *_reordered(), *_dates(), *_domains(),
    *_generations(),
)  # fmt: skip
