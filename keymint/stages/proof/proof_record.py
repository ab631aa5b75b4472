# SPDX-License-Identifier: Apache-2.0
"""The record of proofs: the claims about an enclave that were all proven, as the outputs of a stamp."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from functools import lru_cache

from comarmor.errors import Origin
from keymint.api import Claim, DomainRange, Proof, ValidityTerm
from keymint.ir import SubjectRules
from keymint.keymake.kinds import Kind, kind_of
from keymint.view.stamps import Stamp, digest

_RULES, _CLAIMS, _TERMS, _WRITTEN = "rules", "claims", "terms", "written"
"""Keys of the outputs."""


def dump(
    claims: Sequence[Claim], terms: Sequence[ValidityTerm], rules: Iterable[SubjectRules], folder: str
) -> Mapping[str, str]:
    """Return the outputs of a stamp.

    Args:
        claims: the proven claims.
        terms: when the documents are in force.
        rules: the rules of the policy that the claims are about.
        folder: the folder of the documents, as messages show it; recorded places are relative to it.
    """
    rows = [
        (
            term.code,
            term.what,
            term.where.file.removeprefix(f"{folder}/"),
            term.where.line,
            [(_date(first), _date(last)) for first, last in term.periods],
            term.models,
        )
        for term in terms
    ]
    return {_CLAIMS: dump_claims(tuple(claims)), _RULES: _rules_digest(rules), _TERMS: _json(rows)}


_json = json.JSONEncoder(separators=(",", ":")).encode
_date = lru_cache(maxsize=64)(datetime.isoformat)
_moment = lru_cache(maxsize=64)(datetime.fromisoformat)


# The claims about most enclaves are the same.
@lru_cache(maxsize=64)
def dump_claims(claims: tuple[Claim, ...]) -> str:
    """Return proven claims as text."""
    return _json(
        [
            (each.model, each.action, [(of.first, of.last) for of in each.domains], each.universe, each.excepted)
            for each in claims
        ]
    )


def load(stamp: Stamp, folder: str) -> tuple[tuple[Claim, ...], tuple[ValidityTerm, ...]] | None:
    """Return the recorded claims and terms, or None if the stamp has no legible ones."""
    try:
        return load_claims(stamp.outputs.get(_CLAIMS, "")), _load_terms(stamp.outputs.get(_TERMS, ""), folder)
    except (ValueError, TypeError):
        return None


def has_rules(stamp: Stamp, rules: Iterable[SubjectRules]) -> bool:
    """Tell whether a proof was made of the same rules, wherever they are written."""
    return stamp.outputs.get(_RULES) == _rules_digest(rules)


def with_proof_digest(outputs: Mapping[str, str], rules: str) -> Mapping[str, str]:
    """Return the outputs of a stamp with a digest of the rules and of their files, if there is one."""
    return {**outputs, _WRITTEN: rules} if rules else outputs


def has_written(stamp: Stamp, rules: str) -> bool:
    """Tell whether a proof was made of the same rules in the same files; takes their digest."""
    return bool(rules) and stamp.outputs.get(_WRITTEN) == rules


def _rules_digest(rules: Iterable[SubjectRules]) -> str:
    """Return a digest of rules, independent of where they are written."""
    return digest(
        *(
            part
            for of_subject in rules
            for kind, names in [kind_of(of_subject.rules)]
            for part in (_kind_digest(kind), *names)
        )
    )


@lru_cache(maxsize=1 << 12)
def _kind_digest(kind: Kind) -> str:
    return digest(repr(kind))


@lru_cache(maxsize=64)
def load_claims(text: str) -> tuple[Claim, ...]:
    """Return the claims of :func:`dump_claims`.

    Raises:
        ValueError, TypeError: the text was not written by it.
    """
    return tuple(
        Claim(
            str(model),
            str(action),
            tuple(DomainRange(int(first), int(last)) for first, last in domains),
            str(universe),
            Proof.PROVEN,
            excepted=tuple(map(str, excepted)),
        )
        for model, action, domains, universe, excepted in json.loads(text)
    )


def _load_terms(text: str, folder: str) -> tuple[ValidityTerm, ...]:
    return tuple(
        ValidityTerm(
            str(code),
            str(what),
            Origin(f"{folder}/{file}", int(line)),
            tuple((_moment(first), _moment(last)) for first, last in periods),
            tuple(map(str, models)),
        )
        for code, what, file, line, periods, models in json.loads(text)
    )
