# SPDX-License-Identifier: Apache-2.0
"""The member ``access_control`` of a Zenoh configuration, as data (Zenoh 1.6 and later)."""

from __future__ import annotations

from collections.abc import Mapping

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint_ros2_zenoh.messages import Flow, Message, Permission


@dataclass(frozen=True, slots=True)
class AclRule:
    """A rule: it applies to a message if its flow and message are listed and a key expression includes the key.

    Attributes:
        id: its name in the document.
        messages: messages.
        flows: flows; both if the document gives none.
        permission: allow or deny.
        key_exprs: key expressions in canonical form.
        where: its place in the document; None for a rule that was not read.
    """

    id: str
    messages: tuple[Message, ...]
    flows: tuple[Flow, ...]
    permission: Permission
    key_exprs: tuple[str, ...]
    where: Origin | None = None


PROPERTIES: Mapping[str, str] = {
    "cert_common_names": "common_names",
    "usernames": "usernames",
    "interfaces": "interfaces",
    "link_protocols": "protocols",
    "zids": "zids",
}
"""The properties of :class:`AclSubject` by their names in a document."""


@dataclass(frozen=True, slots=True)
class AclSubject:
    """Links that a policy applies to: one of the values of each property that is given; an empty property is any.

    Attributes:
        id: its name in the document.
        common_names: first common names of certificates.
        usernames: user names.
        interfaces: network interfaces.
        protocols: link protocols: ``tls``, ``quic``, ``tcp``, …
        zids: identifiers of sessions, which nothing authenticates.
        where: its place in the document; None for a subject that was not read.
    """

    id: str
    common_names: tuple[str, ...] = ()
    usernames: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    protocols: tuple[str, ...] = ()
    zids: tuple[str, ...] = ()
    where: Origin | None = None

    @property
    def depends_on_more(self) -> bool:
        """Whether it gives other properties than common names."""
        return any((self.usernames, self.interfaces, self.protocols, self.zids))


@dataclass(frozen=True, slots=True)
class AclPolicy:
    """Rules that apply to subjects, both by their names in the document."""

    rules: tuple[str, ...]
    subjects: tuple[str, ...]
    where: Origin | None = None


@dataclass(frozen=True, slots=True)
class AccessControl:
    """The access control of a configuration.

    Attributes:
        enabled: without it everything is allowed.
        default_permission: the decision if no rule applies.
        rules: rules.
        subjects: subjects.
        policies: which rules apply to which subjects.
        where: its place in the document; None if it was not read.
    """

    enabled: bool
    default_permission: Permission
    rules: tuple[AclRule, ...] = ()
    subjects: tuple[AclSubject, ...] = ()
    policies: tuple[AclPolicy, ...] = ()
    where: Origin | None = None
