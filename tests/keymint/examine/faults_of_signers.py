# SPDX-License-Identifier: Apache-2.0
"""Faults by whoever signs: self-signed documents, other authorities, opened governance, missing and doubled rules."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from cryptography.hazmat.primitives.serialization import Encoding
from lxml import etree

from .fault import Fault
from .fault_keystores import (
    ADOPTED,
    LISTENER,
    PLANNER,
    SUBJECTS,
    TALKER,
    Issuer,
    Keystore,
    first_grant,
    new_grant,
    put,
    rules_of,
    stranger,
)
from .faults_of_permissions import ALL, WIDENED

Signer = Callable[[Keystore, str], Issuer]


def _own(keystore: Keystore, subject: str) -> Issuer:
    return keystore.with_key(keystore.certificate(subject))


def _next(keystore: Keystore, subject: str, subjects: Sequence[str] = SUBJECTS) -> Issuer:
    return _own(keystore, subjects[(subjects.index(subject) + 1) % len(subjects)])


SIGNERS: dict[str, Signer] = {
    "its own key": _own,
    "another enclave": _next,
    "a namesake of the authority": lambda _ks, _subject: stranger("permissions_ca"),
    "a self-signed stranger": lambda _ks, _subject: stranger("somebody"),
}


def _resigned(subject: str, signer: Signer, *, permissions: bool, wider: bool) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        found = signer(keystore, subject)
        if permissions:
            document = keystore.permissions(subject)
            if wider:
                rules_of(first_grant(document))[0].addprevious(etree.fromstring(ALL))
            keystore.sign_permissions(subject, document, signer=found)
            return
        document = keystore.governance()
        if wider:
            _flag("enable_write_access_control", "false")(document)
        keystore.sign_governance([subject], document, signer=found)

    return apply


def _self_signed() -> Iterator[Fault]:
    for subject in SUBJECTS:
        for label, signer in SIGNERS.items():
            for permissions in (True, False):
                for wider in (False, True):
                    what = f"{'wider ' * wider}{'permissions' if permissions else 'governance'}"
                    apply = _resigned(subject, signer, permissions=permissions, wider=wider)
                    yield Fault(10, f"{subject} {what} by {label}", "dds", apply)


def _trusting(subject: str, role: str, name: str, *, wider: bool) -> Callable[[Keystore], None]:
    """Let an enclave trust another authority, which signs all that is in it: its own vendor accepts it."""

    def apply(keystore: Keystore) -> None:
        other = keystore.issuer("identity_ca", subject) if name == "identity_ca" else stranger(name)
        put(keystore.enclave(subject) / f"{role}.cert.pem", other.certificate.public_bytes(Encoding.PEM))
        if role == "identity_ca":
            put(keystore.enclave(subject) / "cert.pem", keystore.issue(subject, issuer=other))
            return
        for permissions in (True, False):
            _resigned(subject, lambda _ks, _subject: other, permissions=permissions, wider=wider)(keystore)

    return apply


def _beside(subject: str, role: str, *, first: bool) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        path = keystore.enclave(subject) / f"{role}.cert.pem"
        other = stranger(f"{role}").certificate.public_bytes(Encoding.PEM)
        put(path, other + path.read_bytes() if first else path.read_bytes() + other)

    return apply


def _others() -> Iterator[Fault]:
    for subject in SUBJECTS:
        for permissions in (True, False):
            for wider in (False, True):
                what = f"{'wider ' * wider}{'permissions' if permissions else 'governance'}"
                apply = _resigned(
                    subject, lambda ks, who: ks.issuer("identity_ca", who), permissions=permissions, wider=wider
                )
                yield Fault(11, f"{subject} {what} by the identity authority", "dds", apply)
        for name in ("identity_ca", "permissions_ca", "somebody"):
            for wider in (False, True):
                apply = _trusting(subject, "permissions_ca", name, wider=wider)
                label = "wider documents" if wider else "documents"
                vendors = "all" if wider else "peers, which do not trust it"
                yield Fault(11, f"{subject} trusts {name} for {label}", "dds", apply, vendors=vendors)
        yield Fault(
            11, f"{subject} trusts a namesake for identities", "dds",
            _trusting(subject, "identity_ca", "namesake", wider=False),
        )  # fmt: skip
        for role in ("identity_ca", "permissions_ca"):
            for first in (False, True):
                name = f"{subject} trusts another {role} {'before' if first else 'beside'} its own"
                yield Fault(11, name, "dds", _beside(subject, role, first=first), vendors="fastdds")

        def foreign(keystore: Keystore, subject: str = subject) -> None:
            put(keystore.enclave(subject) / "cert.pem", keystore.issue(subject, issuer=stranger("identity_ca")))

        yield Fault(11, f"{subject} certificate by a namesake of the authority", "dds", foreign)


# -- governance ------------------------------------------------------------------------------------------------------

Edit = Callable[[etree._Element], None]


def _flag(tag: str, text: str) -> Edit:
    def edit(document: etree._Element) -> None:
        for each in document.iter(tag):
            each.text = text

    return edit


def _topic_rule(expression: str, *, first: bool = True, opened: bool = True) -> Edit:
    def edit(document: etree._Element) -> None:
        rule = next(document.iter("topic_rule"))
        copy = etree.fromstring(etree.tostring(rule))
        copy[0].text = expression
        if opened:
            for tag in ("enable_read_access_control", "enable_write_access_control"):
                _flag(tag, "false")(copy)
        (rule.addprevious if first else rule.addnext)(copy)

    return edit


OPENED: dict[str, Edit] = {
    "unauthenticated participants": _flag("allow_unauthenticated_participants", "true"),
    "joining": _flag("enable_join_access_control", "false"),
    "reading": _flag("enable_read_access_control", "false"),
    "writing": _flag("enable_write_access_control", "false"),
    "discovery in the clear": _flag("discovery_protection_kind", "NONE"),
    "liveliness in the clear": _flag("liveliness_protection_kind", "NONE"),
    "packets unsigned": _flag("rtps_protection_kind", "NONE"),
    "metadata in the clear": _flag("metadata_protection_kind", "NONE"),
    "metadata signed only": _flag("metadata_protection_kind", "SIGN"),
    "data in the clear": _flag("data_protection_kind", "NONE"),
    "data signed only": _flag("data_protection_kind", "SIGN"),
    "discovery of topics": _flag("enable_discovery_protection", "false"),
    "liveliness of topics": _flag("enable_liveliness_protection", "false"),
    "names of one letter": _topic_rule("rt/?"),
    "names that nobody has": _topic_rule("rt/zz*"),
    "one name": _topic_rule("rt/chatter"),
    "services": _topic_rule("r[qr]/*"),
    "all but ROS": _topic_rule("[!r]*"),
}


def _governed(subjects: Sequence[str], edit: Edit) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        document = keystore.governance()
        edit(document)
        keystore.sign_governance(subjects, document)

    return apply


def _opened() -> Iterator[Fault]:
    for number, (label, edit) in enumerate(OPENED.items()):
        one, two = SUBJECTS[number % len(SUBJECTS)], SUBJECTS[(number + 2) % len(SUBJECTS)]
        yield Fault(12, f"{label} in {one}", "dds", _governed([one], edit))
        yield Fault(12, f"{label} in {one} and {two}", "dds", _governed([one, two], edit))
        yield Fault(12, f"{label} everywhere", "dds", _governed(SUBJECTS, edit))


def _without(path: str) -> Edit:
    def edit(document: etree._Element) -> None:
        for found in document.findall(f".//{path}"):
            holder = found.getparent()
            assert holder is not None
            holder.remove(found)

    return edit


def _domain_rule(*, first: bool, opened: bool) -> Edit:
    def edit(document: etree._Element) -> None:
        rule = next(document.iter("domain_rule"))
        copy = etree.fromstring(etree.tostring(rule))
        if opened:
            _flag("enable_write_access_control", "false")(copy)
        (rule.addprevious if first else rule.addnext)(copy)

    return edit


def _renamed(expression: str) -> Edit:
    def edit(document: etree._Element) -> None:
        next(document.iter("topic_expression")).text = expression

    return edit


RULES_OF_GOVERNANCE: dict[str, tuple[Edit, bool, str]] = {
    "no topic rule": (_without("topic_rule"), True, "all"),
    "no domain rule": (_without("domain_rule"), True, "all"),
    "a topic rule for some": (_renamed("rt/[a-h]*"), True, "all"),
    "a topic rule for none": (_renamed("rt/never"), True, "all"),
    "an open topic rule first": (_topic_rule("*"), True, "all"),
    "an open topic rule behind": (_topic_rule("*", first=False), False, "opendds"),
    "the same topic rule twice": (_topic_rule("*", opened=False), False, ""),
    "an open domain rule first": (_domain_rule(first=True, opened=True), True, "all"),
    "an open domain rule behind": (_domain_rule(first=False, opened=True), False, ""),
    "the same domain rule twice": (_domain_rule(first=False, opened=False), False, ""),
}
"""What an edit of governance does, and whether and for whom it decides."""


def _grant_edit(subject: str, edit: Callable[[etree._Element], None]) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        document = keystore.permissions(subject)
        edit(document)
        keystore.sign_permissions(subject, document)

    return apply


def _no_rules(document: etree._Element) -> None:
    for each in rules_of(first_grant(document)):
        first_grant(document).remove(each)


def _grants(*, wider: bool, first: bool) -> Callable[[etree._Element], None]:
    def edit(document: etree._Element) -> None:
        own = first_grant(document)
        text = ALL if wider else "".join(etree.tostring(each).decode() for each in rules_of(own))
        added = new_grant(own, str(own.findtext("subject_name")), text, "/copy")
        (own.addprevious if first else own.addnext)(added)

    return edit


def _missing_grant(document: etree._Element) -> None:
    holder = first_grant(document).getparent()
    assert holder is not None
    holder.remove(first_grant(document))


def _for_another(document: etree._Element) -> None:
    name = document.find(".//subject_name")
    assert name is not None
    name.text = "CN=/nobody,OU=00"


RULES_OF_PERMISSIONS: dict[str, tuple[Callable[[etree._Element], None], bool | None, str]] = {
    "no rules": (_no_rules, True, "all"),
    "no grant": (_missing_grant, True, "all"),
    "a grant for nobody": (_for_another, True, "all"),
    "no default": (_without("default"), True, "fastdds"),
    "the same grant twice": (_grants(wider=False, first=False), False, ""),
    "a wider grant behind": (_grants(wider=True, first=False), True, "fastdds if the first is over"),
    "a wider grant first": (_grants(wider=True, first=True), True, "all"),
    "no validity": (_without("validity"), True, "all"),
}
_SECOND = (
    "today the first grant decides on every vendor: 'check' counts the grants; 'prove' may say that a second one waits"
)


def _rules() -> Iterator[Fault]:
    for label, (edit, decides, vendors) in RULES_OF_GOVERNANCE.items():
        for subjects in ((TALKER,), (LISTENER, PLANNER), SUBJECTS):
            yield Fault(
                13, f"governance of {len(subjects)}: {label}", "dds", _governed(subjects, edit), decides=decides,
                vendors=vendors, check=True if label != "the same topic rule twice" else None,
                why="" if decides or "same" in label else "only vendors that read all rules decide otherwise",
            )  # fmt: skip
    for label, (edit, decides, vendors) in RULES_OF_PERMISSIONS.items():
        for subject in SUBJECTS:
            behind = label == "a wider grant behind"
            yield Fault(
                13, f"{subject} {label}", "dds", _grant_edit(subject, edit), decides=decides, vendors=vendors,
                prove=None, why=_SECOND if behind else "",
            )  # fmt: skip


# -- one authority ---------------------------------------------------------------------------------------------------


def _adopted() -> Iterator[Fault]:
    """Where one authority certifies and signs, every enclave can sign documents."""
    for subject in ADOPTED:
        for wider in (False, True):
            for permissions in (True, False):
                for label, signer in (
                    ("its own key", _own),
                    ("another enclave", lambda ks, who: _next(ks, who, ADOPTED)),
                    ("a namesake of the authority", lambda _ks, _who: stranger("sros2CA")),
                ):
                    what = f"{'wider ' * wider}{'permissions' if permissions else 'governance'}"
                    apply = _resigned(subject, signer, permissions=permissions, wider=wider)
                    # Vendors of today accept whoever the authority certified; newer ones do not start with it.
                    vendors = "all" if wider or "namesake" in label else "newer vendors"
                    name = f"{subject} {what} by {label}"
                    yield Fault(18, name, "adopted", apply, vendors=vendors, subjects=ADOPTED)
        for label, edit in list(WIDENED.items())[::4]:

            def widened(keystore: Keystore, subject: str = subject, edit: Edit = edit) -> None:
                document = keystore.permissions(subject)
                edit(first_grant(document))
                keystore.sign_permissions(subject, document)

            yield Fault(18, f"{subject} {label}", "adopted", widened, decides=None, subjects=ADOPTED)
        for other in ADOPTED:
            if other != subject:

                def granted(keystore: Keystore, subject: str = subject, other: str = other) -> None:
                    document = keystore.permissions(subject)
                    own = first_grant(document)
                    own.addnext(new_grant(own, f"CN={other}/more", ALL))
                    keystore.sign_permissions(subject, document)

                name = f"{subject} has everything for {other} by containment"
                yield Fault(18, name, "adopted", granted, vendors="cyclonedds", subjects=ADOPTED)


FAULTS = (*_self_signed(), *_others(), *_opened(), *_rules(), *_adopted())
