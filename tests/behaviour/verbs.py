# SPDX-License-Identifier: Apache-2.0
"""Cases of verbs: the life of a keystore, robots that make keys, other tools' keystores and policies, and the rest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from tests import sros2_keystore
from tests.plugins.keymint_ros2_dds.discovery.admin_console_file import participant, system

from .checkout import NOW
from .record import DAY, Case, Steps
from .workspaces import POLICY, SROS2_POLICY, WIDER, provision, read_all

_ZENOH, _BOTH = ("--transport", "zenoh"), ("--transport", "dds", "--transport", "zenoh")
_REASONS = ("superseded", "key-compromise", "retired", "affiliation-changed", "privilege-withdrawn", "unspecified")

# -- life ------------------------------------------------------------------------------------------------------------


def _revoked(reason: str, words: tuple[str, ...], s: Steps) -> None:
    provision(s, *words)
    s.run("revoke", "robot1/camera", "--reason", reason, "--dry-run", "-w", "ws")
    s.run("revoke", "robot1/camera", "--reason", reason, "-w", "ws")
    s.run("revoke", "robot1/camera", "--reason", reason, "--json", "-w", "ws", days=1)
    read_all(s, "ws", days=1)
    s.run("renew", "--rekey", "robot1/camera", "--json", "-w", "ws", days=2)
    s.run("provision", "policy.xml", "-w", "ws", *words, days=2)
    s.both("issued", "--revoked", "-w", "ws", days=2)
    s.both("crl", "-w", "ws", days=2)
    s.run("crl", "--refresh", "--valid-for", "30d", "-w", "ws", days=3)
    s.both("check", "-w", "ws", days=4)
    s.both("check", "-w", "ws", days=40)
    s.run("crl", "--refresh", "--json", "-w", "ws", days=40)
    s.run("revoke", "nobody", "--reason", reason, "-w", "ws")


def _renewed(words: tuple[str, ...], s: Steps) -> None:
    provision(s, "--valid-for", "90d", *words)
    for days in (1, 61, 120, 185):
        s.both("renew", "-w", "ws", days=days)
        s.both("check", "-w", "ws", days=days)
    s.run("renew", "--threshold", "80d", "talker", "-w", "ws", "--json", days=186)
    s.run("renew", "--threshold", "100%", "-w", "ws", days=186)
    s.run("renew", "--threshold", "much", "-w", "ws", days=186)
    s.run("renew", "--rekey", "planner", "-w", "ws", "--json", days=187)
    s.run("renew", "nobody", "-w", "ws", days=187)
    s.run("build", "--rekey", "talker", "-w", "ws", days=188)
    s.run("install", "-w", "ws", days=188)
    s.both("status", "-w", "ws", days=188)
    s.both("issued", "-w", "ws", days=188)


def _authorities(words: tuple[str, ...], s: Steps) -> None:
    provision(s, *words)
    for name in ("identity_ca", "permissions_ca", "nobody"):
        s.both("authority", "show", name, "-w", "ws")
        s.run("authority", "renew", name, "--dry-run", "-w", "ws", days=30)
        s.run("authority", "renew", name, "-w", "ws", days=30)
        s.run("authority", "renew", name, "--flag-day", "--json", "-w", "ws", days=31)
        s.run("authority", "export", name, "-w", "ws")
        s.run("authority", "export", name, "--chain", "--with-key", f"{name}.key", "-o", f"{name}.pem", "-w", "ws")
        s.run("authority", "import", name, f"{name}.pem", "--json", "-w", "ws")
        s.run("authority", "encrypt", name, "-w", "ws")
        s.both("check", "-w", "ws", days=32)
    s.run("authority", "import", "identity_ca", "permissions_ca.pem", "-w", "ws")
    s.run("install", "--new-authority", "identity_ca", "--json", "-w", "ws", days=33)
    s.both("check", "-w", "ws", days=33)


def _replaced(name: str, options: tuple[str, ...], phases: tuple[str, ...], words: tuple[str, ...], s: Steps) -> None:
    provision(s, *words)
    replace = ("authority", "replace", name, *options)
    s.run("revoke", "planner", "--reason", "superseded", "-w", "ws")
    s.run(*replace, "--dry-run", "-w", "ws")
    s.run(*replace, "-w", "ws")
    s.run(*replace, "--json", "-w", "ws")
    read_all(s, "ws", days=1)
    s.run("bundle", "talker", "--staged", "-o", "t.bundle", "-w", "ws", "--json", days=1)
    s.write("policy.xml", WIDER)
    s.run("provision", "policy.xml", "-w", "ws", *words, "--json", days=1)
    for phase in phases:
        s.run("authority", "replace", name, "--phase", phase, "-w", "ws", "--dry-run", days=2)
        s.run("authority", "replace", name, "--phase", phase, "-w", "ws", days=2)
        s.both("authority", "show", "-w", "ws", days=2)
        s.both("check", "-w", "ws", days=2)
        s.run("prove", "--json", "-w", "ws", days=2)
        s.run("revoke", "talker", "--reason", "superseded", "--json", "-w", "ws", days=3)
    s.run("authority", "replace", name, "--cancel", "-w", "ws", "--json", days=4)
    read_all(s, "ws", days=4)


# -- robots ----------------------------------------------------------------------------------------------------------


def _fingerprint(s: Steps, file: str) -> str:
    key = x509.load_pem_x509_csr((s.folder / file).read_bytes()).public_key()
    return hashlib.sha256(key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).hexdigest()


def _authority_key(s: Steps) -> str:
    certificate = x509.load_pem_x509_certificate((s.folder / "ws/public/identity_ca.cert.pem").read_bytes())
    key = certificate.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    return hashlib.sha256(key).hexdigest()


def _robot(words: tuple[str, ...], s: Steps) -> None:
    provision(s, *words)
    talker = ("request", "/talker", "--folder", "robot")
    for more in ((), ("--json",), ("--discard",), ("--key-type", "RSA-2048"), ("--discard",), ("-o", "t.pem")):
        s.run(*talker, *more)
    s.run("sign", "t.pem", "-w", "ws")
    s.run("sign", "t.pem", "--fingerprint", f"/talker={'0' * 64}", "-w", "ws")
    trusted = ("--authority-fingerprint", _authority_key(s), "--folder", "robot")
    if (s.folder / "t.pem").exists():
        signed = ("sign", "t.pem", "--fingerprint", f"/talker={_fingerprint(s, 't.pem')}", "-o", "t.bundle", "-w", "ws")
        s.run(*signed, "--dry-run")
        s.run(*signed, "--json")
    s.run("accept", "t.bundle", "--folder", "robot")
    s.run("accept", "t.bundle", *trusted, "--dry-run")
    s.run("accept", "t.bundle", *trusted)
    s.run("accept", "t.bundle", "--folder", "robot", "--json")
    read_all(s, "ws")
    s.run("bundle", "robot1/*", "-o", "bundles", "-w", "ws", "--json")
    s.run("bundle", "talker", "-o", "again.bundle", "-w", "ws", days=1)
    s.run("accept", "bundles/robot1/camera.bundle", "bundles/robot1.camera.bundle", *trusted)
    for file in sorted(path.name for path in (s.folder / "bundles").rglob("*.bundle")):
        path = next((s.folder / "bundles").rglob(file)).relative_to(s.folder)
        s.run("accept", path, "--folder", "robot")
        s.run("accept", path, "--folder", "robot", "--new", "--json")
    s.run("accept", "again.bundle", "--folder", "robot")
    s.run("accept", "t.bundle", "--folder", "robot")
    s.run(*talker, "--rekey", "-o", "rekey.pem")
    s.run("sign", "rekey.pem", "-o", "rekey.bundle", "-w", "ws", days=2)
    s.run("accept", "rekey.bundle", "--folder", "robot", days=2)
    s.run("revoke", "talker", "--reason", "superseded", "-w", "ws", days=3)
    s.run("bundle", "talker", "-o", "revoked.bundle", "-w", "ws", days=3)
    s.run("accept", "revoked.bundle", "--folder", "robot", "--json", days=3)
    s.run("accept", "again.bundle", "--folder", "robot", days=3)
    s.run("accept", "policy.xml", "nowhere.bundle", "--folder", "robot")
    s.run("bundle", "nobody", "none*", "-w", "ws")
    s.run("renew", "talker", "--threshold", "1%", "-w", "ws", "--json", days=9)


# -- keystores and policies of other tools -----------------------------------------------------------------------------


def _adopted(form: sros2_keystore.Form, options: tuple[str, ...], s: Steps) -> None:
    s.write("policy.xml", SROS2_POLICY)
    sros2_keystore.make(s.folder / "ks", SROS2_POLICY, form)
    s.both("adopt", "ks")
    s.both("adopt", "ks", "policy.xml", *options)
    s.run("adopt", "ks", "policy.xml", "--apply", "--dry-run", "-w", "ws", *options)
    s.run("adopt", "ks", "policy.xml", "--apply", "-w", "ws", *options, "--json")
    s.run("adopt", "ks", "--apply", "-w", "signed", *options)
    s.run("learn", "--from-keystore", "ks", "-o", "learned.xml")
    read_all(s, "ws")
    for step in (("names", "talker"), ("names",), ("identifiers",), ("authority",)):
        s.run("harden", *step, "-w", "ws", days=1)
        s.run("harden", *step, "--apply", "-w", "ws", days=1)
        s.run("harden", *step, "--apply", "--flag-day", "--json", "-w", "ws", days=1)
        s.both("check", "-w", "ws", days=1)
    s.run("create", "--all", "-w", "ws", days=2)
    s.run("build", "-w", "ws", days=2)
    s.run("install", "-w", "ws", days=2)
    s.run("revoke", "talker", "--reason", "superseded", "-w", "ws", days=2)
    s.both("status", "-w", "ws", days=2)


def _broken_keystores(s: Steps) -> None:
    """Examine keystores that lack something, or are none."""
    form = sros2_keystore.Form(now=datetime.fromtimestamp(NOW - DAY, UTC))
    s.write("policy.xml", SROS2_POLICY)
    sros2_keystore.make(s.folder / "ks", SROS2_POLICY, form)
    s.copy("ks", "sound")
    for path in ("enclaves/talker/cert.pem", "enclaves/talker/key.pem", "enclaves/talker/permissions.p7s",
                 "enclaves/governance.p7s", "private", "public", "enclaves", "private/ca.key.pem"):  # fmt: skip
        s.copy("sound", "ks")
        s.remove(f"ks/{path}")
        s.both("adopt", "ks", "policy.xml", label=path)
        s.run("adopt", "ks", "policy.xml", "--apply", "-w", f"ws-{path.replace('/', '-')}", label=path)
    s.copy("sound", "ks")
    s.copy("ks/enclaves/camera/permissions.p7s", "ks/enclaves/talker/permissions.p7s")
    s.edit("ks/enclaves/listener/permissions.p7s", "rt/chatter", "rt/chatter2")
    s.link("ks/enclaves/planner/cert.pem", "/etc/passwd")
    s.both("adopt", "ks", "policy.xml")
    s.both("adopt", "nowhere")
    s.both("adopt", "policy.xml")


def _exchange(s: Steps) -> None:
    s.write("policy.xml", POLICY)
    s.write("sros2.xml", SROS2_POLICY)
    s.write("subjects", "/robot1/extra\n/talker\n")
    for kind in ("keymint_ros2_sros2", "xacml", "keymint_ros2_comarmor", "keymint_ros2_table", "none"):
        s.both("export", "policy.xml", "--format", kind)
        s.run("export", "policy.xml", "--format", kind, "--lossy", "-o", f"{kind}.out", "--subjects", "subjects")
        s.run("export", "policy.xml", "--format", kind, "--lossy", "-o", f"{kind}.out", "--json")
    s.run("import", "keymint_ros2_sros2.out", "-o", "back")
    s.run("diff", "policy.xml", "back")
    s.both("import", "sros2.xml")
    s.run("import", "sros2.xml", "-o", "comarmor.d", "--as-written", "-f")
    s.run("export", "comarmor.d", "--format", "keymint_ros2_sros2")
    s.run("import", "policy.xml")


def _graphs(s: Steps) -> None:
    ends = [("publish", "rt/chatter", "std_msgs::msg::dds_::String_", []), ("subscribe", "rt/clock", "", ["p"])]
    services = [("publish", "rq/addRequest", "", []), ("subscribe", "rr/addReply", "", [])]
    s.write("1.xml", system(participant("talker", ends), participant("", services, "a1, 2, 3, 1c1")))
    s.write("2.xml", system(participant("listener", [("subscribe", "rt/chatter", "", [])])))
    for more in ((), ("--no-fold",), ("--subject", "000000a1=/tool/reader"), ("-o", "g.json"), ("-o", "g.json")):
        s.both("discover", "--from", "1.xml", *more)
    s.both("discover", "--from", "2.xml", "--append", "g.json")
    s.both("discover", "--from", "policy.xml")
    s.write("policy.xml", POLICY)
    s.both("discover", "--from", "policy.xml")
    graph = f"{s.example('ppac_2018')}/graph.json"
    s.both("learn", graph)
    s.run("learn", graph, "g.json", "-o", "learned.xml")
    s.run("learn", graph, "-o", "learned.xml")
    s.both("learn", graph, "--policy", "policy.xml", "-o", "more.xml")
    s.run("provision", "learned.xml", "-w", "ws")
    s.both("verify", "-i", "omg", "-w", "ws", "--graph", graph)
    s.run("verify", "-i", "omg", "-w", "ws", "--graph", graph, "--report", "report", "--limit", 2)
    for more in (("--all",), ("--by", "namespace"), ("--only", "denied"), ("--group",), ("--fold", "--common")):
        s.run("graph", graph, "--policy", "policy.xml", "--format", "svg", *more)
        s.run("graph", "policy.xml", "--format", "dot", *more)
    s.write("broken.json", json.dumps({"format": "keymint-graph", "version": 9}))
    for verb in ("graph", "learn"):
        s.both(verb, "broken.json")


def _questions(s: Steps) -> None:
    s.write("policy.xml", POLICY)
    s.write("wider.xml", WIDER)
    fleet = s.example("fleet")
    for more in (
        (),
        ("--format", "markdown"),
        ("--format", "json"),
        ("--json",),
        ("--budget", 5),
        ("--format", "markdown", "--json"),
    ):
        s.run("diff", "policy.xml", "wider.xml", *more)
        s.run("diff", "wider.xml", "policy.xml", *more)
    s.both("diff", "policy.xml", "policy.xml")
    s.both("diff", "policy.xml", f"{fleet}/fleet.xml")
    for question in ("who can publish /chatter", "what can /robot1/* do", "can /robot1/* ever publish /status/secret",
                     "can '/amr*/nav' ever subscribe '/amr2/*'", "flows /robot1/camera /planner", "who may do",
                     "isolated /robot1/* /talker", "isolated /talker /talker", "who can fly /x",
                     "who can call /add", ""):  # fmt: skip
        for policy in ("policy.xml", fleet):
            s.both("query", policy, question)
            s.run("query", policy, question, "--infrastructure", "--except", "/tf")
    s.run("provision", "policy.xml", "-w", "ws", *_BOTH)
    for words in (("/talker", "publish", "/chatter"), ("/talker", "ros_publish", "/status/secret"),
                  ("/x", "publish", "/y"),
                  ("/talker", "publish", "rt/chatter"), ("/robot1", "call", "/add"), ("/planner", "execute", "/add"),
                  ("/talker", "fly", "/x"), ("/talker", "publish", "/chatter", "-i", "omg"),
                  ("/talker", "publish")):  # fmt: skip
        s.both("why", *words, *("-i", "omg", "-i", "zenoh-1"), "-w", "ws")
    s.both(
        "why", "/talker", "publish", "x", "--kind", "topic", "--partition", "p", "--domain", 3, "-i", "omg", "-w", "ws"
    )
    for transport in ("omg", "cyclonedds-0.10", "cyclonedds-11", "fastdds-2.9", "fastdds-3.3", "zenoh-1", "no"):
        s.both("verify", "-i", transport, "-w", "ws")
    s.both("verify", "--distro", "ardent", "-i", "omg", "-w", "ws")
    s.both("verify", "--tier", "admission", "-i", "omg", "-w", "ws")
    s.both("prove", "--seconds", 0, "-w", "ws")
    s.both("prove", "--states", 1, "/talker", "nobody", "-w", "ws")
    s.both("prove", "--distro", "foxy", "-w", "ws")
    s.both("check", "--vendors", "fastdds=2.6.0,cyclonedds=0.10.2", "-w", "ws")
    s.both("check", "--vendors", "none=1", "-w", "ws")
    s.both("check", "talker", "nobody", "-w", "ws")


def _sources(s: Steps) -> None:
    """Lint, format and test policies."""
    s.write("policy.xml", POLICY)
    s.both("fmt", "policy.xml", "--check")
    s.both("fmt", "policy.xml", "--diff")
    s.run("fmt", "policy.xml", "--dry-run")
    s.run("fmt", "policy.xml")
    s.run("fmt", "policy.xml")
    s.both("lint", "policy.xml")
    s.run("lint", "policy.xml", "--sarif", "lint.sarif")
    for build_type in ("keymint_ros2_dds", "keymint_ros2_zenoh", "none"):
        s.both("lint", "policy.xml", "--build-type", build_type, "--distro", "humble")
    for name in ("fleet", "operator"):
        folder = s.example(name)
        s.both("test", folder)
        s.run("test", folder, "--junit", f"{name}.junit", "--min-coverage", 100)
        s.both("lint", folder)
        s.both("fmt", folder, "--check")
        s.edit(f"{folder}/{name}.test.xml", "<allow", "<deny")
        s.both("test", folder)
    s.write(
        "policy.test.xml",
        "<tests><test name='x'><allow subject='/talker' permission='fly' object='/x'/></test></tests>",
    )
    s.both("test", "policy.xml")


def _tool(s: Steps) -> None:
    """Print help, lists and scripts; make mistakes on the command line."""
    top = s.run("--help").out
    verbs = [line.split()[0] for line in top.splitlines() if line.startswith("  ") and line[2:3].isalpha()]
    for verb in sorted(set(verbs)):
        s.run(verb, "--help")
    for verb in ("show", "renew", "replace", "encrypt", "import", "export"):
        s.run("authority", verb, "--help")
    for words in (("--version",), (), ("plugins",), ("transports",), ("explain", "usage"), ("plan",), ("nothing",),
                  ("chek",), ("check", "--jsn"), ("init", "-j", 0), ("check",), ("authority",), ("authority", "sow"),
                  ("env",), ("harden", "all"), ("revoke", "x"), ("export",)):  # fmt: skip
        s.both(*words)
    for shell in ("bash", "zsh", "fish", "tcsh"):
        s.both("completion", shell)
    s.run("", env={"_KEYMINT_COMPLETE": "bash_complete", "COMP_WORDS": "keymint pro", "COMP_CWORD": "1"})
    s.run("init", "ws", env={"ROS_DISTRO": "humble"})
    s.run("init", "ws2", env={"ROS_DISTRO": "none"})
    s.run("check", "-w", "ws", env={"NO_COLOR": "1"})
    s.run("plugins", "-v", env={"AMENT_PREFIX_PATH": "/nowhere"})


_MADE = sros2_keystore.Form(now=datetime.fromtimestamp(NOW - DAY, UTC))
_FORMS = {
    "plain": (_MADE, ()),
    "two": (sros2_keystore.Form(now=_MADE.now, two=True), ()),
    "flat": (sros2_keystore.Form(now=_MADE.now, layout="flat"), ("--distro", "eloquent")),
    "rti": (sros2_keystore.Form(now=_MADE.now, layout="rti"), ()),
    "domain": (sros2_keystore.Form(now=_MADE.now, domain=5, zone=True), ()),
    "domains": (sros2_keystore.Form(now=_MADE.now, domain=5, governance_domain=0), ()),
    "expired": (sros2_keystore.Form(now=datetime(2010, 1, 1, tzinfo=UTC)), ()),
    "no-graph": (sros2_keystore.Form(now=_MADE.now, graph=False), ("--no-implicit",)),
    "names": (sros2_keystore.Form(now=_MADE.now, common_names={"/talker": "/camera"}), ("--as-written",)),
}
_REPLACED = {
    "staged-identity": ("identity_ca", (), ("end",)),
    "staged-signer": ("permissions_ca", (), ("end",)),
    "distributed": ("identity_ca", ("--vendor", "fastdds"), ("reissue", "end")),
    "unknown": ("nobody", (), ("end",)),
    "cancelled": ("identity_ca", ("--vendor", "fastdds"), ()),
    "early": ("identity_ca", ("--vendor", "fastdds"), ("end",)),
    "vendor": ("identity_ca", ("--vendor", "none"), ()),
}
CASES: Mapping[str, Case] = {
    **{f"revoked-{reason}": partial(_revoked, reason, ()) for reason in _REASONS},
    "revoked-zenoh": partial(_revoked, "key-compromise", _ZENOH),
    "revoked-both": partial(_revoked, "superseded", _BOTH),
    **{f"renewed-{len(words)}": partial(_renewed, words) for words in ((), _ZENOH, _BOTH)},
    **{f"authorities-{len(words)}": partial(_authorities, words) for words in ((), _ZENOH, _BOTH)},
    **{f"replaced-{name}": partial(_replaced, *what, ()) for name, what in _REPLACED.items()},
    "replaced-zenoh": partial(_replaced, "identity_ca", (), ("reissue", "end"), _ZENOH),
    "replaced-zenoh-signer": partial(_replaced, "permissions_ca", (), ("end",), _ZENOH),
    "replaced-both": partial(_replaced, "identity_ca", (), ("end",), _BOTH),
    **{f"robot-{len(words)}": partial(_robot, words) for words in ((), _ZENOH, _BOTH)},
    **{f"adopted-{name}": partial(_adopted, *what) for name, what in _FORMS.items()},
    "broken-keystores": _broken_keystores,
    "exchange": _exchange,
    "graphs": _graphs,
    "questions": _questions,
    "sources": _sources,
    "tool": _tool,
}
