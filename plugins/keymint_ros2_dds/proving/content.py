"""From the bytes of a permissions document to claims, each once in a run: what is built is installed soon after."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from keymint.api import Claim, DomainRange, Proof
from keymint.ir import SubjectRules
from keymint_ros2_dds import decision
from keymint_ros2_dds.compiling.lower import Lowered, lower
from keymint_ros2_dds.proving.claims import ASSUMPTIONS, Question, prove_document

MOST = 10_000
"""Documents whose claims are remembered."""

_proven: dict[bytes, tuple[Claim, ...]] = {}


@dataclass(frozen=True, slots=True)
class Content:
    """A permissions document, and what it is held against.

    Attributes:
        content: the document, unsigned.
        file: its name as the user would type it.
        offset: lines of the file before the document's first one.
        subject_name: the identity's, in the order of RFC 2253, e.g. ``CN=/talker,OU=0f``.
        rules: what the policy says of the subject.
        distro: ROS 2 distribution whose name mapping applies.
        domains: the domains in which the policy holds.
        states: how many states a comparison may visit.
        go_on: asked again and again; a comparison is given up when it returns False.
    """

    content: bytes
    file: str
    offset: int
    subject_name: str
    rules: SubjectRules
    distro: str
    domains: tuple[DomainRange, ...]
    states: int
    go_on: Callable[[], bool]


def prove_content(
    asked: Content, *, models: Sequence[str] | None = None, lowered: Lowered | None = None
) -> tuple[Claim, ...]:
    """Return the claims about a document, by model, action and domains.

    Args:
        asked: what is asked.
        models: names of the models, of :data:`ASSUMPTIONS`; None: all.
        lowered: the rules on the level of DDS, where they are known.

    Raises:
        KeymintError: the document cannot be read, or a rule cannot be mapped.
    """
    names = tuple(ASSUMPTIONS if models is None else models)
    key = _key(asked, names)
    known = _proven.get(key)
    if known is not None:
        return known
    question = Question(
        decision.read(asked.content, asked.file, asked.offset),
        asked.subject_name,
        asked.rules,
        lower(asked.rules, asked.distro) if lowered is None else lowered,
        asked.distro,
        asked.domains,
        asked.states,
        asked.go_on,
    )
    claims = prove_document(question, models=names)
    # What is proven is so wherever the document lies; of what is not, the places are said.
    if len(_proven) < MOST and all(claim.proof is Proof.PROVEN for claim in claims):
        _proven[key] = claims
    return claims


def _key(asked: Content, models: tuple[str, ...]) -> bytes:
    """Return a digest of all that proven claims depend on."""
    rules = tuple((r.effect, r.kind, r.permissions, r.expressions, r.partitions) for r in asked.rules.rules)
    said = repr((asked.subject_name, asked.rules.subject, rules, asked.distro, asked.domains, models))
    return hashlib.sha256(hashlib.sha256(asked.content).digest() + said.encode()).digest()
