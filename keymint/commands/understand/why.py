# SPDX-License-Identifier: Apache-2.0
"""``keymint why``: explain one decision, from policy to transport."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import click

from comarmor.values import replace
from keymint.api import DomainRange, Endpoint, Tier
from keymint.command_line.options import implementation_option, kind_option, raw_topic_doubt
from keymint.command_line.verb import Report, Run, argument, findings_if, option, verb
from keymint.errors import Diagnostic
from keymint.names import name_of
from keymint.output.json import Typed, decision_json, edge_json, place_json, verdict_json
from keymint.output.mismatches import document_reason, enumeration, mismatch_finding, request_text, rule_text, verb_of
from keymint.output.report import members
from keymint.stages.trust_anchors import differences
from keymint.verify.transports import choose
from keymint.verify.why import Explanation, MatchedRule, explain, request, source_package
from keymint.workspace.policy_loading import load_policy


@verb(former={"chosen": "-t --transport"})
def why(
    run: Run,
    subject: str = argument(),
    permission: str = argument(),
    object_name: str = argument(metavar="OBJECT"),
    kind: str | None = kind_option,
    partitions: tuple[str, ...] = option("--partition", multiple=True, metavar="NAME"),
    domain: int | None = option(type=click.IntRange(0, 232), metavar="N"),
    chosen: tuple[str, ...] = implementation_option,
) -> Report:
    """Explain why SUBJECT has, or lacks, PERMISSION on OBJECT: policy, package, transport names, document, transports.

    \b
    keymint why /talker publish /chatter
    keymint why /robot1/nav call /map/get
    keymint why /bridge publish telemetry --kind topic --partition ops

    Exit code 3: a transport disagrees with the policy, or the enclave does not trust the workspace's authorities.

    Options:
        partitions: Partition; may be repeated.
        domain: Domain id [the first one of the grant].
    """
    session = run.session()
    package = source_package(session, subject)
    granted = package.grant.domains if package else ()
    if domain is None:
        domain = granted[0].first if granted else 0
    edge = request(subject, permission, object_name, kind or "", partitions, domain)
    build_types = package.build_types if package else session.profile.build_types
    transports = choose(run.plugins, chosen, Tier.DECISION, build_types, session.profile.distro)
    explanation = explain(session, load_policy(session), package, edge, transports)

    run.console.lines(_lines(explanation, run))
    asked = (name_of(explanation.edge.subject),) if explanation.installed and explanation.packaged else ()
    diagnostics = [*differences(session, asked), *_mismatches(explanation, granted)]
    result = _document(explanation, run.typed)
    allowed, wanted = explanation.policy.allowed, explanation.edge.object
    doubts = () if allowed else raw_topic_doubt(wanted.kind, wanted.name, typed=kind is not None)
    return run.report(result, (*diagnostics, *doubts), findings_if(diagnostics), workspace=session.workspace)


def _mismatches(explanation: Explanation, granted: Sequence[DomainRange]) -> list[Diagnostic]:
    """Return the mismatches between policy and transports, one for all transports with the same reason."""
    together: dict[tuple[str, int], list[str]] = {}
    for name, label in explanation.wrong.items():
        together.setdefault((document_reason(label), label.document.line), []).append(name)
    found = [mismatch_finding(names, [explanation.wrong[names[0]]]) for names in together.values()]
    edge = explanation.edge
    if not granted or any(each.first <= edge.domain <= each.last for each in granted):
        return found
    # No build fixes a request in a domain that is not granted.
    domains = enumeration(
        [f"{each.first}" if each.first == each.last else f"{each.first}-{each.last}" for each in granted]
    )
    help_ = f"{edge.subject} is granted domain {domains}, not {edge.domain}: leave out --domain"
    return [replace(each, help=help_) for each in found]


def _lines(explanation: Explanation, run: Run) -> Iterator[str]:
    """Yield the explanation in words, layer by layer."""

    def rule(each: MatchedRule) -> str:
        decides = "decides: " if each.where == explanation.policy.where else ""
        return f"{decides}{rule_text(each.rule)} ({run.place(each.where)})"

    applied = [
        f"{each.name!r} applies ({run.place(each.where)}){' AUDIT' if each.audit else ''}"
        for each in explanation.profiles
    ]
    none = f"none applies to {explanation.edge.subject}, so it has no permission"
    layers: dict[str, list[str]] = {"profiles": applied or [none]}
    if explanation.similar:
        layers["profiles"].append(f"did you mean {explanation.similar!r}?")
    layers["policy"] = [rule(each) for each in explanation.rules] or [str(explanation.policy.reason)]
    if len({each.allowed for each in explanation.decisions.values()}) > 1:
        layers["policy"] += (
            f"for {name}, it {verb_of(each.allowed)} it: {each.reason}" for name, each in explanation.decisions.items()
        )
    if explanation.near:
        layers["policy"].append(f"nearest: {rule(explanation.near)}, but {explanation.near.note}")
    layers["package"] = [rule(each) for each in explanation.package] or ["no rule applies"]
    if not explanation.packaged:
        layers["package"] = ["missing ('keymint create' creates it)"]
    layers["needs"] = [_need(*each) for each in explanation.needs]
    layers["enclave"] = list(_labels(explanation, run.typed))
    in_domain = f" in domain {explanation.edge.domain}" if explanation.edge.domain else ""
    yield f"{request_text(explanation.edge)}{in_domain}: the policy {verb_of(explanation.policy.allowed)} it"
    for title, lines in layers.items():
        for index, line in enumerate(lines):
            yield f"{title if index == 0 else '':<10}{line}"


def _need(endpoint: Endpoint, noun: str) -> str:
    partitions = "".join(f" in partition {name!r}" for name in endpoint.partitions)
    return f"{endpoint.action} on the {noun} {endpoint.name!r}{partitions}"


def _labels(explanation: Explanation, typed: Typed) -> Iterator[str]:
    """Yield the decisions of transports, one line for all with the same reason."""
    if not explanation.installed:
        yield "not installed ('keymint status' shows whether it waits for 'keymint install', or was revoked)"
    together: dict[tuple[str, str], list[str]] = {}
    for name, label in explanation.labels.items():
        verdict = label.verdict
        decision = "allowed in part" if verdict.partial else "allowed" if verdict.allowed else "denied"
        together.setdefault((decision, document_reason(label, typed)), []).append(name)
    for (decision, reason), names in together.items():
        yield f"{decision} by {enumeration(names)} ({reason})"
    for build_type, unasked in explanation.unasked.items():
        wanted = explanation.edge.object
        yield f"not asked: {enumeration(unasked)} ({build_type} has no name for the {wanted.kind} {wanted.name!r})"


def _document(explanation: Explanation, typed: Typed) -> dict[str, Any]:
    """Return the explanation for JSON."""

    def rule(each: MatchedRule) -> dict[str, Any]:
        return {
            **members(each.rule, "effect", "kind", "permissions", "expressions", "partitions", "audit"),
            "rule": place_json(each.where, typed),
            "note": each.note or None,
        }

    return {
        "edge": edge_json(explanation.edge),
        "profiles": [
            {"name": each.name, "audit": each.audit, "rule": place_json(each.where, typed)}
            for each in explanation.profiles
        ],
        "policy": decision_json(explanation.policy, typed),
        "rules": [rule(each) for each in explanation.rules],
        "nearest": rule(explanation.near) if explanation.near else None,
        "similar_subject": explanation.similar or None,
        "package": [rule(each) for each in explanation.package] if explanation.packaged else None,
        "endpoints": [members(each, "action", "name", "partitions") for each, _ in explanation.needs],
        "installed": explanation.installed,
        "transports": [{"name": name, **verdict_json(label, typed)} for name, label in explanation.labels.items()],
    }
