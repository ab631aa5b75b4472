# SPDX-License-Identifier: Apache-2.0
"""The record of proofs: the claims about an enclave that were all proven, as the outputs of a stamp."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime

from comarmor.errors import Origin
from keymint.api import Claim, DomainRange, Proof, ValidityTerm
from keymint.ir import SubjectRules
from keymint.state import Stamp, digest

_RULES, BUILD_TYPE, _TERMS = "rules", "build type", "terms"
"""Keys of the outputs that are not claims."""


def dump(
    claims: Sequence[Claim], terms: Sequence[ValidityTerm], rules: SubjectRules, build_type: str, folder: str
) -> Mapping[str, str]:
    """Return the outputs of a stamp.

    Args:
        claims: the proven claims.
        terms: when the documents are in force.
        rules: the rules of the policy that the claims are about.
        build_type: name of the build type that proved them.
        folder: the enclave's, as messages show it; recorded places are relative to it.
    """
    rows = [
        (term.code, term.what, term.where.file.removeprefix(f"{folder}/"), term.where.line, term.periods, term.models)
        for term in terms
    ]
    outputs = {_key(claim): "\n".join((claim.universe, *claim.excepted)) for claim in claims}
    outputs[_RULES] = _rules_digest(rules)
    outputs[_TERMS] = json.dumps(rows, separators=(",", ":"), default=datetime.isoformat)
    outputs[BUILD_TYPE] = build_type
    return outputs


def load(stamp: Stamp, folder: str) -> tuple[tuple[Claim, ...], tuple[ValidityTerm, ...]] | None:
    """Return the recorded claims and terms, or None if the stamp has no legible terms."""
    terms = _load_terms(stamp.outputs.get(_TERMS, ""), folder)
    if terms is None:
        return None
    claims: list[Claim] = []
    for key, value in stamp.outputs.items():
        if key not in {_RULES, BUILD_TYPE, _TERMS}:
            universe, *excepted = value.split("\n")
            model, action, ranges = key.rsplit(" ", 2)
            ends = (each.split("-") for each in ranges.split(","))
            domains = tuple(DomainRange(int(first), int(last)) for first, last in ends)
            claims.append(Claim(model, action, domains, universe, Proof.PROVEN, excepted=tuple(excepted)))
    return tuple(claims), terms


def has_rules(stamp: Stamp, rules: SubjectRules) -> bool:
    """Tell whether a proof was made of the same rules, wherever they are written."""
    return stamp.outputs.get(_RULES) == _rules_digest(rules)


def _rules_digest(rules: SubjectRules) -> str:
    """Return a digest of rules, independent of where they are written."""
    return digest(*(repr((r.effect, r.kind, r.permissions, r.expressions, r.partitions)) for r in rules.rules))


def _key(claim: Claim) -> str:
    domains = ",".join(f"{each.first}-{each.last}" for each in claim.domains)
    return f"{claim.model} {claim.action} {domains}"


def _load_terms(text: str, folder: str) -> tuple[ValidityTerm, ...] | None:
    try:
        return tuple(
            ValidityTerm(
                str(code),
                str(what),
                Origin(f"{folder}/{file}", int(line)),
                tuple((datetime.fromisoformat(first), datetime.fromisoformat(last)) for first, last in periods),
                tuple(map(str, models)),
            )
            for code, what, file, line, periods, models in json.loads(text)
        )
    except (ValueError, TypeError):
        return None
