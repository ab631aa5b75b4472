# SPDX-License-Identifier: Apache-2.0
"""The record of key pairs, which distinguishes a private key that was replaced from one that Keymint minted.

The record has fingerprints of public keys only. If it is lost, the installed enclaves serve in its place.
"""

from __future__ import annotations

from collections.abc import Mapping

from keymint.state import Stamp, State

AUTHORITIES = "authority-keys"
IDENTITIES = "identity-keys"


def recorded(state: State, stage: str, name: str) -> str:
    """Return the fingerprint of the key that the record has for an authority or a package, or an empty text."""
    stamp = state.stamp(stage, name)
    return stamp.inputs if stamp else ""


def record(state: State, stage: str, fingerprints: Mapping[str, str]) -> State:
    """Return the state with these keys on record; unchanged if they already are."""
    new = {name: value for name, value in fingerprints.items() if recorded(state, stage, name) != value}
    return state.updated(stage, {name: Stamp(value, {}) for name, value in new.items()}) if new else state


def forget(state: State, stage: str, names: tuple[str, ...]) -> State:
    """Return the state without the keys of these authorities or packages."""
    return state.updated(stage, {}, names) if any(recorded(state, stage, name) for name in names) else state


def new_fingerprints(before: State, after: State) -> frozenset[str]:
    """Return the fingerprints of the keys that a plan puts on record."""
    return _all(after) - _all(before)


def _all(state: State) -> frozenset[str]:
    stamps = (state.stamps.get(stage, {}) for stage in (AUTHORITIES, IDENTITIES))
    return frozenset(stamp.inputs for each in stamps for stamp in each.values())


def was_under_way(state: State, fingerprint: str) -> bool:
    """Tell whether a killed run was about to store the key with this fingerprint."""
    return fingerprint in state.interrupted
