# SPDX-License-Identifier: Apache-2.0
"""Cases of workspaces that somebody changed by hand: what each verb then says, and whether it mends it.

``faults`` takes its changes from the table of ``tests/keymint/examine``: whoever has the keys of the authorities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial

from tests.keymint.examine.fault import CLASSES
from tests.keymint.examine.fault_table import TABLE
from tests.keymint.examine.fault_workspaces import Bench

from .checkout import NOW
from .record import Case, Steps
from .workspaces import WIDER, provision

FAULTS = 8
"""How many faults of each class, evenly spread."""
_TALKER, _CAMERA = "ws/install/enclaves/talker", "ws/install/enclaves/robot1/camera"


def faults() -> Mapping[str, Case]:
    """Return a case for each class of faults."""
    return {f"faults-{kind:02}": partial(_faults, kind) for kind in CLASSES}


def _faults(kind: int, s: Steps) -> None:
    def run(*words: object) -> int:
        return s.run(*words, label="making").code

    bench = Bench(s.folder / "bench", run, datetime.fromtimestamp(NOW, UTC))
    table = [fault for fault in TABLE if fault.kind == kind]
    for fault in (table[at * len(table) // FAULTS] for at in range(FAULTS)):
        keystore = bench.copy(fault.workspace)
        fault.apply(keystore)
        ws = keystore.ws.relative_to(s.folder)
        s.run("check", "--json", "-w", ws, label=fault.id)
        s.run("install", "--dry-run", "-w", ws, label=fault.id)
        s.remove(f"{ws}/.keymint")
        s.run("prove", "--json", "-w", ws, label=fault.id)
        s.run("check", "-w", ws, label=fault.id)


def _removed(path: str, s: Steps) -> None:
    s.remove(path)


def _edited(path: str, old: str, new: str, s: Steps) -> None:
    s.edit(path, old, new)


def _copied(source: str, target: str, s: Steps) -> None:
    s.copy(source, target)


def _written(path: str, text: str, s: Steps) -> None:
    s.write(path, text)


def _mode(path: str, mode: int, s: Steps) -> None:
    s.chmod(path, mode)


def _linked(path: str, target: str, s: Steps) -> None:
    s.link(path, target)


def _exchanged(s: Steps) -> None:
    for name in ("key.pem", "cert.pem"):
        s.copy(f"{_TALKER}/{name}", f"kept-{name}")
        s.copy(f"{_CAMERA}/{name}", f"{_TALKER}/{name}")
        s.copy(f"kept-{name}", f"{_CAMERA}/{name}")


def _stranger(path: str, s: Steps) -> None:
    """Put a file of another workspace, whose authorities are others, into this one."""
    s.run("provision", "policy.xml", "-w", "other", label="another workspace")
    s.copy(path.replace("ws/", "other/", 1), path)


_RULES = "ws/src/talker/permissions.xml"
_SHORT = "<validity><not_before>2027-01-01T00:00:00</not_before><duration>P30D</duration></validity>"
_CHANGES: Mapping[str, Callable[[Steps], None]] = {
    "untouched": lambda _s: None,
    **{
        f"removed-{name}": partial(_removed, path)
        for name, path in {
            "record": "ws/.keymint",
            "cert": f"{_TALKER}/cert.pem",
            "key": f"{_TALKER}/key.pem",
            "permissions": f"{_TALKER}/permissions.p7s",
            "plain": f"{_TALKER}/permissions.xml",
            "governance": f"{_TALKER}/governance.p7s",
            "authority": f"{_TALKER}/identity_ca.cert.pem",
            "enclave": _TALKER,
            "install": "ws/install",
            "build": "ws/build",
            "built": "ws/build/talker/permissions.xml",
            "src": "ws/src",
            "package": "ws/src/talker",
            "rules": _RULES,
            "source": "ws/src/talker/identities.xml",
            "register": "ws/private/register.sqlite3",
            "private": "ws/private",
            "public": "ws/public",
            "ca-key": "ws/private/identity_ca.key.pem",
            "ca-cert": "ws/public/identity_ca.cert.pem",
            "signer-key": "ws/private/permissions_ca.key.pem",
            "own-key": "ws/private/identities/talker/key.pem",
            "profile": "ws/profile",
            "profile-file": "ws/profile/keymint_profile.xml",
            "defaults": "ws/profile/package.defaults",
            "policies": "ws/profile/policies.xml",
            "policy": "policy.xml",
            "shell": "ws/install/keystore.bash",
            "library": "ws/profile/comarmor.d",
        }.items()
    },
    **{
        f"edited-{name}": partial(_edited, *what)
        for name, what in {
            "rule": (_RULES, "/chatter<", "/chatter2<"),
            "rule-allow": (_RULES, 'qualifier="DENY"', 'qualifier="ALLOW"'),
            "malformed": (_RULES, "</package>", ""),
            "digest": (_RULES, "sha256:", "sha256:0"),
            "domains": (_RULES, '<grant name="/talker">', '<grant name="/talker"><domains><id>7</id></domains>'),
            "validity": (
                _RULES,
                '<grant name="/talker">',
                f'<grant name="/talker">{_SHORT}',
            ),
            "governance": (
                "ws/src/talker/governance.xml",
                "<domain_rule/>",
                "<domain_rule><rtps_protection_kind>NONE</rtps_protection_kind></domain_rule>",
            ),
            "identity": (
                "ws/src/talker/identities.xml",
                "<identity/>",
                "<identity><cert><subject_name>CN=other</subject_name></cert></identity>",
            ),
            "built": ("ws/build/talker/permissions.xml", "rt/chatter", "rt/chatter2"),
            "built-allow": ("ws/build/talker/permissions.xml", "<default>DENY", "<default>ALLOW"),
            "installed": (f"{_TALKER}/permissions.xml", "rt/chatter", "rt/chatter2"),
            "signed": (f"{_TALKER}/permissions.p7s", "rt/chatter", "rt/chatter2"),
            "signed-governance": ("ws/install/enclaves/governance.p7s", "ENCRYPT", "NONE"),
            "certificate": (f"{_TALKER}/cert.pem", "MII", "AAA"),
            "key": (f"{_TALKER}/key.pem", "PRIVATE", "PUBLIC"),
            "policy": ("policy.xml", "/chatter<", "/chatter*<"),
            "policy-half": ("policy.xml", "</profiles>", ""),
            "library": ("ws/profile/comarmor.d/common/node.xml", "common/node/time.xml", "common/tf.xml"),
            "profile": ("ws/profile/keymint_profile.xml", "jazzy", "humble"),
            "layout": ("ws/profile/keymint_profile.xml", "<layout>sros2", "<layout>flat"),
            "authorities": ("ws/profile/authorities.xml", '"permissions_ca"', '"signer"'),
            "governance-defaults": ("ws/profile/package.defaults/governance.xml", ">SIGN<", ">ENCRYPT<"),
            "dates": ("ws/profile/package.defaults/permissions.xml", "2028-01-14", "2027-06-01"),
            "format": ("ws/src/talker/keymint_package.xml", 'format="1"', 'format="9"'),
            "build-type": ("ws/src/talker/keymint_package.xml", "keymint_ros2_dds", "keymint_ros2_dd"),
            "zenoh": ("ws/src/talker/keymint_package.xml", "keymint_ros2_dds", "keymint_ros2_zenoh"),
            "state": ("ws/.keymint/state.json", "{", "["),
            "shell": ("ws/install/keystore.bash", "Enforce", "Permissive"),
        }.items()
    },
    **{
        f"stranger-{name}": partial(_stranger, path)
        for name, path in {
            "cert": f"{_TALKER}/cert.pem",
            "key": f"{_TALKER}/key.pem",
            "permissions": f"{_TALKER}/permissions.p7s",
            "enclave": _TALKER,
            "ca": "ws/public/identity_ca.cert.pem",
            "ca-key": "ws/private/identity_ca.key.pem",
            "register": "ws/private/register.sqlite3",
            "record": "ws/.keymint",
            "install": "ws/install",
        }.items()
    },
    "exchanged": _exchanged,
    "other-permissions": partial(_copied, f"{_CAMERA}/permissions.p7s", f"{_TALKER}/permissions.p7s"),
    "stray-file": partial(_written, f"{_TALKER}/notes.txt", "x"),
    "stray-key": partial(_written, "ws/install/public/ca.key.pem", "-----BEGIN PRIVATE KEY-----\n"),
    "stray-enclave": partial(_copied, _TALKER, "ws/install/enclaves/copy"),
    "stray-package": partial(_written, "ws/src/extra/keymint_package.xml", "<package/>"),
    "stray-folder": partial(_written, "ws/src/a b/keymint_package.xml", '<package format="1"/>'),
    "mode-key": partial(_mode, f"{_TALKER}/key.pem", 0o644),
    "mode-ca": partial(_mode, "ws/private/identity_ca.key.pem", 0o644),
    "mode-private": partial(_mode, "ws/private", 0o755),
    "mode-cert": partial(_mode, f"{_TALKER}/cert.pem", 0o600),
    "mode-world": partial(_mode, f"{_TALKER}/permissions.p7s", 0o666),
    "link-cert": partial(_linked, f"{_TALKER}/cert.pem", "../robot1/camera/cert.pem"),
    "link-outside": partial(_linked, f"{_TALKER}/permissions.p7s", "/etc/passwd"),
    "link-dangling": partial(_linked, f"{_TALKER}/governance.p7s", "nowhere"),
    "link-enclave": partial(_linked, _TALKER, "robot1/camera"),
    "link-src": partial(_linked, _RULES, "../../../policy.xml"),
    "wider": partial(_written, "policy.xml", WIDER),
    "empty-policy": partial(_written, "policy.xml", "<profiles/>"),
    "state-old": partial(_written, "ws/.keymint/state.json", '{"version": 1}'),
    "state-broken": partial(_written, "ws/.keymint/state.json", "\x00"),
}


def _tampered(change: Callable[[Steps], None], s: Steps) -> None:
    provision(s)
    try:
        change(s)
    except FileNotFoundError:  # a file of its own that this checkout does not have
        s.write("not-there", "")
    s.both("check", "-w", "ws")
    for verb in ("prove", "status", "issued", "build", "install"):
        s.run(verb, "--json", "-w", "ws")
    s.run("create", "--all", "-f", "-w", "ws")
    s.run("provision", "policy.xml", "-f", "-w", "ws")
    s.run("check", "-w", "ws", "--json")


_ROUTER, _SESSION = "ws/install/zenoh/router.json5", "ws/install/enclaves/talker/session.json5"
_ZENOH: Mapping[str, Callable[[Steps], None]] = {
    "untouched": lambda _s: None,
    "router": partial(_removed, _ROUTER),
    "signature": partial(_removed, f"{_ROUTER}.p7s"),
    "edited": partial(_edited, _ROUTER, "chatter", "chatter2"),
    "opened": partial(_edited, _ROUTER, '"deny"', '"allow"'),
    "session": partial(_edited, _SESSION, "connect", "listen"),
    "session-gone": partial(_removed, _SESSION),
    "built": partial(_edited, "ws/build/shared.d/zenoh/router.json5", "chatter", "chatter2"),
    "enclave": partial(_removed, "ws/install/enclaves/talker"),
    "router-enclave": partial(_removed, "ws/install/enclaves/zenoh_router"),
    "package": partial(_removed, "ws/src/robot1/camera"),
    "rule": partial(_edited, _RULES, "/chatter<", "/chatter2<"),
    "record": partial(_removed, "ws/.keymint"),
    "wider": partial(_written, "policy.xml", WIDER),
}


def _tampered_zenoh(change: Callable[[Steps], None], words: tuple[str, ...], s: Steps) -> None:
    provision(s, *words)
    change(s)
    s.both("check", "-w", "ws")
    s.both("prove", "-w", "ws")
    s.run("status", "--json", "-w", "ws")
    s.run("build", "-w", "ws")
    s.run("install", "--json", "-w", "ws")
    s.run("provision", "policy.xml", "-w", "ws", "-f")
    s.both("check", "-w", "ws")


def _expired(s: Steps) -> None:
    """Let time pass: due, then expired, then the authorities."""
    provision(s, "--valid-for", "90d")
    for days in (10, 50, 61, 89, 91, 3000, 3640, 3660):
        for verb in ("check", "prove", "status"):
            s.both(verb, "-w", "ws", days=days)
        s.run("renew", "--dry-run", "-w", "ws", days=days)
        s.run("status", "--format", "openmetrics", "-w", "ws", days=days)
    s.run("install", "-w", "ws", days=91)
    s.run("renew", "-w", "ws", days=91)
    s.both("check", "-w", "ws", days=91)
    s.run("check", "-w", "ws", days=-3)
    s.run("check", "-w", "ws", env={"SOURCE_DATE_EPOCH": "tomorrow"})


def _stale_lists(s: Steps) -> None:
    """Put back what was there before a revocation."""
    provision(s)
    s.copy("ws/install", "first")
    s.run("revoke", "robot1/camera", "--reason", "key-compromise", "-w", "ws")
    s.copy("ws/install", "second")
    s.run("revoke", "talker", "--reason", "superseded", "-w", "ws")
    for old in ("first", "second"):
        s.copy(old, "ws/install")
        s.both("check", "-w", "ws", label=old)
        s.both("prove", "-w", "ws", label=old)
        s.run("install", "--json", "-w", "ws", label=old)
        s.both("check", "-w", "ws", label=old)
    s.remove("ws/private/register.sqlite3")
    for words in (
        ("check",),
        ("issued",),
        ("crl",),
        ("crl", "--refresh"),
        ("crl", "--rebuild"),
        ("check",),
        ("issued",),
    ):
        s.both(*words, "-w", "ws")


def _in_git(s: Steps) -> None:
    """Have a key in the history of a repository."""
    provision(s)
    for ignored in (".gitignore", "private/.gitignore", "install/.gitignore"):
        s.write(f"ws/{ignored}", "")
    s.write("ws/.git/HEAD", "ref: refs/heads/main\n")
    s.both("check", "-w", "ws")


CASES: Mapping[str, Case] = {
    **{f"tampered-{name}": partial(_tampered, change) for name, change in _CHANGES.items()},
    **{f"zenoh-{name}": partial(_tampered_zenoh, change, ("--transport", "zenoh")) for name, change in _ZENOH.items()},
    **{
        f"both-{name}": partial(_tampered_zenoh, change, ("--transport", "dds", "--transport", "zenoh"))
        for name, change in _ZENOH.items()
    },
    "expired": _expired,
    "stale-lists": _stale_lists,
    "in-git": _in_git,
}
