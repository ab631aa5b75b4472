# SPDX-License-Identifier: Apache-2.0
"""Any file is either accepted, or rejected quickly with one line and a place; then nothing is written."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import comarmor
from comarmor.errors import Diagnostic
from keymint.api import BuildOptions, LoadedPolicy
from keymint.authority.authorities import plan_authorities
from keymint.errors import KeymintError
from keymint.pki.tokens.token_sessions import Tokens
from keymint.stages.build import BuildStage
from keymint.stages.create import CreateStage, packages_to_create
from keymint.stages.install import InstallStage
from keymint.stages.work import InstallRequest
from keymint.store.changes import Plan
from keymint.view.stamps import State
from keymint.view.tree import Tree
from keymint.workspace.policy_loading import load_policy
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace
from tests.conftest import installed_plugins
from tests.effort import tries

from . import mutation
from .memory import in_memory

POLICIES = tries(3000, 6600)
"""Number of mutated policies to load and evaluate."""
DOCUMENTS = tries(1500, 5400)
"""Number of mutated workspace documents that all stages plan with."""
COMMANDS = tries(200, 600)
"""Number of mutated files of any kind to run the command line on."""
SECONDS = 10
"""Seconds that no case may exceed, even on a busy machine."""

Keymint = Callable[..., Any]

POLICY = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <tunable name="ROBOT"><value>/r1</value><value>/r[2-9]</value></tunable>
  <profile name="talker" modifier="AUDIT">
    <attachments><attachment>@{ROBOT}/talker</attachment><attachment>/r1/arm</attachment></attachments>
    <xi:include href="common/part.xml" parse="xml"/>
    <topic qualifier="DENY"><attachment>rt/x</attachment><permissions><publish/></permissions>
      <partitions><partition>p</partition></partitions></topic>
    <ros_action qualifier="ALLOW"><attachment>{namespace}do</attachment>
      <permissions><ros_request/></permissions></ros_action>
    <profile name="inner"><attachment>/r1/*</attachment>
      <ros_topic qualifier="DENY"><attachment>/secret</attachment><permissions><ros_publish/></permissions></ros_topic>
    </profile>
  </profile>
</profiles>
"""
PART = """<profile name="node"><attachment>*</attachment>
  <ros_service qualifier="ALLOW"><attachment>{namespace}{name}/x</attachment>
    <permissions><ros_call/></permissions></ros_service>
  <ros_parameter qualifier="ALLOW"><attachment>{namespace}{name}</attachment>
    <permissions><ros_read/><ros_write/></permissions></ros_parameter>
  <ros_topic qualifier="ALLOW"><attachment>/chatter*</attachment>
    <permissions><ros_publish/><ros_subscribe/></permissions></ros_topic>
</profile>
"""


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    """Stop a case that takes too long."""

    def end(_signal: int, _frame: FrameType | None) -> None:
        raise AssertionError(f"takes more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def told(case: str, content: bytes) -> Iterator[None]:
    """Name the failed case, and show its input."""
    try:
        yield
    except Exception as error:
        error.add_note(f"{case}: {content[:1500]!r}")
        raise


def require_one_line(diagnostics: Sequence[Diagnostic | comarmor.Diagnostic]) -> None:
    """Check that each message is one printable line of reasonable length, with a place."""
    assert diagnostics
    for found in diagnostics:
        line = str(found)
        assert found.message
        assert found.where is not None, line
        assert line.isprintable(), repr(line)
        assert len(line.replace(tempfile.gettempdir(), "")) < 2000, line
        assert "PRIVATE KEY" not in line


@pytest.fixture(scope="module")
def memory() -> Iterator[Path]:
    with in_memory() as folder:
        yield folder


@pytest.fixture
def policy(memory: Path) -> Path:
    folder = memory / "policy"
    (folder / "common").mkdir(parents=True, exist_ok=True)
    (folder / "policy.xml").write_text(POLICY)
    (folder / "common" / "part.xml").write_text(PART)
    return folder


@pytest.fixture
def workspace(memory: Path, policy: Path, keymint: Keymint) -> Path:
    root = memory / "ws"
    if not root.exists():
        assert keymint("provision", policy, "-w", root).code == 0
    return root


def require_errors(said: str) -> None:
    """Check that a command reports errors with a place, each on its own line."""
    errors = [line for line in said.splitlines() if " warning: " not in f" {line}"]
    assert errors
    for line in errors:
        assert line.isprintable(), repr(line)
        assert ": error: " in line, line


# -- policies ----------------------------------------------------------------------------------------------------


def test_mutated_policies_load_or_are_rejected(policy: Path) -> None:
    files = {path: path.read_bytes() for path in sorted(policy.rglob("*.xml"))}
    outcomes: Counter[str] = Counter()
    for seed in range(POLICIES):
        chance = random.Random(seed)
        path, content = chance.choice(list(files.items()))
        mutated = _mutated(content, list(files.values()), chance)
        path.write_bytes(mutated)
        with told(f"{path.name} with seed {seed}", mutated), in_time():
            outcomes[_loaded(policy)] += 1
        path.write_bytes(content)
    assert outcomes["loaded"] > POLICIES // 20, outcomes  # what is mutated is not only refused at its first byte
    assert outcomes["refused"] > POLICIES // 4, outcomes


def _mutated(content: bytes, others: Sequence[bytes], chance: random.Random) -> bytes:
    return mutation.in_tree(content, chance, others) if chance.random() < 0.7 else mutation.in_bytes(content, chance)


def _loaded(policy: Path) -> str:
    try:
        loaded = comarmor.load(policy)
    except comarmor.ComArmorError as error:
        require_one_line(error.diagnostics)
        return "refused"
    for subject in (*loaded.subjects(), "/r1/arm"):
        loaded.decide(subject, "ros_topic", "ros_publish", "/chatter")
        loaded.decide(subject, "ros_parameter", "ros_read", "/r1/talker")
    assert comarmor.render(loaded)
    return "loaded"


# -- the documents of a workspace --------------------------------------------------------------------------------


def test_all_stages_plan_with_a_mutated_document_or_reject_it(workspace: Path) -> None:
    at = Workspace.at(workspace, {}, workspace.parent)
    plugins = installed_plugins()
    documents = {
        path: path.read_bytes()
        for space in (at.profile, at.src / "r1" / "talker", at.build / "r1" / "talker")
        for path in sorted(space.rglob("*.xml"))
        if "comarmor.d" not in path.parts
    }
    assert {path.name for path in documents} >= {
        "keymint_profile.xml",
        "authorities.xml",
        "policies.xml",
        "keymint_package.xml",
        "permissions.xml",
        "governance.xml",
        "identities.xml",
    }
    before = _tree(workspace)
    now = datetime.fromtimestamp(int(os.environ["SOURCE_DATE_EPOCH"]), UTC)
    tokens = Tokens({})
    policy = load_policy(Inputs(at, Tree(), State(), plugins, {}, now, tokens).session())
    outcomes: Counter[str] = Counter()
    for seed in range(DOCUMENTS):
        chance = random.Random(f"document {seed}")
        path, content = chance.choice(list(documents.items()))
        others = [other for name, other in documents.items() if name.name == path.name] + list(documents.values())[:3]
        mutated = _mutated(content, others, chance)
        inputs = Inputs(at, Tree().overlaid([(path.parent, {path.name: mutated})]), State(), plugins, {}, now, tokens)
        known = None if path.is_relative_to(at.profile) else policy  # only the profile says where the policy is
        with told(f"{path} with seed {seed}", mutated), in_time():
            outcomes[_planned(inputs, known, in_build=path.is_relative_to(at.build))] += 1
    assert _tree(workspace) == before  # planning writes nothing
    assert outcomes["planned"] > DOCUMENTS // 20, outcomes
    assert outcomes["refused"] > DOCUMENTS // 4, outcomes


def _plan(stage: CreateStage | BuildStage | InstallStage, names: Iterable[str]) -> Plan:
    return stage.plan([stage.package(name) for name in names])


def _planned(inputs: Inputs, known: LoadedPolicy | None, *, in_build: bool) -> str:
    try:
        session = inputs.session()
        policy = load_policy(session) if known is None else known
        names = packages_to_create(session, policy)
        create = CreateStage(session, policy, force=False)
        after = session.after(_plan(create, create.subjects(names)))
        options = BuildOptions(allow_vendor_specific=True)
        if not in_build:  # a document in build/ is signed as it is
            after = after.after(_plan(BuildStage(after, InstallRequest(force=True, build=options)), names))
        minted, authorities = plan_authorities(after)
        _plan(InstallStage(after.after(minted), authorities, prune=True), names)
    except KeymintError as error:
        require_one_line(error.diagnostics)
        return "refused"
    return "planned"


# -- the command line --------------------------------------------------------------------------------------------


def _tree(folder: Path) -> Mapping[str, tuple[int, int, int, int]]:
    found = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        found[str(path)] = (status.st_mode, status.st_ino, status.st_mtime_ns, status.st_size)
    return found


VERBS = (
    ("provision", "{policy}"),
    ("create", "--all"),
    ("build", "-f"),
    ("install",),
    ("install", "--prune"),
    ("check",),
    ("status",),
)


def test_the_command_line_exits_cleanly_and_a_failure_writes_nothing(
    memory: Path, workspace: Path, policy: Path, keymint: Keymint
) -> None:
    pristine = memory / "pristine"
    shutil.copytree(workspace, pristine)
    files = [
        path.relative_to(memory)
        for folder in (workspace, policy)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in {"lock", ".gitignore"} and "comarmor.d" not in path.parts
    ]
    codes: Counter[int] = Counter()
    for seed in range(COMMANDS):
        chance = random.Random(f"command {seed}")
        path = memory / chance.choice(files)
        content = path.read_bytes()
        mutated = _mutated(content, [], chance) if path.suffix == ".xml" else mutation.in_bytes(content, chance)
        path.write_bytes(mutated)
        verb = [part.format(policy=policy) for part in chance.choice(VERBS)]
        before = _tree(workspace)
        with told(f"{' '.join(verb)} on {path.relative_to(memory)} with seed {seed}", mutated), in_time():
            ended = keymint(*verb, "-w", workspace)
            codes[ended.code] += 1
            assert ended.code in {0, 1, 3}
            assert "Traceback" not in ended.err
            assert "internal error" not in ended.err
            if ended.code == 1:
                require_errors(ended.err)
            if ended.code != 0:
                assert _tree(workspace) == before
        if ended.code == 0 and _tree(workspace) != before:
            shutil.rmtree(workspace)
            shutil.copytree(pristine, workspace)
        path.write_bytes(content)
    assert set(codes) == {0, 1, 3}, codes
    assert codes[1] > COMMANDS // 10, codes


def test_there_are_thousands_of_cases() -> None:
    assert tries(4_500, 12_000) <= POLICIES + DOCUMENTS + COMMANDS


# -- bombs -------------------------------------------------------------------------------------------------------


def including(*hrefs: str, attributes: str = "") -> str:
    """Return a policy that includes files."""
    includes = "".join(f'<xi:include href="{href}"{attributes}/>' for href in hrefs)
    return f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude">{includes}</profiles>'


_PROFILE = '<profile name="p"><attachment>/a</attachment></profile>'
_BILLION = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
BOMBS: Mapping[str, Mapping[str, str]] = {
    "entities that double": {"policy.xml": f'<!DOCTYPE p [<!ENTITY l0 "ha">{_BILLION}]><profiles>&l9;</profiles>'},
    "one long entity": {
        "policy.xml": f'<!DOCTYPE p [<!ENTITY a "{"a" * 50_000}">]><profiles>{"&a;" * 50_000}</profiles>'
    },
    "parameter entities": {
        "policy.xml": '<!DOCTYPE p [<!ENTITY % a SYSTEM "file:///etc/passwd">%a;]><profiles/>',
    },
    "an external entity": {
        "policy.xml": '<!DOCTYPE p [<!ENTITY a SYSTEM "file:///etc/passwd">]><profiles><profile name="&a;"/></profiles>'
    },
    "an entity of the network": {
        "policy.xml": '<!DOCTYPE p SYSTEM "http://127.0.0.1:9/x.dtd"><profiles/>',
    },
    "an attribute default": {
        "policy.xml": '<!DOCTYPE p [<!ATTLIST profiles x CDATA "y">]><profiles/>',
    },
    "an include of /etc/passwd": {"policy.xml": including("/etc/passwd", attributes=' parse="text"')},
    "an include of /etc/passwd as XML": {"policy.xml": including("/etc/passwd")},
    "an include of a file URL": {"policy.xml": including("file:///etc/passwd")},
    "an include from the network": {"policy.xml": including("http://127.0.0.1:9/x.xml")},
    "an include upward": {"policy.xml": including("../../../../../../../../etc/passwd")},
    "an include upward, encoded": {"policy.xml": including("%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd")},
    "an include of itself": {"policy.xml": including("policy.xml")},
    "an include loop": {
        "policy.xml": including("d/a.xml"),
        "d/a.xml": including("b.xml"),
        "d/b.xml": including("a.xml"),
    },
    "includes that double": {
        "policy.xml": including("d/0.xml", "d/0.xml"),
        **{f"d/{n}.xml": including(f"{n + 1}.xml", f"{n + 1}.xml") for n in range(40)},
        "d/40.xml": "<profiles/>",
    },
    "includes that double, not too deep": {
        "policy.xml": including("d/0.xml", "d/0.xml"),
        **{f"d/{n}.xml": including(*[f"{n + 1}.xml"] * 10) for n in range(7)},
        "d/7.xml": f"<profiles>{_PROFILE}</profiles>",
    },
    "includes of a large file again and again": {
        "policy.xml": including(*["d/a.xml"] * 500),
        "d/a.xml": f"<profiles>{_PROFILE * 2000}</profiles>",
    },
    "includes that are nested deep": {
        "policy.xml": including("d/0.xml"),
        **{f"d/{n}.xml": including(f"{n + 1}.xml") for n in range(200)},
        "d/200.xml": "<profiles/>",
    },
    "elements that are nested deep": {"policy.xml": "<profiles>" + "<profile>" * 100_000},
    "an endless attribute": {"policy.xml": f'<profiles a="{"x" * 20_000_000}"/>'},
    "an endless text": {"policy.xml": f"<profiles>{'x' * 20_000_000}</profiles>"},
    "tunables that double": {
        "policy.xml": "<profiles>"
        + "".join(f'<tunable name="T{n}"><value>/a</value><value>/b</value></tunable>' for n in range(30))
        + f"<profile name='p'><attachment>{''.join(f'@{{T{n}}}' for n in range(30))}</attachment></profile></profiles>",
    },
    "tunables that double each other": {
        "policy.xml": '<profiles><tunable name="T0"><value>/a</value><value>/b</value></tunable>'
        + "".join(f'<tunable name="T{n}"><value>@{{T{n - 1}}}@{{T{n - 1}}}</value></tunable>' for n in range(1, 30))
        + "<profile name='p'><attachment>@{T29}</attachment></profile></profiles>",
    },
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_an_xml_bomb_is_rejected_quickly(bomb: str, tmp_path: Path, keymint: Keymint) -> None:
    for name, content in BOMBS[bomb].items():
        (tmp_path / "policy" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "policy" / name).write_text(content)
    keymint("plugins")  # what is imported once is not the bomb's
    began = time.process_time()
    with pytest.raises(comarmor.ComArmorError) as caught:
        comarmor.load(tmp_path / "policy" / "policy.xml")
    took = time.process_time() - began
    require_one_line(caught.value.diagnostics)
    assert "root:" not in str(caught.value)
    assert took < 1.0
    ended = keymint("provision", tmp_path / "policy" / "policy.xml", "-w", tmp_path / "ws")
    assert ended.code == 1
    assert "root:" not in ended.err
    assert not (tmp_path / "ws").exists()


@pytest.mark.parametrize("bomb", ["entities that double", "an external entity", "elements that are nested deep"])
@pytest.mark.parametrize(
    "path",
    [
        "profile/keymint_profile.xml",
        "profile/authorities.xml",
        "src/r1/arm/permissions.xml",
        "build/r1/arm/governance.xml",
    ],
)
def test_an_xml_bomb_in_a_workspace_is_rejected_quickly(
    bomb: str, path: str, memory: Path, workspace: Path, keymint: Keymint
) -> None:
    file = workspace / path
    content = file.read_bytes()
    (bomb_text,) = BOMBS[bomb].values()
    file.write_text(bomb_text)
    before = _tree(workspace)
    try:
        began = time.process_time()
        ended = keymint("install", "-w", workspace)
        assert time.process_time() - began < 1.0
        assert ended.code == 1, ended
        assert "root:" not in ended.err
        assert path in ended.err
        assert _tree(workspace) == before
    finally:
        file.write_bytes(content)
