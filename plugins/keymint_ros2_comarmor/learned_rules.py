"""What subjects need, folded into rules: over permissions, over attachments, over partitions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from comarmor.errors import Origin
from comarmor.language.syntax import Attachment, ProfileRule
from comarmor.patterns.printing import escape
from comarmor.rules import PERMISSIONS, Effect
from keymint.graph import Edge

Needs = dict[tuple[str, str], dict[str, set[str]]]
"""By kind and name of an object: by permission the partitions, of which the default one is empty."""
Need = tuple[str, str, str, tuple[str, ...]]
"""Kind, attachment, permission, and partitions: nothing for the default one."""

NOWHERE = Origin("learned")
"""Rules that are learned are written nowhere yet."""
_KINDS = tuple(PERMISSIONS)


def grant_of(edge: Edge) -> tuple[str, str, str, tuple[str, ...]]:
    """Return kind, name, permission and partitions that an edge is about; the default partition is the empty one."""
    return edge.object.kind, edge.object.name, edge.permission, edge.object.partitions or ("",)


def flat(needs: Needs) -> Iterable[Need]:
    """Yield the needs of a subject one by one, names not yet turned into attachments."""
    for (kind, name), permissions in needs.items():
        for permission, partitions in permissions.items():
            yield kind, name, permission, () if partitions == {""} else tuple(sorted(partitions))


def fold(needs: Iterable[Need]) -> tuple[ProfileRule, ...]:
    """Return the fewest rules in which every object stands once for each of its lists of partitions, in their order.

    Args:
        needs: with attachments, not names.
    """
    permissions: dict[tuple[str, str, tuple[str, ...]], set[str]] = {}
    for kind, attachment, permission, partitions in needs:
        permissions.setdefault((kind, attachment, partitions), set()).add(permission)
    attachments: dict[tuple[str, tuple[str, ...], tuple[str, ...]], set[str]] = {}
    for (kind, attachment, partitions), held in permissions.items():
        ordered = tuple(permission for permission in PERMISSIONS[kind] if permission in held)
        attachments.setdefault((kind, ordered, partitions), set()).add(attachment)
    return tuple(_rule(*key, sorted(found)) for key, found in sorted(attachments.items(), key=_order))


def _order(item: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], set[str]]) -> tuple[object, ...]:
    (kind, permissions, partitions), attachments = item
    known = PERMISSIONS[kind]
    return _KINDS.index(kind), partitions, [known.index(one) for one in permissions], sorted(attachments)


def _rule(kind: str, permissions: tuple[str, ...], partitions: tuple[str, ...], attachments: list[str]) -> ProfileRule:
    return ProfileRule(
        effect=Effect.ALLOW,
        kind=kind,
        permissions=permissions,
        attachments=tuple(Attachment(text, NOWHERE) for text in attachments),
        partitions=tuple(map(escape, partitions)),
        audit=False,
        where=NOWHERE,
    )


def literal(need: Need) -> Need:
    """Return a need whose name is an attachment that matches nothing else."""
    kind, name, permission, partitions = need
    return kind, escape(name), permission, partitions


def templates(need: Need, subject: str) -> tuple[Need, ...]:
    """Return a need in all ways that can be common to subjects: as it is, and relative to the subject's own name."""
    kind, name, permission, partitions = need
    found = [escape(name)]
    namespace = subject[: subject.rindex("/") + 1]
    if kind != "topic":
        if name == subject or name.startswith(f"{subject}/"):
            found.append("{namespace}{name}" + escape(name.removeprefix(subject)))
        elif name.startswith(namespace) and namespace != "/":
            found.append("{namespace}" + escape(name.removeprefix(namespace)))
    return tuple((kind, text, permission, partitions) for text in found)


def literal_needs(needs: Mapping[str, Needs]) -> dict[str, set[Need]]:
    """Return what each subject needs, one by one, with names."""
    return {subject: set(flat(found)) for subject, found in needs.items()}
