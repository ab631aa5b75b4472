# SPDX-License-Identifier: Apache-2.0
"""Explain mismatches: find the rule of the document that decided."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

from comarmor.errors import Origin
from keymint.api import Enclave, Tier, Transport, Verdict
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint.verify.compare import label_enclave
from keymint.verify.copies import Copies
from keymint.verify.endpoint_policy import EndpointPolicy
from keymint.verify.mismatch import Mismatch
from keymint.verify.usable_transports import names_rules

_VERSION = re.compile(r"-[\d.]+$")


class Explainer:
    """Explains the labels of transports; a real one is explained by its simulation.

    Args:
        policy: the policy on endpoints.
        transports: the transports to explain, by name.
        find_models: returns, on first use, simulated transports by name, whose verdicts have the place of a rule;
            ``name-1.2`` simulates ``name`` from that version on. The first one explains what has no simulation.
        copies: the copies that the transports read; mismatches name the originals.
    """

    def __init__(
        self,
        policy: EndpointPolicy,
        transports: Mapping[str, Transport],
        find_models: Callable[[], Mapping[str, Transport]],
        copies: Copies,
    ) -> None:
        self._policy = policy
        self._copies = copies
        usable = {name: each.usable() for name, each in transports.items()}
        self._explains_itself = frozenset(name for name, each in usable.items() if names_rules(each))
        self._versions = {name: each.version for name, each in usable.items()}
        self._models = cache(find_models)

    def __call__(self, transport: str, enclave: Enclave, wrong: list[tuple[Edge, Verdict]]) -> list[Mismatch]:
        """Return the mismatches of one enclave with their reasons."""
        found: list[Mismatch] = []
        for (edge, verdict), (decided, model) in zip(wrong, self._modelled(transport, enclave, wrong), strict=True):
            modelled = self._copies.original(decided)
            own = replace(self._copies.original(verdict), where=modelled.where, deviation=modelled.deviation)
            document = modelled.where or Origin(self._copies.back(str(enclave.folder)))
            found.append(Mismatch(edge, self._policy.decide(edge), own, modelled.reason, document, model))
        return found

    def model_of(self, transport: str) -> str:
        """Return the name of the simulation that explains a transport, or an empty text.

        Of those of its software, that is the latest one that is not newer than the transport, else the oldest.
        """
        software = _VERSION.sub("", transport)
        own = [name for name in self._models() if _VERSION.sub("", name) == software != name]
        known = [name for name in own if _number(name) <= _number(self._versions.get(transport, ""))]
        oldest = min(own, key=_number, default=next(iter(self._models()), ""))
        return max(known, key=_number, default=oldest)

    def _modelled(
        self, transport: str, enclave: Enclave, wrong: Sequence[tuple[Edge, Verdict]]
    ) -> list[tuple[Verdict, str]]:
        """Return the verdicts of the simulation where it decides the same, else the transport's own."""
        plain = [(verdict, "") for _, verdict in wrong]
        name = "" if transport in self._explains_itself else self.model_of(transport)
        if not name:
            return plain
        try:
            edges = [edge for edge, _ in wrong]
            models = [verdict for _, verdict in label_enclave(self._models()[name], enclave, edges, Tier.DECISION)]
        except KeymintError:
            return plain
        return [
            (model, name) if _alike(model, verdict) else (verdict, "")
            for (_, verdict), model in zip(wrong, models, strict=True)
        ]


def _number(text: str) -> tuple[int, ...]:
    """Return the version at the end of a name, or that a text is, to compare it with others."""
    return tuple(map(int, re.findall(r"\d+", text.rpartition("-")[2])))


def _alike(one: Verdict, other: Verdict) -> bool:
    """Tell whether two verdicts decide the same; a partial one counts as the opposite of what the policy says."""
    return one.partial == other.partial and (one.partial or one.allowed == other.allowed)
