# SPDX-License-Identifier: Apache-2.0
"""After a loss of power a robot has the key of each request and of each enclave, and enclaves are old or new.

The model of what a disk may hold is in :mod:`tests.robustness.power_loss`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.pki import keys
from keymint.robots import bundle, certification_request
from keymint.store.staged import Exchange
from keymint.store.store import Store
from tests.effort import tries

from .power_loss import Crash, Image, Recorder, Recording, crashes, image, write_image
from .scenarios import policy, require_fitting
from .test_power_loss import require_secrecy

Keymint = Callable[..., Any]
WHERE = Origin("test")
ENCLAVE, WAITING = "ks/enclaves/robot/talker/", "ks/.keymint/requests/robot/talker/"


def done(keymint: Keymint, *arguments: object) -> dict[str, Any]:
    outcome = keymint(*arguments, "--json")
    assert outcome.code == 0, outcome.out + outcome.err
    result: dict[str, Any] = outcome.document["result"]
    return result


def below(found: Image, folder: str) -> dict[str, bytes]:
    """Return the files of a folder on a disk image."""
    return {
        path.removeprefix(folder): content
        for path, (_, content) in found.items()
        if path.startswith(folder) and content is not None and ".keymint-" not in path
    }


@contextmanager
def lost(recording: Recording, seed: str, most: int) -> Iterator[Iterator[Image]]:
    """Yield disk images; an error is noted with the call after which power was lost."""
    at = 0

    def images() -> Iterator[Image]:
        nonlocal at
        for crash in crashes(recording, Random(seed), most):
            at = crash.at
            yield image(recording, crash)

    try:
        yield images()
    except Exception as error:
        error.add_note(
            f"power was lost after {at} of {len(recording.events)} calls: {recording.events[max(0, at - 1)]}"
        )
        raise


def whole(recording: Recording) -> Image:
    """Return the image after a run that nothing disturbed."""
    return image(recording, Crash(len(recording.events), lambda _: True, bytes))


@pytest.fixture
def robot(memory: Path) -> Path:
    folder = memory / "robot"
    folder.mkdir()
    return folder


def test_a_request_is_there_with_its_key_only(robot: Path, keymint: Keymint) -> None:
    arguments = ("request", "/robot/talker", "--folder", robot / "ks", "-o", robot / "r.pem")
    with Recorder(robot).patched() as recording:
        done(keymint, *arguments)
    assert below(whole(recording), "")["r.pem"]
    with lost(recording, "request", tries(300, 5000)) as images:
        for found in images:
            require_secrecy(found)
            waiting = below(found, WAITING)
            assert set(waiting) in (set(), {"key.pem", "request.pem"})
            written = below(found, "").get("r.pem")
            if written is not None:
                assert waiting["request.pem"] == written
            if waiting:
                kept = certification_request.read(waiting["request.pem"], WHERE)
                assert keys.fingerprint(keys.from_pem(waiting["key.pem"])) == kept.fingerprint


def sign(memory: Path, robot: Path, keymint: Keymint, *more: str) -> str:
    """Let the robot ask and the authority answer; returns the fingerprint of the authority."""
    ask = ("request", "/robot/talker", "--folder", robot / "ks", "-o", memory / "r.pem")
    confirmed = f"/robot/talker={done(keymint, *ask, *more)['fingerprint']}"
    arguments = ("sign", memory / "r.pem", "-w", memory / "ws", "--fingerprint", confirmed, "-o", robot / "b")
    trust: str = done(keymint, *arguments)["bundles"][0]["authority"]
    return trust


@pytest.mark.parametrize("again", [False, True], ids=["first", "another key"])
def test_an_enclave_is_old_or_new_and_its_key_is_never_lost(
    again: bool, memory: Path, robot: Path, keymint: Keymint
) -> None:
    (memory / "policy.xml").write_text(policy("/robot/talker"))
    assert keymint("provision", memory / "policy.xml", "-w", memory / "ws").code == 0
    trusting = ("--authority-fingerprint", sign(memory, robot, keymint))
    if again:
        done(keymint, "accept", robot / "b", "--folder", robot / "ks", *trusting)
        sign(memory, robot, keymint, "--rekey")
    wanted = bundle.read((robot / "b").read_bytes(), WHERE).manifest.key
    folder = robot / "ks/enclaves/robot/talker"
    old = {path.name: path.read_bytes() for path in folder.iterdir()} if again else {}
    with Recorder(robot).patched() as recording:
        done(keymint, "accept", robot / "b", "--folder", robot / "ks", *trusting)
    new = below(whole(recording), ENCLAVE)
    assert new["key.pem"] != old.get("key.pem")
    met: set[frozenset[tuple[str, bytes]]] = set()
    with lost(recording, "accept", tries(300, 5000)) as images:
        for found in images:
            require_secrecy(found)
            now, waiting = below(found, ENCLAVE), below(found, WAITING)
            assert now in (old, new)
            require_fitting(now)
            here = {keys.fingerprint(keys.from_pem(pem)) for pem in (now.get("key.pem"), waiting.get("key.pem")) if pem}
            assert wanted in here
            look = frozenset(below(found, "ks/").items())
            if look not in met and len(met) < tries(4, 100):
                met.add(look)
                write_image(found, memory / f"image{len(met)}")
                done(keymint, "accept", robot / "b", "--folder", memory / f"image{len(met)}" / "ks", *trusting)
                after = memory / f"image{len(met)}" / "ks/enclaves/robot/talker"
                assert {path.name: path.read_bytes() for path in after.iterdir()} == new


def test_the_model_finds_a_key_that_is_removed_too_early(
    memory: Path, robot: Path, keymint: Keymint, monkeypatch: pytest.MonkeyPatch
) -> None:
    (memory / "policy.xml").write_text(policy("/robot/talker"))
    assert keymint("provision", memory / "policy.xml", "-w", memory / "ws").code == 0
    trust = sign(memory, robot, keymint)
    enclave: list[Sequence[Exchange]] = []
    commit = Store.commit

    def other_way_round(self: Store, staged: Sequence[Exchange]) -> None:
        if enclave:
            commit(self, staged)
            commit(self, enclave[0])
        else:
            enclave.append(staged)

    monkeypatch.setattr(Store, "commit", other_way_round)
    with Recorder(robot).patched() as recording:
        done(keymint, "accept", robot / "b", "--folder", robot / "ks", "--authority-fingerprint", trust)
    assert below(whole(recording), ENCLAVE)
    images = [image(recording, crash) for crash in crashes(recording, Random("early"), 1000)]
    assert not all("key.pem" in {*below(found, ENCLAVE), *below(found, WAITING)} for found in images)
