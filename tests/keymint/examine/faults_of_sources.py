# SPDX-License-Identifier: Apache-2.0
"""Faults that leave no trace in a record: the policy changes without a new installation, or sources without the policy.

What is installed is signed, recorded and equal to what is built; only what the policy says is different.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from lxml import etree

from .fault import Fault
from .fault_keystores import SUBJECTS, Keystore

Edit = Callable[[etree._Element], None]
"""Changes the profile of a subject in a policy, or the grant of a package."""


def _policy(subject: str, edit: Edit) -> Callable[[Keystore], None]:
    """Change what the policy says of a subject, and install nothing."""

    def apply(keystore: Keystore) -> None:
        path = keystore.ws.parent / "policy.xml"
        root = etree.fromstring(path.read_bytes())
        (profile,) = (each for each in root.iterfind("profile") if each.findtext("attachment") == subject)
        edit(profile)
        path.write_bytes(etree.tostring(root))

    return apply


def _source(subject: str, edit: Edit) -> Callable[[Keystore], None]:
    """Change the sources of a package, and install what is made of them."""

    def apply(keystore: Keystore) -> None:
        path = keystore.ws / f"src{subject}/permissions.xml"
        root = etree.fromstring(path.read_bytes())
        grant = root.find(".//grant")
        assert grant is not None
        edit(grant)
        path.write_bytes(etree.tostring(root))
        keystore.do("build")
        keystore.do("install", "--no-prove")

    return apply


def _governance(subjects: tuple[str, ...], text: str) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        for subject in subjects:
            path = keystore.ws / f"src{subject}/governance.xml"
            old = path.read_text()
            path.write_text(old.replace("<domain_rule/>", f"<domain_rule>{text}</domain_rule>"))
            assert path.read_text() != old
        keystore.do("build")
        keystore.do("install", "--no-prove")

    return apply


def _rules(holder: etree._Element) -> list[etree._Element]:
    return [each for each in holder.iterfind("*") if each.get("qualifier") == "ALLOW"]


def _without(at: int) -> Edit:
    return lambda holder: holder.remove(_rules(holder)[at])


def _one_more(name: str, permission: str, effect: str = "ALLOW") -> Edit:
    def edit(holder: etree._Element) -> None:
        text = (
            f'<ros_topic qualifier="{effect}"><attachment>{name}</attachment>'
            f"<permissions><{permission}/></permissions></ros_topic>"
        )
        _rules(holder)[0].addprevious(etree.fromstring(text))

    return edit


def _renamed(suffix: str) -> Edit:
    def edit(holder: etree._Element) -> None:
        attachment = _rules(holder)[-1].find("attachment")
        assert attachment is not None
        attachment.text = f"{attachment.text}{suffix}"

    return edit


def _denied(holder: etree._Element) -> None:
    """Deny what the first rule allows."""
    first = _rules(holder)[0]
    copy = etree.fromstring(etree.tostring(first))
    copy.set("qualifier", "DENY")
    first.addprevious(copy)


def _removed(holder: etree._Element) -> None:
    parent = holder.getparent()
    assert parent is not None
    parent.remove(holder)


def _doubled(holder: etree._Element) -> None:
    """Say the first rule twice, which allows nothing else."""
    first = _rules(holder)[0]
    first.addnext(etree.fromstring(etree.tostring(first)))


LESS: dict[str, Edit] = {
    "no first rule": _without(0),
    "no last rule": _without(-1),
    "a deny": _denied,
    "a longer name": _renamed("2"),
}
MORE: dict[str, Edit] = {
    "publishing one more": _one_more("/new", "ros_publish"),
    "reading one more": _one_more("/new", "ros_subscribe"),
    "reading everything": _one_more("/*", "ros_subscribe"),
}
OPEN = {
    "reading": "<topic_access_rules><topic_rule><topic_expression>*</topic_expression>"
    "<enable_read_access_control>false</enable_read_access_control></topic_rule></topic_access_rules>",
    "writing": "<topic_access_rules><topic_rule><topic_expression>*</topic_expression>"
    "<enable_write_access_control>false</enable_write_access_control></topic_rule></topic_access_rules>",
    "names that nobody has": "<topic_access_rules><topic_rule><topic_expression>rt/zz*</topic_expression>"
    "<enable_write_access_control>false</enable_write_access_control></topic_rule></topic_access_rules>",
}


def _drift() -> Iterator[Fault]:
    for subject in SUBJECTS:
        for label, edit in LESS.items():
            yield Fault(4, f"{subject} by a policy with {label}", "dds", _policy(subject, edit))
            yield Fault(5, f"{subject} by sources with {label}", "dds", _source(subject, edit))
        for label, edit in MORE.items():
            yield Fault(5, f"{subject} by a policy with {label}", "dds", _policy(subject, edit))
            yield Fault(4, f"{subject} by sources with {label}", "dds", _source(subject, edit))
        yield Fault(4, f"{subject} by a policy that does not name it", "dds", _policy(subject, _removed))
        yield Fault(
            6, f"{subject} by a policy that says a rule twice", "dds", _policy(subject, _doubled), decides=False
        )
        for label, text in OPEN.items():
            yield Fault(12, f"{label} by sources in {subject}", "dds", _governance((subject,), text))
    for label, text in OPEN.items():
        yield Fault(12, f"{label} by sources everywhere", "dds", _governance(SUBJECTS, text))


FAULTS = (*_drift(),)
