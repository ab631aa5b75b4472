# SPDX-License-Identifier: Apache-2.0
"""Keys and certificates of authorities that were swapped, lost or damaged are never replaced without being asked."""

from __future__ import annotations

import itertools
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.conftest import snapshot
from tests.keymint.stages.keystores import (
    AUTHORITY_KEYS,
    CERTIFICATES,
    IDENTITY_KEYS,
    another_key,
    content,
    public_key,
    trusted,
)

Damage = Callable[[Path, Path], None]


def copy(source: str) -> Damage:
    return lambda ws, path: shutil.copyfile(ws / source, path)


def foreign(ws: Path, path: Path) -> None:
    """The file of the same name of another workspace."""
    shutil.copyfile(ws.parent / "foreign" / path.relative_to(ws), path)


def flip(_ws: Path, path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def truncate(_ws: Path, path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


DAMAGES: dict[str, Damage] = {
    "deleted": lambda _ws, path: path.unlink(),
    "empty": lambda _ws, path: path.write_bytes(b""),
    "truncated": truncate,
    "flipped": flip,
    "trailing": lambda _ws, path: path.write_bytes(path.read_bytes() + b"\n"),
    "foreign": foreign,
}


def cases() -> Iterator[tuple[str, str, Damage]]:
    secret = (*AUTHORITY_KEYS, *IDENTITY_KEYS)
    for path in (*CERTIFICATES, *secret):
        for name, damage in DAMAGES.items():
            yield path, name, damage
    for path in secret:
        yield path, "another_key", another_key
    for path, other in itertools.permutations(secret, 2):
        yield path, f"as {other}", copy(other)
    for path, other in itertools.permutations(CERTIFICATES, 2):
        yield path, f"as {other}", copy(other)


HARMLESS = {
    *((path, "deleted") for path in AUTHORITY_KEYS),
    *((path, "trailing") for path in (*AUTHORITY_KEYS, *IDENTITY_KEYS)),
}
"""What is no defect: the key of an authority that is kept elsewhere, and a blank line that no reader of keys minds."""


@pytest.mark.parametrize(
    ("verbs", "recorded"), [(("install",), True), (("build", "install"), False)], ids=["recorded", "record lost"]
)
def test_no_damage_leads_to_a_new_key(keymint, made: Path, ws: Path, verbs: tuple[str, ...], recorded: bool) -> None:
    """Sweep: any file of keys or certificates, damaged in any way, is refused untouched or restored as it was."""
    shutil.copytree(made / "foreign", ws.parent / "foreign")
    before = trusted(ws)
    good = content(ws)
    refused = restored = 0
    for path, name, damage in cases():
        case = f"{path} {name}"
        for space in ("private", "public", "install", ".keymint"):
            shutil.rmtree(ws / space)
            shutil.copytree(made / "ws" / space, ws / space)
        if not recorded:
            (ws / ".keymint/state.json").unlink()
        damage(ws, ws / path)
        if recorded:
            expected = 0 if (path, name) in HARMLESS else 3
            assert keymint("check", cwd=ws).code == expected, case
        damaged = content(ws)
        codes = [keymint(verb, *(["--no-prove"] if verb == "install" else []), cwd=ws).code for verb in verbs]
        assert trusted(ws) == before, case
        if any(codes):
            refused += 1
            assert content(ws) == damaged, case
        elif (path, name) not in HARMLESS:
            restored += 1
            assert {**content(ws), path: b""} == {**good, path: b""}, case
            assert public_key(ws / path) == public_key(made / "ws" / path), case
            if path in CERTIFICATES:
                assert (ws / path).read_bytes() == (made / "ws" / path).read_bytes(), case
    assert refused >= 24
    assert restored >= 8


def test_a_wrong_key_in_place_is_refused_with_the_choice(keymint, ws: Path) -> None:
    shutil.copyfile(ws / AUTHORITY_KEYS[1], ws / AUTHORITY_KEYS[0])
    before = snapshot(ws)
    for words in (("install",), ("provision", "../policy.xml", "-w", "."), ("init",)):
        outcome = keymint(*words, cwd=ws)
        assert outcome.code == 1
        assert (
            "private/identity_ca.key.pem: error: is not the private key of public/identity_ca.cert.pem" in outcome.err
        )
        assert "'keymint install --new-authority identity_ca' makes a new authority" in outcome.err
        assert snapshot(ws) == before
    outcome = keymint("check", "--json", cwd=ws)
    assert outcome.code == 3
    assert "authority-key-mismatch" in outcome.codes()
    found = outcome.document["diagnostics"]
    assert not any(each["help"].startswith(("run 'keymint install'", "'keymint install'")) for each in found)


@pytest.mark.parametrize("name", ["identity_ca", "permissions_ca"])
@pytest.mark.parametrize("damage", ["empty", "truncated", "flipped"])
def test_a_damaged_key_of_an_authority_is_named_and_its_hint_replaces_no_other_key(
    keymint, ws: Path, name: str, damage: str
) -> None:
    before = trusted(ws)
    DAMAGES[damage](ws, ws / f"private/{name}.key.pem")
    found = keymint("check", "--json", cwd=ws).document["diagnostics"]
    assert [(each["code"], each["file"]) for each in found] == [("key-invalid", f"private/{name}.key.pem")]
    hint = re.search(r"'keymint (install --new-authority \w+)'", found[0]["help"])
    assert hint, found
    assert keymint(*hint[1].split(), cwd=ws).code == 0
    after = trusted(ws)
    changed = {key.split("/")[-1] for key in before if before[key] != after[key]}
    assert changed == {f"{name}.cert.pem"}
    assert keymint("check", cwd=ws).code == 0


def test_key_and_certificate_of_another_workspace_are_not_taken(keymint, made: Path, ws: Path) -> None:
    """They fit each other, and the profile: only the record and the enclaves tell that they are others."""
    for recorded in (True, False):
        for part in (AUTHORITY_KEYS[0], CERTIFICATES[0]):
            shutil.copyfile(made / "foreign" / part, ws / part)
        if not recorded:
            (ws / ".keymint/state.json").unlink()
        before = snapshot(ws)
        outcome = keymint("install", cwd=ws)
        assert outcome.code == 1
        assert "the key of the authority 'identity_ca' was replaced" in outcome.err
        assert {k: v for k, v in snapshot(ws).items() if k[0] != "."} == {
            k: v for k, v in before.items() if k[0] != "."
        }
        checked = keymint("check", "--json", cwd=ws)
        assert (checked.code, "authority-replaced" in checked.codes()) == (3, True)


def test_two_authorities_of_one_key(keymint, made: Path, tmp_path: Path) -> None:
    """What the version before this one made of a wrong key in place; and an empty place with such a key."""
    assert keymint("init", "ws", "--policy", made / "policy.xml").code == 0
    ws = tmp_path / "ws"
    shutil.copyfile(ws / AUTHORITY_KEYS[1], ws / AUTHORITY_KEYS[0])
    (ws / CERTIFICATES[0]).unlink()
    (ws / ".keymint/state.json").unlink()
    keymint("create", "--all", cwd=ws)
    keymint("build", cwd=ws)
    before = content(ws)
    outcome = keymint("install", cwd=ws)
    assert outcome.code == 1
    assert "the authorities 'identity_ca' and 'permissions_ca' have one and the same key" in outcome.err
    assert content(ws) == before
    assert "authority-key-shared" in keymint("check", "--json", cwd=ws).codes()
    assert keymint("install", "--new-authority", "identity_ca", cwd=ws).code == 0
    assert keymint("check", cwd=ws).code == 0


def test_before_anything_is_installed_keys_of_ones_own_are_taken(keymint, made: Path, tmp_path: Path) -> None:
    assert keymint("init", "own", "--policy", made / "policy.xml").code == 0
    own = tmp_path / "own"
    for words in (("create", "--all"), ("build",)):
        assert keymint(*words, cwd=own).code == 0
    for part in (AUTHORITY_KEYS[0], CERTIFICATES[0], AUTHORITY_KEYS[1], IDENTITY_KEYS[0]):
        shutil.copyfile(made / "foreign" / part, own / part)
    (own / CERTIFICATES[1]).unlink()
    assert keymint("install", cwd=own).code == 0
    assert keymint("check", cwd=own).code == 0
    for part in (AUTHORITY_KEYS[0], CERTIFICATES[0], AUTHORITY_KEYS[1], IDENTITY_KEYS[0]):
        assert (own / part).read_bytes() == (made / "foreign" / part).read_bytes()
