# SPDX-License-Identifier: Apache-2.0
"""What each code of an error or a finding means: ``keymint explain``, SARIF and the documentation show it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources


def explanations() -> Mapping[str, Mapping[str, str]]:
    """Return the texts about each code: cause, effect and remedy."""
    return tomllib.loads(resources.files(__package__).joinpath("explanations.toml").read_text(encoding="utf-8"))
