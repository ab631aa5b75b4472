# SPDX-License-Identifier: Apache-2.0
"""The simulation that explains a transport: of its own versions, the latest that is not newer than the software."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pytest

from keymint.api import Availability, Tier, Transport
from keymint.verify.copies import Copies
from keymint.verify.endpoint_policy import EndpointPolicy
from keymint.verify.explain import Explainer

MODELS = ("omg", "cyclonedds-0.10", "fastdds-2.11", "fastdds-2.9", "fastdds-3.3")


@dataclass(frozen=True)
class Software:
    """A real transport of a version."""

    version: str

    def usable(self) -> Availability:
        return Availability(usable=True, version=self.version, tiers=tuple(Tier))


@pytest.mark.parametrize(
    ("transport", "version", "model"),
    [
        ("fastdds", "2.9.1", "fastdds-2.9"),
        ("fastdds", "2.14.6", "fastdds-2.11"),
        ("fastdds-3", "3.3.0", "fastdds-3.3"),
        ("fastdds-3", "3.1.2", "fastdds-2.11"),
        ("fastdds", "2.6.4", "fastdds-2.9"),
        ("cyclonedds", "0.10.2", "cyclonedds-0.10"),
        ("cyclonedds-0.10.5", "0.10.5", "cyclonedds-0.10"),
        ("cyclonedds", "", "cyclonedds-0.10"),
        ("opendds", "3.28", "omg"),
    ],
)
def test_by_version(transport: str, version: str, model: str) -> None:
    transports = {transport: cast("Transport", Software(version))}
    copies = Copies({}, Path("/copies"), Path("/install"))
    explainer = Explainer(
        cast("EndpointPolicy", None), transports, lambda: dict.fromkeys(MODELS, transports[transport]), copies
    )
    assert explainer.model_of(transport) == model
