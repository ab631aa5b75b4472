# SPDX-License-Identifier: Apache-2.0
"""The transports that a verification tests, and those that name the rule that decides."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from keymint.api import Availability, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Edge
from keymint.errors import ExitCode, KeymintError
from keymint.verify.copies import Copies
from keymint.verify.endpoint_policy import EndpointPolicy
from keymint.verify.transports import Explainer, choose, models

BOTH = (Tier.DECISION, Tier.EXCHANGE)


@dataclass(frozen=True)
class Transport:
    """A transport that reports this availability."""

    availability: Availability

    def usable(self) -> Availability:
        return self.availability

    def label(
        self, enclaves: Sequence[InstalledEnclave], edges: Iterable[Edge], tier: Tier
    ) -> Iterator[tuple[Edge, Verdict]]:
        raise NotImplementedError


def plugins(**transports: Availability) -> Any:
    """Return installed plugins with these transports; ``_`` in a name is ``-``, and those with ``other`` are of another
    build type."""
    known: Mapping[str, Transport] = {
        name.replace("_", "-"): Transport(availability) for name, availability in transports.items()
    }

    def read_by(name: str) -> str:
        return "another" if "other" in name else "one"

    def transports_of(build_type: str, distro: str = "") -> list[str]:
        return [name for name in sorted(known) if read_by(name) == build_type and (name, distro) != ("vendor-2", "old")]

    return SimpleNamespace(
        read_by=read_by,
        transports_of=transports_of,
        transport=known.__getitem__,
    )


INSTALLED = plugins(
    real=Availability(True, tiers=BOTH),
    omg=Availability(True, tiers=(Tier.DECISION,)),
    vendor_2=Availability(True, tiers=(Tier.DECISION,)),
    vendor_1=Availability(True, tiers=(Tier.DECISION,), by_default=False),
    other=Availability(True, tiers=BOTH),
    other_1=Availability(True, tiers=(Tier.DECISION,)),
    missing=Availability(False, reason="no vendor library", help="apt-get install it", tiers=BOTH),
)


@pytest.mark.parametrize(("tier", "names"), [(Tier.DECISION, {"real", "omg", "vendor-2"}), (Tier.EXCHANGE, {"real"})])
def test_without_a_choice_all_usable_ones_are_tested(tier: Tier, names: set[str]) -> None:
    assert {name: set(group) for name, group in choose(INSTALLED, (), tier, ["one"]).items()} == {"one": names}


def test_transports_are_grouped_by_the_build_types_of_the_packages() -> None:
    found = choose(INSTALLED, (), Tier.DECISION, ["another", "one"])
    assert [(name, list(group)) for name, group in found.items()] == [
        ("another", ["other", "other-1"]),
        ("one", ["omg", "real", "vendor-2"]),
    ]
    assert list(choose(INSTALLED, ("other",), Tier.DECISION, ["another", "one"])) == ["another"]


def test_a_choice_may_name_one_that_is_not_tested_by_default_and_repeat_itself() -> None:
    found = choose(INSTALLED, ("vendor-1", "omg", "vendor-1"), Tier.DECISION, ["one"])
    assert list(found["one"]) == ["vendor-1", "omg"]


@pytest.mark.parametrize(
    ("installed", "names", "tier", "code", "help_", "exit_code"),
    [
        (INSTALLED, ("missing",), Tier.DECISION, "transport-unusable", "apt-get install it", ExitCode.FAILURE),
        (INSTALLED, ("real", "omg"), Tier.EXCHANGE, "transport-tier", "it supports decision", ExitCode.USAGE),
        (INSTALLED, ("omg", "other"), Tier.DECISION, "transport-foreign", "-i missing or -i omg", ExitCode.USAGE),
        (plugins(), (), Tier.DECISION, "transport-none", "'keymint transports'", ExitCode.FAILURE),
    ],
)
def test_a_choice_that_cannot_be_tested(
    installed: Any, names: tuple[str, ...], tier: Tier, code: str, help_: str, exit_code: ExitCode
) -> None:
    with pytest.raises(KeymintError) as caught:
        choose(installed, names, tier, ["one"])
    (diagnostic,) = caught.value.diagnostics
    assert (diagnostic.code, caught.value.exit_code) == (code, exit_code)
    assert help_ in diagnostic.help


def test_models_decide_by_documents_alone_and_the_standard_comes_first() -> None:
    assert list(models(INSTALLED, "one")) == ["omg", "vendor-2"]


def test_models_of_what_a_distribution_does_not_ship_are_asked_only_by_name() -> None:
    assert set(choose(INSTALLED, (), Tier.DECISION, ["one"], "old")["one"]) == {"real", "omg"}
    assert set(choose(INSTALLED, ("vendor-2",), Tier.DECISION, ["one"], "old")["one"]) == {"vendor-2"}
    assert list(models(INSTALLED, "one", distro="old")) == ["omg"]


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
