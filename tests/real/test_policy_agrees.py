"""The real access control decides as the policy says, whatever the policy."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import pytest
from hypothesis import HealthCheck, event, given, reject, settings
from hypothesis import strategies as st

import comarmor
from keymint.errors import KeymintError

from .agreement import REQUESTS, access, allowed, compiled, operations
from .participants import System, Vendor
from .provisioning import enclave
from .test_install_space import POLICY

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from .handmade import Authorities

SUBJECTS = ("/b", "/r/a")
NAMES = ("/x", "/xy", "/x/y", "/y", "/y/x", "/r/x", "/r/a", "/r/a/x", "/b", "/z")
RAW_NAMES = ("raw", "rawx", "raw/x", "raw/x/y")
PARTITIONS: tuple[Sequence[str], ...] = ((), ("",), ("p",), ("p", "q"), ("p", ""))

EXPRESSIONS = (
    *NAMES,
    *("*", "/*", "/x*", "/x/*", "*/x", "/?", "/x?", "/[xy]", "/[!x]", "/r/*", "*y", "/*/x"),
    *("{namespace}x", "{namespace}{name}", "{namespace}*", "/{name}"),
)
RAW_EXPRESSIONS = (*RAW_NAMES, "raw*", "raw/*", "raw?x", "raw/x*")
KINDS: dict[str, tuple[str, ...]] = {}
for _kind, _permission in REQUESTS:
    KINDS[_kind] = (*KINDS.get(_kind, ()), _permission)


def rule(effect: str, kind: str, permissions: Sequence[str], expressions: Sequence[str], extra: str = "") -> str:
    attachments = "".join(f"<attachment>{escape(expression)}</attachment>" for expression in expressions)
    held = "".join(f"<{permission}/>" for permission in permissions)
    return (
        f'<{kind} qualifier="{effect}"><attachments>{attachments}</attachments>{extra}'
        f"<permissions>{held}</permissions></{kind}>"
    )


def profile(subject: str, rules: Sequence[str]) -> str:
    return f'<profile name="test"><attachment>{subject}</attachment>{"".join(rules)}</profile>'


effects = st.sampled_from(["ALLOW", "ALLOW", "DENY"])
some_expressions = st.lists(st.sampled_from(EXPRESSIONS), min_size=1, max_size=3, unique=True)
ros_rules = st.sampled_from(sorted(KINDS)).flatmap(
    lambda kind: st.builds(
        rule,
        effects,
        st.just(kind),
        st.lists(st.sampled_from(KINDS[kind]), min_size=1, max_size=2, unique=True),
        some_expressions,
    )
)
topic_rules = st.builds(
    rule,
    effects,
    st.just("topic"),
    st.lists(st.sampled_from(["publish", "subscribe"]), min_size=1, max_size=2, unique=True),
    st.lists(st.sampled_from(RAW_EXPRESSIONS), min_size=1, max_size=2, unique=True),
)
rules_of_a_subject = st.lists(st.one_of(ros_rules, ros_rules, topic_rules), max_size=5)


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(rules=rules_of_a_subject, subject=st.sampled_from(SUBJECTS))
def test_any_policy(authorities: Authorities, tmp_path: Path, rules: list[str], subject: str) -> None:
    path = tmp_path / "policy.xml"
    path.write_text(f"<profiles>{profile(subject, rules)}</profiles>")
    disagreements = compared(authorities, path, subject)
    assert disagreements == []


partition_lists = st.sampled_from(
    ["", *(f"<partitions>{listed}</partitions>" for listed in ("<partition>p</partition>", "<partition/>"))]
)
partitioned_rules = st.lists(
    st.builds(
        rule,
        effects,
        st.just("topic"),
        st.lists(st.sampled_from(["publish", "subscribe"]), min_size=1, max_size=2, unique=True),
        st.lists(st.sampled_from([*RAW_NAMES, "raw/*"]), min_size=1, max_size=2, unique=True),
        partition_lists,
    ),
    max_size=4,
)


@pytest.mark.cyclonedds
@pytest.mark.usefixtures("cyclone_plugins")
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(rules=partitioned_rules)
def test_any_policy_on_partitions(authorities: Authorities, tmp_path: Path, rules: list[str]) -> None:
    path = tmp_path / "policy.xml"
    path.write_text(f"<profiles>{profile('/b', rules)}</profiles>")
    assert compared(authorities, path, "/b") == []


def compared(authorities: Authorities, path: Path, subject: str) -> list[tuple[object, ...]]:
    """Return every question that policy and plugin answer differently, unless the policy is not portable."""
    policy = comarmor.load(path)
    try:
        documents = compiled(path, subject)
    except KeymintError as error:
        if any(not item.code.startswith("portability-") for item in error.diagnostics):
            raise
        event("not portable")
        reject()
    questions = [(*request, name, ()) for request, name in product(REQUESTS, NAMES)]
    raw = product(("publish", "subscribe"), RAW_NAMES, PARTITIONS)
    asked: list[tuple[str, str, str, Sequence[str]]] = [
        *questions,
        *(("topic", permission, name, partitions) for permission, name, partitions in raw),
    ]
    with access(authorities, subject, documents) as opened:
        return [
            (kind, permission, name, partitions, said, done)
            for kind, permission, name, partitions in asked
            for said in [policy.decide(subject, kind, permission, name, partitions).allowed]
            for done in [allowed(opened, permission, name, partitions)]
            if said != done
        ]


def test_a_provisioned_keystore(provisioned: Callable[[str], Path], vendor: Vendor, tmp_path: Path) -> None:
    """The whole way: policy, command, install space, and a real participant for every subject."""
    install = provisioned(POLICY)
    path = tmp_path / "policy.xml"
    path.write_text(POLICY)
    policy = comarmor.load(path)
    names = ("/chatter", "/log/public", "/log/private", "/log", "/add_two_ints", "/below", "/elsewhere")
    for subject in policy.subjects():
        with System(vendor) as system:
            participant = system.open(enclave(install, subject))
            for (kind, permission), name in product(REQUESTS, names):
                needed = operations(permission, name)
                done = all(participant.allows(each.direction, each.topic) for each in needed)
                said = policy.decide(subject, kind, permission, name).allowed
                assert done is said, (subject, permission, name)
            participant.close()
