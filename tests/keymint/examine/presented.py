# SPDX-License-Identifier: Apache-2.0
"""Workspaces of these tests as their owner's adversary sees them: with the keys, and what the verbs then say."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lxml import etree

from tests.conftest import NOW, Outcome
from tests.signers import by_sros2

from .fault_keystores import LISTENER, TALKER, Keystore, first_grant, new_grant, rules_of, written

EVERYTHING = """<allow_rule><domains><id>0</id></domains>
  <publish><topics><topic>*</topic></topics></publish><subscribe><topics><topic>*</topic></topics></subscribe>
</allow_rule>"""
"""A rule that allows all in domain 0."""


def keystore(ws: Path) -> Keystore:
    """Return what somebody with the keys of a workspace can do with it."""
    return Keystore(ws, datetime.fromtimestamp(NOW, UTC), lambda *_: 1)


def for_listener(store: Keystore) -> etree._Element:
    """Return talker's permissions with a second grant: listener may use everything."""
    document = store.permissions(TALKER)
    grant = first_grant(document)
    grant.addnext(new_grant(grant, store.name(LISTENER), EVERYTHING))
    return document


def wider(store: Keystore, subject: str = TALKER) -> etree._Element:
    """Return the permissions of a subject, which may use everything."""
    document = store.permissions(subject)
    rules_of(first_grant(document))[0].addprevious(etree.fromstring(EVERYTHING))
    return document


def signed(store: Keystore, document: etree._Element, subject: str = TALKER) -> bytes:
    """Return a document as the authority of a subject signs it."""
    signer = store.issuer("permissions_ca", subject)
    return by_sros2(written(document), signer.certificate, signer.key)


def findings(keymint: Callable[..., Outcome], ws: Path, verb: str, *words: str) -> list[dict[str, Any]]:
    """Return the errors and warnings of a verb, which ends with 3 exactly if there are any."""
    outcome = keymint(verb, *words, "--json", cwd=ws)
    found = [each for each in outcome.document["diagnostics"] if each["severity"] != "note"]
    assert outcome.code == (3 if found else 0), (outcome.code, found)
    return found


def codes(keymint: Callable[..., Outcome], ws: Path, verb: str, *words: str) -> set[str]:
    """Return the codes of the errors and warnings of a verb."""
    return {each["code"] for each in findings(keymint, ws, verb, *words)}


def notes(outcome: Outcome, code: str) -> list[dict[str, Any]]:
    """Return the notes of a code among the diagnostics of a run."""
    return [each for each in outcome.document["diagnostics"] if (each["severity"], each["code"]) == ("note", code)]
