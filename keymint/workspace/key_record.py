# SPDX-License-Identifier: Apache-2.0
"""The record of key pairs, which distinguishes a private key that was replaced from one that Keymint minted.

The record has fingerprints of public keys only. If it is lost, the installed enclaves serve in its place.
"""

from __future__ import annotations

from collections.abc import Mapping

from keymint.view.stamps import Stamp, State

AUTHORITIES = "authority-keys"
IDENTITIES = "identity-keys"


def recorded_key(state: State, stage: str, name: str) -> str:
    """Return the fingerprint of the key that the record has for an authority or a package, or an empty text."""
    stamp = state.stamp(stage, name)
    return stamp.inputs if stamp else ""


def record(state: State, stage: str, fingerprints: Mapping[str, str]) -> State:
    """Return the state with these keys on record; unchanged if they already are."""
    new = {name: value for name, value in fingerprints.items() if recorded_key(state, stage, name) != value}
    return state.updated(stage, {name: Stamp(value, {}) for name, value in new.items()}) if new else state


def forget(state: State, stage: str, names: tuple[str, ...]) -> State:
    """Return the state without the keys of these authorities or packages."""
    return state.updated(stage, {}, names) if any(recorded_key(state, stage, name) for name in names) else state
