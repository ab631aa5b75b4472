# SPDX-License-Identifier: Apache-2.0
"""The needs of subjects (permissions on objects in partitions), and the rules that grant them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field

from comarmor.errors import Origin
from comarmor.language.syntax import Attachment, ProfileRule
from comarmor.patterns.expression import escape
from comarmor.rules import PERMISSIONS, Effect
from comarmor.values import dataclass
from keymint.api.generated_names import generalised
from keymint.api.graph import Edge

Need = tuple[str, str, str, tuple[str, ...]]
"""Kind, attachment or name, permission, and partitions; no partitions means the default one."""

NOWHERE = Origin("learned")
"""The origin of learned rules, which are not in a file yet."""
_KINDS = tuple(PERMISSIONS)


@dataclass(frozen=True, slots=True)
class CommonPart:
    """An included file with the needs that several subjects share.

    Attributes:
        name: file name.
        subjects: the subjects that include it.
        needs: the shared needs, as attachments that may contain ``{namespace}`` and ``{name}``.
        covered: for each subject, its own needs (with names) that the file covers.
    """

    name: str
    subjects: tuple[str, ...]
    needs: frozenset[Need]
    covered: Mapping[str, frozenset[Need]] = field(repr=False)


def needs_of(edges: Iterable[Edge]) -> dict[str, set[Need]]:
    """Return the needs of each subject, with names; the partitions of one permission on one object are merged."""
    partitions: dict[str, dict[tuple[str, str, str], set[str]]] = {}
    for edge in edges:
        key = edge.object.kind, edge.object.name, edge.permission
        partitions.setdefault(edge.subject, {}).setdefault(key, set()).update(edge.object.partitions or ("",))
    return {
        subject: {(*key, () if names == {""} else tuple(sorted(names))) for key, names in by_key.items()}
        for subject, by_key in partitions.items()
    }


def fold(needs: Iterable[Need], effect: Effect = Effect.ALLOW) -> tuple[ProfileRule, ...]:
    """Return the fewest rules that grant needs, sorted; each object occurs once for each list of partitions.

    Args:
        needs: needs with attachments and expressions of partitions, not names.
        effect: whether the rules allow them, or deny them.
    """
    permissions: dict[tuple[str, str, tuple[str, ...]], set[str]] = {}
    for kind, attachment, permission, partitions in needs:
        permissions.setdefault((kind, attachment, partitions), set()).add(permission)
    attachments: dict[tuple[str, tuple[str, ...], tuple[str, ...]], set[str]] = {}
    for (kind, attachment, partitions), granted in permissions.items():
        ordered = tuple(permission for permission in PERMISSIONS[kind] if permission in granted)
        attachments.setdefault((kind, ordered, partitions), set()).add(attachment)
    return tuple(
        ProfileRule(
            effect=effect,
            kind=kind,
            permissions=granted_in_order,
            attachments=tuple(Attachment(text, NOWHERE) for text in sorted(texts)),
            partitions=partitions,
            audit=False,
            where=NOWHERE,
        )
        for (kind, granted_in_order, partitions), texts in sorted(attachments.items(), key=_order)
    )


def _order(item: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], set[str]]) -> tuple[object, ...]:
    (kind, permissions, partitions), attachments = item
    known = PERMISSIONS[kind]
    return _KINDS.index(kind), partitions, [known.index(permission) for permission in permissions], sorted(attachments)


def literal(need: Need) -> Need:
    """Return a need with the attachment of its name, see :func:`expression`, and expressions of its partitions."""
    kind, name, permission, partitions = need
    return kind, expression(name, kind), permission, tuple(map(escape, partitions))


def expression(name: str, kind: str) -> str:
    """Return an attachment that matches a name, or its end from a ``/`` on, whatever is made at run time in it."""
    return generalised(escape(name), kind)[0]


def templates(need: Need, subject: str) -> tuple[Need, ...]:
    """Return the attachments of a need that subjects may share: literal, and relative to the subject's name."""
    kind, name, permission, partitions = need
    texts = [expression(name, kind)]
    namespace = subject[: subject.rindex("/") + 1]
    if kind != "topic":
        if name == subject or name.startswith(f"{subject}/"):
            texts.append("{namespace}{name}" + expression(name.removeprefix(subject), kind))
        elif name.startswith(namespace) and namespace != "/":
            texts.append("{namespace}" + expression(name.removeprefix(namespace), kind))
    return tuple((kind, text, permission, tuple(map(escape, partitions))) for text in texts)
