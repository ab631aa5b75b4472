# SPDX-License-Identifier: Apache-2.0
"""Cases of workspaces that are made with other options than the defaults."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from tests.keymint.examine.fault_workspaces import POLICY, SROS2_POLICY, WIDER

from .record import Case, Steps

__all__ = ["CASES", "POLICY", "SROS2_POLICY", "WIDER", "provision", "read_all"]


def provision(s: Steps, *words: object, policy: str = POLICY, ws: str = "ws") -> None:
    """Make a workspace of five enclaves."""
    s.write("policy.xml", policy)
    s.run("provision", "policy.xml", "-w", ws, *words)


def models(s: Steps, ws: str) -> list[str]:
    """Return the options that ask the models of vendors only: real ones use their own clock, and may be missing."""
    install = s.folder / ws / "install"
    dds = ("omg", "cyclonedds-0.10", "fastdds-3.3") if any(install.rglob("permissions.p7s")) else ()
    zenoh = ("zenoh-1",) if (install / "zenoh").exists() else ()
    return [word for name in (*dds, *zenoh) or ("omg",) for word in ("-i", name)]


def read_all(s: Steps, ws: str, *, days: int = 0) -> None:
    """Run every verb that reads a workspace, in words and with ``--json``, and dry runs of those that write."""
    first = next(iter(sorted((s.folder / ws / "install").rglob("cert.pem"))), None)
    name = str(first.parent.relative_to(s.folder / ws / "install")).removeprefix("enclaves/") if first else "talker"
    for words in (("check",), ("prove",), ("status",), ("issued",), ("crl",), ("authority", "show"), ("harden",),
                  ("why", f"/{name}", "publish", "/chatter", *models(s, ws))):  # fmt: skip
        s.both(*words, "-w", ws, days=days)
    for words in (("check", "--within", "400d", "--strict"), ("lint",), ("verify", *models(s, ws)), ("env", f"/{name}"),
                  ("query", f"what can /{name} do"), ("renew", "--dry-run"), ("build", "--dry-run"),
                  ("install", "--dry-run"), ("create", "--all", "--dry-run")):  # fmt: skip
        s.run(*words, "--json", "-w", ws, days=days)
    s.run("status", "--format", "openmetrics", "-w", ws, days=days)
    s.run("check", "-v", "--sarif", "found.sarif", "-w", ws, days=days)
    s.run("env", f"/{name}", "--shell", "fish", "-w", ws, days=days)


def _option(words: tuple[str, ...], s: Steps) -> None:
    provision(s, *words)
    s.both("check", "-w", "ws")
    s.both("status", "-w", "ws")
    s.run("prove", "--json", "-w", "ws")
    s.run("provision", "policy.xml", "-w", "ws", *words, "--json")
    s.write("policy.xml", WIDER)
    s.run("provision", "policy.xml", "-w", "ws", *words, "--json", days=2)
    s.both("check", "-w", "ws", days=3)


_ZENOH, _BOTH = ("--transport", "zenoh"), ("--transport", "dds", "--transport", "zenoh")
_OPTIONS: Mapping[str, tuple[str, ...]] = {
    "plain": (),
    "zenoh": _ZENOH,
    "both": _BOTH,
    "flat": ("--layout", "flat"),
    "rti": ("--layout", "rti"),
    "sros2-layout": ("--layout", "sros2"),
    "no-layout": ("--layout", "none"),
    "zenoh-flat": (*_ZENOH, "--layout", "flat"),
    "sros2-names": ("--subject-format", "sros2"),
    "no-names": ("--subject-format", "none"),
    "unique-zenoh": (*_ZENOH, "--subject-format", "unique"),
    "sros2-zenoh": (*_ZENOH, "--subject-format", "sros2"),
    "domain": ("--domain", "42"),
    "domain-230": (*_BOTH, "--domain", "230"),
    "domain-231": ("--domain", "231"),
    "valid-days": ("--valid-for", "90d"),
    "valid-hours": ("--valid-for", "12h"),
    "valid-long": ("--valid-for", "60y"),
    "valid-iso": (*_BOTH, "--valid-for", "P6M"),
    "valid-wrong": ("--valid-for", "soon"),
    "valid-none": ("--valid-for", "0d"),
    "no-prove": ("--no-prove",),
    "no-optimise": ("--no-optimise",),
    "strict": ("--strict",),
    "jobs": ("-j", "1"),
    "jobs-two": ("-j", "2"),
    "vendor-specific": ("--allow-vendor-specific",),
    "dry-run": ("--dry-run",),
    "quiet": ("-q",),
    "verbose": ("-v",),
    "prune": ("--prune",),
    "force": ("-f",),
    "rekey": ("--rekey", "*", "--yes"),
    "superseded": ("--revoke-superseded",),
    "superseded-zenoh": (*_ZENOH, "--revoke-superseded"),
    "new-authority": ("--new-authority", "identity_ca"),
    "new-signer": (*_BOTH, "--new-authority", "permissions_ca"),
    "unknown-authority": ("--new-authority", "nobody"),
    "unknown-transport": ("--transport", "zenho"),
    "unknown-distro": ("--distro", "jazy"),
    "unknown-profile": ("--profile-type", "none"),
    "unknown-option": ("--no-prov",),
    "spaces": ("--install-space", "elsewhere/i", "--private-space", "secret", "--build-space", "b", "--src-space", "s"),
    "hints": ("--hints", "policy.xml"),
    "accepted": ("--trust-package", "nav"),
}


def _stages(s: Steps) -> None:
    """Go stage by stage, with what each refuses before the one before it."""
    s.run("init", "ws")
    s.run("init", "ws", "--json")
    s.write("policy.xml", POLICY)
    s.run("init", "own", "--policy", "policy.xml", "--domain", 3, "--valid-for", "30d")
    for ws in ("ws", "own", "nowhere"):
        s.run("install", "-w", ws)
        s.run("build", "-w", ws)
        s.run("create", "-w", ws)
        s.run("create", "nobody", "-w", ws)
        s.run("create", "talker", "-w", ws)
        s.run("create", "talker", "robot1/extra", "-w", ws, "--json")
        s.run("build", "talker", "-w", ws)
        s.run("install", "talker", "-w", ws, "--json")
        s.run("create", "--all", "-w", ws, "-v")
        s.run("build", "-w", ws, "--json")
        s.run("install", "-w", ws, "--dry-run")
        s.run("install", "-w", ws)
        s.both("status", "-w", ws)
    s.run("check", cwd="own")
    s.run("check", cwd="own/src")


def _edited_profile(edits: tuple[tuple[str, str, str], ...], env: dict[str, str], s: Steps) -> None:
    """Make a workspace, edit its profile before anything is signed, and go on."""
    s.write("policy.xml", POLICY)
    s.run("init", "ws", "--policy", "policy.xml")
    for path, old, new in edits:
        s.edit(f"ws/profile/{path}", old, new)
    for verb in (("create", "--all"), ("build",), ("install",)):
        s.run(*verb, "-w", "ws", env=env)
    read_all(s, "ws")
    s.run("revoke", "talker", "--reason", "superseded", "-w", "ws", env=env)
    s.run("check", "-w", "ws", "--json")
    s.run("install", "-w", "ws", "--json")


_AUTHORITIES, _IDENTITIES = "profile.defaults/authorities.xml", "package.defaults/identities.xml"
_GOVERNANCE = "package.defaults/governance.xml"
_SECRET = "<encryption_algorithm>{}</encryption_algorithm>\n    <password_env>{}</password_env>"
_ENCRYPTED = (_SECRET.format("NoEncryption", ""), _SECRET.format("BestAvailableEncryption", "SECRET"))
_RSA = ("<ec>\n        <curve>SECP256R1</curve>\n      </ec>",
        "<rsa>\n<key_size>2048</key_size><public_exponent>65537</public_exponent></rsa>")  # fmt: skip
_PROFILES: Mapping[str, tuple[tuple[tuple[str, str, str], ...], dict[str, str]]] = {
    "intermediate": (
        (
            (
                "authorities.xml",
                '"permissions_ca">\n      <cert>\n        <issuer_name>',
                '"permissions_ca">\n      <cert>\n        <issuer_name>identity_ca',
            ),
        ),
        {},
    ),
    "one-authority": (
        (
            ("package.defaults/permissions.xml", "permissions_ca", "identity_ca"),
            (_GOVERNANCE, "permissions_ca", "identity_ca"),
        ),
        {},
    ),
    "encrypted": (((_AUTHORITIES, *_ENCRYPTED), (_IDENTITIES, *_ENCRYPTED)), {"SECRET": "open sesame"}),
    "encrypted-locked": (((_AUTHORITIES, *_ENCRYPTED),), {}),
    "rsa": (((_AUTHORITIES, *_RSA),), {}),
    "curve": (((_IDENTITIES, "SECP256R1", "SECP384R1"),), {}),
    "hash": (((_IDENTITIES, "SHA256", "MD5"),), {}),
    "not-encrypted": (((_GOVERNANCE, "ENCRYPT</data", "NONE</data"),), {}),
    "open": (
        ((_GOVERNANCE, "<allow_unauthenticated_participants>false", "<allow_unauthenticated_participants>true"),),
        {},
    ),
    "domains": (
        (
            (_GOVERNANCE, "<id>0</id>", "<id>0</id><id_range><min>3</min><max>9</max></id_range>"),
            ("package.defaults/permissions.xml", "<id>0</id>", "<id_range><min>0</min><max>9</max></id_range>"),
        ),
        {},
    ),
    "subject-name": (
        (
            (_IDENTITIES, "OU={unique},CN={common_name}", "CN={common_name},O=ACME"),
            ("package.defaults/permissions.xml", "OU={unique},CN={common_name}", "CN={common_name},O=ACME"),
        ),
        {},
    ),
    "subject-apart": (((_IDENTITIES, "OU={unique},CN={common_name}", "CN={common_name},O=ACME"),), {}),
    "past": (((_IDENTITIES, "2028-01-14", "2027-01-10"),), {}),
    "long": (((_IDENTITIES, "2028-01-14", "2077-01-10"),), {}),
    "malformed": ((("keymint_profile.xml", "</profile>", ""),), {}),
    "unknown-member": ((("keymint_profile.xml", "<name>ws</name>", "<nam>ws</nam>"),), {}),
    "unknown-layout": ((("keymint_profile.xml", "<layout>sros2", "<layout>sros"),), {}),
    "other-distro": ((("keymint_profile.xml", "jazzy", "ardent"),), {}),
    "no-policy": ((("policies.xml", "policy.xml", "gone.xml"),), {}),
}


def _narrower(words: tuple[str, ...], s: Steps) -> None:
    """Take rights away after they were signed."""
    provision(s, *words, policy=WIDER)
    s.write("policy.xml", POLICY)
    s.run("provision", "policy.xml", "-w", "ws", *words, days=1)
    read_all(s, "ws", days=2)
    s.run("issued", "--tolerate", "talker", "-w", "ws", days=2)
    s.both("check", "-w", "ws", days=2)
    s.run("install", "--revoke-superseded", "-w", "ws", "--json", days=3)
    s.both("prove", "-w", "ws", days=3)


def _fewer(s: Steps) -> None:
    """Remove a subject from the policy, and a package; prune."""
    provision(s)
    s.write("policy.xml", POLICY.replace("/robot1/camera", "/robot1/microphone"))
    s.run("provision", "policy.xml", "-w", "ws")
    s.both("check", "-w", "ws")
    s.remove("ws/src/robot1/camera")
    s.both("status", "-w", "ws")
    s.run("build", "-w", "ws")
    s.run("install", "-w", "ws")
    s.run("install", "--prune", "-w", "ws", "--json")
    s.both("check", "-w", "ws")


CASES: Mapping[str, Case] = {
    **{f"option-{name}": partial(_option, words) for name, words in _OPTIONS.items()},
    **{f"profile-{name}": partial(_edited_profile, *what) for name, what in _PROFILES.items()},
    **{f"narrower-{len(words)}": partial(_narrower, words) for words in ((), _ZENOH, _BOTH)},
    "stages": _stages,
    "fewer": _fewer,
}
