"""Says why a transport labels an edge differently from the policy: which rule of which document decided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from keymint.api import Enclave, Tier, Transport, Verdict
from keymint.errors import KeymintError, Origin
from keymint.graph import Edge
from keymint.verify.compare import error_of, label_enclave
from keymint.verify.judge import Judge
from keymint.verify.model import Finding

DOCUMENTS = ("permissions.xml", "permissions.p7s")
"""Where an enclave has its rules, in plain and signed."""


class Explainer:
    """Explains labels of transports; a real one is explained by the model of it.

    Args:
        judge: what the policy says.
        models: transports whose verdicts have the line of a rule, by name; ``cyclonedds-0.10`` is a model of
            ``cyclonedds``. The first is asked where a real transport has no model of its own.
    """

    def __init__(self, judge: Judge, models: Mapping[str, Transport]) -> None:
        self._judge = judge
        self._models = models

    def __call__(self, transport: str, enclave: Enclave, wrong: list[tuple[Edge, Verdict]]) -> list[Finding]:
        """Return the findings on edges of one enclave that a transport labels wrongly."""
        modelled = self._modelled(transport, enclave, wrong)
        return [
            Finding(
                error_of(verdict.allowed),
                edge,
                self._judge.decide(edge),
                found,
                document(enclave, found.line),
                model,
            )
            for (edge, verdict), (found, model) in zip(wrong, modelled, strict=True)
        ]

    def model_of(self, transport: str) -> str:
        """Return the name of the model that explains a transport, or nothing."""
        own = [name for name in self._models if name.startswith(f"{transport}-")]
        return next(iter(own or self._models), "")

    def _modelled(
        self, transport: str, enclave: Enclave, wrong: Sequence[tuple[Edge, Verdict]]
    ) -> list[tuple[Verdict, str]]:
        """Return each verdict, with the line and reason of a model where it has none and the model decides alike."""
        plain = [(verdict, "") for _, verdict in wrong]
        name = self.model_of(transport)
        if not name or name == transport or any(verdict.line for _, verdict in wrong):
            return plain
        try:
            models = [v for _, v in label_enclave(self._models[name], enclave, (e for e, _ in wrong), Tier.DECISION)]
        except KeymintError:
            return plain
        return [
            (
                replace(
                    verdict, reason=_both(verdict.reason, model.reason), line=model.line, deviation=model.deviation
                ),
                name,
            )
            if model.allowed == verdict.allowed
            else (verdict, "")
            for (_, verdict), model in zip(wrong, models, strict=True)
        ]


def models(transports: Mapping[str, Transport]) -> dict[str, Transport]:
    """Return the transports that decide only, by the text of the documents, and so can name the rule that decides.

    That of a standard, which names no version of a vendor, comes first.
    """
    found = {name: transport for name, transport in transports.items() if transport.usable().tiers == (Tier.DECISION,)}
    return {name: found[name] for name in sorted(found, key=lambda name: ("-" in name, name))}


def _both(said: str, modelled: str) -> str:
    return "; ".join(dict.fromkeys(filter(None, (said, modelled))))


def document(enclave: Enclave, line: int) -> Origin:
    """Return a place in the document that has an enclave's rules."""
    found = [path for name in DOCUMENTS if (path := enclave.folder / name).is_file()]
    return Origin(str(found[0] if found else enclave.folder / DOCUMENTS[-1]), line)
