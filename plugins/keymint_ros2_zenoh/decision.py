# SPDX-License-Identifier: Apache-2.0
"""The model of Zenoh: what its access control (1.6 and later) decides about a message on a link, and whom it admits.

A link has the properties of the other end. A subject matches it when each property that the subject gives has the
link's value; a property that it does not give matches any. Subjects with equal properties share their rules. Such an
entry denies a message if a deny rule of that flow and message includes the key expression; else it allows it if an
allow rule includes it, or the default allows. The order of rules does not matter. A link on which no subject matches
gets the default; otherwise it is enough that one entry allows.

A rule applies to a key expression that it *includes*: one that only intersects it is untouched, also by a deny.

A router or a session admits the other by its certificate. Measured on the library eclipse-zenoh 1.10.2 with mutual
TLS; ``tests/real/test_zenoh_agreement.py`` compares the two on random configurations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime
from ipaddress import ip_address
from itertools import product
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from keymint.api import Verdict
from keymint.errors import KeymintError
from keymint.pki import certificates, examine, extensions
from keymint_ros2_zenoh.documents.configuration import AccessControl, AclRule, AclSubject, Flow, Message, Permission
from keymint_ros2_zenoh.keyexpr import KeyExpr, includes, parse


class Link(NamedTuple):
    """The properties of a link's other end, in the order of a subject's; an empty one is one that the link has not.

    Attributes:
        common_name: first common name of its certificate.
        username: its user name.
        interface: the network interface.
        protocol: ``tls``, ``quic``, ``tcp``, …
        zid: the identifier of the session, which nothing authenticates.
    """

    common_name: str = ""
    username: str = ""
    interface: str = ""
    protocol: str = ""
    zid: str = ""


_Entry = Sequence[AclRule]
"""The rules of all subjects with the same properties."""
_Applying = Sequence[tuple[AclRule, KeyExpr]]
"""The rules of an entry about a message, once with each of their key expressions."""
_Properties = tuple[str | None, ...]
KeyLists = tuple[tuple[tuple[KeyExpr, ...], tuple[KeyExpr, ...]], ...]
"""For each entry the key expressions that it allows, and those that it denies."""


class AccessModel:
    """Decides about messages by the access control of one configuration.

    Args:
        access_control: of the router or session that decides.
    """

    def __init__(self, access_control: AccessControl) -> None:
        self._control = access_control
        self._depending: Sequence[AclSubject] = ()
        self._entries: dict[_Properties, _Entry] = {}
        self._any_name: list[_Properties] = []
        self._of_name: dict[str, list[_Properties]] = {}
        if not access_control.enabled:
            return
        rules = {rule.id: rule for rule in access_control.rules}
        subjects = {subject.id: subject for subject in access_control.subjects}
        depending = (subject for subject in access_control.subjects if subject.depends_on_more)
        self._depending = sorted(depending, key=lambda subject: not subject.cert_common_names)
        applying: dict[_Properties, dict[str, AclRule]] = {
            properties: {} for subject in access_control.subjects for properties in _properties(subject)
        }
        for policy in access_control.policies:
            own = {name: rules[name] for name in policy.rules}
            for properties in {each for name in policy.subjects for each in _properties(subjects[name])}:
                applying[properties].update(own)
        for properties, own in applying.items():
            self._entries[properties] = tuple(own.values())
            name = properties[0]
            (self._any_name if name is None else self._of_name.setdefault(name, [])).append(properties)

    def on(self, link: Link) -> LinkAccess:
        """Return the decisions on a link."""
        matching = (
            entry
            for entry in self._candidates(link.common_name)
            if all(given is None or given == value for given, value in zip(entry, link, strict=True))
        )
        return LinkAccess(self._control, [self._entries[each] for each in matching])

    def of_certificate(self, common_name: str) -> LinkAccess:
        """Return the decisions on links of which only the certificate is known: any other property may match."""
        depending = (each for each in self._depending if common_name in (each.cert_common_names or (common_name,)))
        more = next((f"the subject {each.id!r} also depends on more than certificates" for each in depending), "")
        return LinkAccess(self._control, [self._entries[each] for each in self._candidates(common_name)], more)

    def _candidates(self, common_name: str) -> Sequence[_Properties]:
        return *self._of_name.get(common_name, ()), *self._any_name


class LinkAccess:
    """Decides about the messages on one link.

    Args:
        control: the access control.
        entries: those that match the link.
        unmodelled: why it is not known which entries match; empty if it is.

    Attributes:
        open: without a matching rule a message is allowed.
        where: the place of the access control.
    """

    def __init__(self, control: AccessControl, entries: Sequence[_Entry], unmodelled: str = "") -> None:
        self._control = control
        self._entries = entries
        self._found: dict[tuple[Message, Flow], Sequence[tuple[_Applying, _Applying]]] = {}
        self.unmodelled = unmodelled
        self.open = not control.enabled or control.default_permission is Permission.ALLOW
        self.where = control.where

    @property
    def watched(self) -> frozenset[Flow]:
        """The flows of which Zenoh looks at each message; it does not look at one that is always allowed."""
        control = self._control
        if not control.enabled:
            return frozenset()
        if control.default_permission is Permission.DENY:
            return frozenset(Flow)
        return frozenset(flow for entry in self._entries for rule in entry if rule.messages for flow in rule.flows)

    def keys(self, message: Message, flow: Flow) -> KeyLists:
        """Return for each entry the key expressions that it allows, and those that it denies."""
        found = tuple(
            (tuple(key for _, key in allowing), tuple(key for _, key in denying))
            for allowing, denying in self._about(message, flow)
        )
        return found or (((), ()),)

    def _about(self, message: Message, flow: Flow) -> Sequence[tuple[_Applying, _Applying]]:
        """Return for each entry its allow rules and its deny rules about a message."""
        if (message, flow) not in self._found:  # a transport asks the same link about many keys
            self._found[message, flow] = [
                (_applying(entry, Permission.ALLOW, message, flow), _applying(entry, Permission.DENY, message, flow))
                for entry in self._entries
            ]
        return self._found[message, flow]

    def decide(self, message: Message, flow: Flow, key_expr: str) -> Verdict:
        """Return the decision on a message, with the place of the rule that decided, or of the access control.

        Args:
            message: the message.
            flow: its flow, as seen from the process whose configuration this is.
            key_expr: its key expression, in canonical form.
        """
        control = self._control
        if not control.enabled:
            return Verdict(allowed=True, reason="access control is off", where=control.where)
        default = control.default_permission is Permission.ALLOW
        if not self._entries:
            reason = f"no subject has the link's certificate; the default is {control.default_permission}"
            return Verdict(default, reason, control.where)
        asked = parse(key_expr)
        denial: Verdict | None = None
        for allowing, denying in self._about(message, flow):
            deny = _including(denying, asked)
            allow = None if deny else _including(allowing, asked)
            if allow:
                return Verdict(True, _reason(allow), allow[0].where)
            if deny is None and default:
                reason = f"no deny rule includes {key_expr}; the default is allow"
                return Verdict(True, reason, control.where)
            if deny and denial is None:
                denial = Verdict(False, _reason(deny), deny[0].where)
        reason = f"no rule for {message} {flow} includes {key_expr}; the default is deny"
        return denial or Verdict(False, reason, control.where)


def _properties(subject: AclSubject) -> Iterable[_Properties]:
    """Yield the combinations of one value of each property; None is a property that the subject does not give."""
    return product(*(values or (None,) for values in subject.properties))


def _applying(entry: _Entry, permission: Permission, message: Message, flow: Flow) -> _Applying:
    own = (rule for rule in entry if rule.permission is permission and message in rule.messages and flow in rule.flows)
    return [(rule, parse(text)) for rule in own for text in rule.key_exprs]


def _including(rules: Iterable[tuple[AclRule, KeyExpr]], asked: KeyExpr) -> tuple[AclRule, KeyExpr] | None:
    return next(((rule, key_expr) for rule, key_expr in rules if includes(key_expr, asked)), None)


def _reason(found: tuple[AclRule, KeyExpr]) -> str:
    rule, key_expr = found
    return f"the {rule.permission} rule {rule.id!r} includes it by {key_expr.text}"


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name that access control compares: the first one, or an empty text."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def first_common_name(pem: bytes) -> str:
    """Return the common name of a certificate in PEM.

    Raises:
        KeymintError: no certificate.
    """
    return common_name(certificates.load(pem))


def refusal(certificate: bytes, authorities: bytes, at: datetime, *, server: bool) -> str:
    """Return why the other side of a link refuses a certificate, or an empty text.

    Args:
        certificate: PEM, with intermediate authorities behind it if there are any.
        authorities: PEM of the certificates that the other side trusts.
        at: the time.
        server: it is the certificate of the listening side.
    """
    try:
        leaf, *above = certificates.load_bundle(certificate)
    except KeymintError as error:
        return error.diagnostics[0].message
    intermediates = b"".join(certificates.to_pem(each) for each in above if each.issuer != each.subject)
    findings = examine.verify_chain(certificates.to_pem(leaf), intermediates + authorities, at)
    if findings:
        return findings[0].message
    key = leaf.public_key()
    if isinstance(key, ec.EllipticCurvePublicKey) and isinstance(key.curve, ec.SECP521R1):
        return "its key is on the curve P-521, which TLS of Zenoh does not verify"
    lacking = lacking_usage(leaf, server=server)
    return lacking and f"its extended key usage lacks {lacking}"


def lacking_usage(certificate: x509.Certificate, *, server: bool) -> str:
    """Return the usage that the listening or the connecting side needs and a certificate lacks, or an empty text."""
    server_auth, client_auth = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    name, wanted = ("serverAuth", server_auth) if server else ("clientAuth", client_auth)
    usages = extensions.value(certificate, x509.ExtendedKeyUsage)
    return "" if usages is None or wanted in usages else name


def names_host(certificate: x509.Certificate, host: str) -> bool:
    """Tell whether a certificate is for a host: only its subject alternative names count, never its common name."""
    names = extensions.value(certificate, x509.SubjectAlternativeName)
    if names is None:
        return False
    try:
        return ip_address(host) in names.get_values_for_type(x509.IPAddress)
    except ValueError:
        listed = {name.lower() for name in names.get_values_for_type(x509.DNSName)}
        domain = host.lower().partition(".")[2]
        # "*" stands for the first label of a name (RFC 6125, 6.4.3), of three at least (rustls).
        return host.lower() in listed or ("." in domain and f"*.{domain}" in listed)
