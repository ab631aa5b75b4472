# SPDX-License-Identifier: Apache-2.0
"""Compare what every holder of a certificate may present with the policy.

A participant chooses the permissions that it presents, and each implementation chooses the grant in them by its own
comparison of names. So no document that is signed may have a grant by which another holder is permitted too much.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import lru_cache

from comarmor.values import replace
from keymint.api import Claim, ComparisonTask, ExcessRights, Holder, PresentableDocument, PresentationTask, Proof
from keymint.errors import KeymintError
from keymint.pki import distinguished_names
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.decision.semantics import STANDARD, VARIATIONS, Semantics, shipped_models
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.proving.claims import prove_document
from keymint_ros2_dds.proving.questions import ProofQuestion
from keymint_ros2_dds.reading.signed_permissions import DocumentGrant, PermissionsDocument, is_plain, read
from keymint_ros2_dds.subject_names import is_odd, required_tokens, tokens

_SEMANTICS = {name: each.semantics for name, each in VARIATIONS.items()}
_CHOOSING = tuple(dict.fromkeys(_SEMANTICS.values()))
"""All that choose a grant: a fleet may mix distributions, so every known comparison of names is asked."""
_DATES = re.compile(rb"(<not_(?:before|after)>)[^<]*<")


def presented_until(content: bytes) -> datetime | None:
    """See :meth:`keymint.api.Presentation.presented_until`; the latest end that an implementation reads."""
    try:
        document = read(content)
    except KeymintError:
        return None
    return _until(document.grants)


def _until(grants: Iterable[DocumentGrant]) -> datetime | None:
    periods = (semantics.period(grant) for grant in grants for semantics in _CHOOSING)
    return max((period[1] for period in periods if period), default=None)


def choosers() -> tuple[str, ...]:
    """See :meth:`keymint.api.Presentation.choosers`."""
    return tuple(VARIATIONS)


def trusting_any_signer() -> tuple[str, ...]:
    """See :meth:`keymint.api.Presentation.trusting_any_signer`; measured (docs/vendors.md)."""
    return tuple(name for name, each in VARIATIONS.items() if each.any_signer)


_Identity = tuple[Holder, str]
"""A holder, and its name in the order in which grants have it."""


class _Identities:
    """Finds the identities whose name a grant may match: by the rarest word of each, so that the cost is linear."""

    def __init__(self, holders: Iterable[Holder]) -> None:
        names = ((each, distinguished_names.parse(each.name)) for each in holders)
        own = [((each, subject_names.of_any(name)), name) for each, name in names]
        words = [required_tokens(written) for (_, written), _ in own]
        frequent = Counter(word for of_name in words for word in of_name)
        self._by_word: dict[str, list[_Identity]] = {}
        self._odd: list[_Identity] = []
        self._all = [each for each, _ in own]
        for (each, name), of_name in zip(own, words, strict=True):
            kinds = [attribute.oid for attribute in name]
            if len(set(kinds)) < len(kinds) or not of_name:
                self._odd.append(each)
            else:
                rarest = min(of_name, key=lambda word: (frequent[word], word))
                self._by_word.setdefault(rarest, []).append(each)

    def of(self, names: Iterable[str]) -> list[_Identity]:
        """Return the identities that one of some names of grants may match."""
        names = list(names)
        if any(map(is_odd, names)):
            return self._all
        words = {word for name in names for word in tokens(name)}
        found = [each for word in sorted(words & self._by_word.keys()) for each in self._by_word[word]]
        return [*found, *self._odd]


def excess(task: PresentationTask) -> tuple[ExcessRights, ...]:
    """See :meth:`keymint.api.Presentation.excess`."""
    identities = _Identities(task.holders)
    unique = {each.content: each for each in reversed(task.documents)}
    proven = {_timeless(each.content): each.proven_for for each in unique.values() if each.proven_for}
    found: list[ExcessRights] = []
    for each in reversed(unique.values()):
        known = each.proven_for or proven.get(_timeless(each.content), "")
        found += _of_document(task, each, known, identities)
    return tuple(found)


def _timeless(content: bytes) -> bytes:
    """Return a document without its dates, which are all that a renewal changes."""
    return _DATES.sub(rb"\1<", content) if is_plain(content) else content


def _of_document(
    task: PresentationTask, given: PresentableDocument, known: str, identities: _Identities
) -> Iterator[ExcessRights]:
    if b"<permissions" not in given.content:
        return
    place = given.where.file, given.lines_before
    try:
        document = read(given.content, *place)
    except KeymintError as error:
        if not given.proven_for:  # a document of an enclave that cannot be read is reported with it
            reason = str(error.diagnostics[0])
            claims = tuple(Claim(name, "use", (), "", Proof.UNKNOWN, reason) for name in VARIATIONS)
            yield from (ExcessRights(each, given, claims, each.until) for each in task.holders[:1])
        return
    # The names of the grants, as each implementation reads them.
    readings = {each.reads_text(grant.subject_name) for each in _CHOOSING for grant in document.grants}
    reading = [each for each in _CHOOSING if not each.refusal(document)]
    for holder, name in identities.of(readings):
        by_reading = {id(each): each.grants(document, name) for each in reading}
        chosen = {model: by_reading.get(id(each), ()) for model, each in _SEMANTICS.items()}
        ends = _until(grant for grants in by_reading.values() for grant in grants)
        if ends is None or ends < task.now:
            continue
        models = [model for model, grants in chosen.items() if grants]
        if holder.name == known:  # other claims are proven with the enclave itself
            proven = shipped_models(task.distro or holder.distro)
            others = (each for each in chosen if each not in proven)
            models = [each for each in others if not any(_alike(chosen, each, model) for model in proven)]
        held = ComparisonTask(
            given.content, *place, name, holder.rules, holder.distro, holder.domains, task.states, task.go_on
        )
        since = None if holder.name == known else task.now
        if claims := tuple(_failed_claims(document, held, models, since)):
            yield ExcessRights(holder, given, claims, min(ends, holder.until))


def _alike(chosen: Mapping[str, Sequence[DocumentGrant]], name: str, other: str) -> bool:
    """Tell whether two models choose the same grants, and permit the same by them, as far as their semantics tell.

    Without a denial no topic check decides: what publishes or subscribes may also create its topic.
    """
    grants = chosen[name]
    if [*map(id, grants)] != [*map(id, chosen[other])]:
        return False
    allow_only = all(rule.allows for grant in grants for rule in grant.rules)
    return _rights(name, without_check=allow_only) == _rights(other, without_check=allow_only)


@lru_cache(maxsize=64)
def _rights(name: str, *, without_check: bool) -> Semantics:
    """Return the semantics of a model without what chooses a grant, and perhaps without the topic check."""
    semantics = _SEMANTICS[name]
    check = "" if without_check else semantics.topic_check
    return replace(semantics, selects=STANDARD.selects, topic_check=check)


def _failed_claims(
    document: PermissionsDocument, held: ComparisonTask, models: Sequence[str], since: datetime | None
) -> Iterator[Claim]:
    """Yield the claims that fail: a holder's own document must permit its rights, all others at most these."""
    if not models:
        return
    try:
        question = ProofQuestion(document, held, lower(held.rules, held.distro), None, since)
    except KeymintError as error:
        reason = str(error.diagnostics[0])
        yield from (Claim(name, "use", (), "", Proof.UNKNOWN, reason) for name in models)
        return
    if not document.defects:
        dds_xml.know_valid(held.document, "permissions")
    yield from (each for each in prove_document(question, models=models) if each.proof is not Proof.PROVEN)
