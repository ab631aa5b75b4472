# SPDX-License-Identifier: Apache-2.0
"""The names of the plugin interface, of which some load at first use."""

from __future__ import annotations

from keymint import api
from keymint.api import transports


def test_what_loads_at_first_use_is_there() -> None:
    assert {"Relation", "Tier", "KeystoreReader", "standard_claims"} <= {*dir(api)}
    assert api.Tier is transports.Tier


def test_there_are_no_other_names() -> None:
    assert not hasattr(api, "nothing")
    assert not hasattr(api, "Nothing")
