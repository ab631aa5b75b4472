# SPDX-License-Identifier: Apache-2.0
"""Real access control decides as the policy does, for any policy."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, event, example, given, reject, settings, strategies as st
from keymint_ros2_dds.vendors.participants import System, Vendor

import comarmor
from keymint.errors import KeymintError
from tests.effort import tries

from .agreement import REQUESTS, access, allowed, compiled, operations, participant, said_of
from .conftest import on_each_fastdds
from .policies import (
    ENDPOINTS,
    NAMES,
    PARTITIONS,
    RAW_ENDPOINTS,
    meeting_rules,
    partitioned_rules,
    policy,
    rule,
    separate_rules,
)
from .probe_commands import close
from .provisioning import enclave
from .test_install_space import POLICY

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .handmade import Authorities

thorough = settings(
    max_examples=tries(50, 100),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def written(folder: Path, subject: str, rules: list[str]) -> Path:
    path = folder / "policy.xml"
    path.write_text(policy(subject, rules))
    return path


def portable(path: Path, subject: str) -> tuple[str, str]:
    """Compile a policy; skip one that is not portable across vendors."""
    try:
        return compiled(path, subject)
    except KeymintError as error:
        if any(not item.code.startswith("portability-") for item in error.diagnostics):
            raise
        event("not portable")
        reject()


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@thorough
@given(rules=separate_rules, subject=st.sampled_from(["/b", "/r/a"]))
def test_any_policy(authorities: Authorities, tmp_path: Path, rules: list[str], subject: str) -> None:
    path = written(tmp_path, subject, rules)
    loaded = comarmor.load(path)
    with access(authorities, subject, portable(path, subject)) as opened:
        assert [
            (permission, name)
            for (kind, permission), name in product(REQUESTS, NAMES)
            for said in [loaded.decide(subject, kind, permission, name).allowed]
            if allowed(opened, permission, name) is not said
        ] == []


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@thorough
@given(rules=meeting_rules)
def test_any_policy_whose_raw_and_ros_rules_overlap(authorities: Authorities, tmp_path: Path, rules: list[str]) -> None:
    path = written(tmp_path, "/b", rules)
    loaded = comarmor.load(path)
    with access(authorities, "/b", portable(path, "/b")) as opened:
        assert [
            each for each in ENDPOINTS if opened.allows(each.direction, each.topic) is not said_of(loaded, "/b", each)
        ] == []


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@thorough
@example(
    rules=[
        rule("ALLOW", "topic", ["publish"], ["raw", "raw/x"]),
        rule("ALLOW", "topic", ["publish"], ["raw", "raw/*"], ["p"]),
        rule("DENY", "topic", ["publish"], ["raw/x"], ["p"]),
    ]
)
@given(rules=partitioned_rules)
def test_any_policy_on_partitions(authorities: Authorities, tmp_path: Path, rules: list[str]) -> None:
    path = written(tmp_path, "/b", rules)
    loaded = comarmor.load(path)
    with access(authorities, "/b", portable(path, "/b")) as opened:
        assert [
            (each, partitions)
            for each, partitions in product(RAW_ENDPOINTS, PARTITIONS)
            for said in [loaded.decide("/b", "topic", each.direction, each.topic, partitions).allowed]
            if opened.allows(each.direction, each.topic, partitions) is not said
        ] == []


@on_each_fastdds
@settings(parent=thorough, max_examples=25)
@given(rules=st.one_of(separate_rules, meeting_rules, partitioned_rules))
def test_any_policy_on_fast_dds(authorities: Authorities, vendor: Vendor, tmp_path: Path, rules: list[str]) -> None:
    path = written(tmp_path, "/b", rules)
    loaded = comarmor.load(path)
    asked = [*product(ENDPOINTS, [()]), *product(RAW_ENDPOINTS, PARTITIONS)]
    with participant(vendor, authorities, tmp_path, "/b", portable(path, "/b")) as opened:
        assert [
            (each, partitions)
            for each, partitions in asked
            for done in [opened is not None and opened.allows(each.direction, each.topic, partitions)]
            if done is not said_of(loaded, "/b", each, partitions)
        ] == []


def test_a_provisioned_keystore(provisioned: Callable[[str | Path], Path], vendor: Vendor, tmp_path: Path) -> None:
    """End to end: policy, command, install space, and a real participant for every subject."""
    install = provisioned(POLICY)
    path = tmp_path / "policy.xml"
    path.write_text(POLICY)
    loaded = comarmor.load(path)
    names = ("/chatter", "/log/public", "/log/private", "/log", "/add_two_ints", "/below", "/elsewhere")
    for subject in loaded.subjects():
        with System(vendor) as system:
            opened = system.open(enclave(install, subject))
            for (kind, permission), name in product(REQUESTS, names):
                needed = operations(permission, name)
                done = all(opened.allows(each.direction, each.topic) for each in needed)
                said = loaded.decide(subject, kind, permission, name).allowed
                assert done is said, (subject, permission, name)
            close(opened)
