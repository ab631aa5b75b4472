# SPDX-License-Identifier: Apache-2.0
"""What ``keymint adopt`` says about a keystore: lines for people, and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from comarmor.text import counted
from keymint.api import FoundAuthority, FoundEnclave, FoundKeystore


def summary(keystore: str, found: FoundKeystore, relations: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a report.

    Args:
        keystore: the keystore as the user typed it.
        found: what it has.
        relations: how the signed documents of each subject compare with a policy, in words.
    """
    yield f"{keystore}: {counted(len(found.enclaves), 'enclave')}, {found.form}"
    for authority in found.authorities:
        yield _authority(authority)
    for enclave in found.enclaves:
        yield _enclave(enclave, relations.get(enclave.subject, ""))


def as_json(found: FoundKeystore, comparisons: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the result of the verb as JSON.

    Args:
        found: what the keystore has.
        comparisons: how the signed documents of each subject compare with a policy.
    """
    return {
        "form": found.form,
        "layout": found.layout or None,
        "authorities": [
            {"name": each.name, "roles": each.roles, "file": each.file, **each.facts} for each in found.authorities
        ],
        "enclaves": [
            {"subject": each.subject, **each.facts, "policy": comparisons.get(each.subject)} for each in found.enclaves
        ],
    }


def _authority(authority: FoundAuthority) -> str:
    facts = authority.facts
    roles = " and ".join(authority.roles)
    key = f"key in {facts['key_file']}" if facts["key_file"] else "key elsewhere"
    until = f"until {str(facts['not_after'])[:10]}"
    return f"authority  {authority.name}  {facts['subject_name']}, for {roles}, {facts['key_kind']}, {until}, {key}"


def _enclave(enclave: FoundEnclave, relation: str) -> str:
    facts = enclave.facts
    certificate = facts.get("certificate")
    checks = list(_checks(facts))
    right, wrong = ([name for name, holds in checks if holds is wanted] for wanted in (True, False))
    parts = [
        facts["subject_name"] or "no certificate",
        *([f"until {str(certificate['not_after'])[:10]}"] if certificate else []),
        *([_domains(facts["domains"])] if facts["domains"] else []),
        *([relation] if relation else []),
        *([f"right: {', '.join(right)}"] if right else []),
        *([f"WRONG: {', '.join(wrong)}"] if wrong else []),
    ]
    return f"enclave    {enclave.subject or facts['place']}  {'; '.join(parts)}"


def _checks(facts: Mapping[str, Any]) -> Iterator[tuple[str, bool]]:
    """Yield what was checked of an enclave, each with whether it is right."""
    yield "chain", bool(facts["chain"])
    if facts["key"] != "elsewhere":
        yield "key", facts["key"] == "matches"
    yield "name", bool(facts["named_like_path"])
    yield "signatures", all(facts["signatures"].values())
    if facts["same_text"] is not None:
        yield "text", bool(facts["same_text"])


def _domains(ranges: Sequence[Sequence[int]]) -> str:
    texts = [str(first) if first == last else f"{first} to {last}" for first, last in ranges]
    return f"domain {', '.join(texts)}"
