# SPDX-License-Identifier: Apache-2.0
"""Faults in the router's file of Zenoh, signed with the real key, and in the files of sessions."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from cryptography import x509

from keymint.pki import cms

from .fault import Fault
from .fault_keystores import (
    CAMERA,
    LISTENER,
    PLANNER,
    ROBOT,
    SUBJECTS,
    TALKER,
    Issuer,
    Keystore,
    each_pair,
    put,
    stranger,
)

Edit = Callable[[dict[str, Any]], None]
ROUTER = "install/zenoh/router.json5"
MESSAGES = ["put", "delete", "declare_subscriber", "query", "reply", "declare_queryable", "liveliness_token",
            "liveliness_query", "declare_liveliness_subscriber"]  # fmt: skip
FLOWS = ["ingress", "egress"]


def read(content: bytes) -> dict[str, Any]:
    """Return a configuration as Keymint writes it: JSON under lines of comments."""
    lines = content.decode().splitlines()
    found: dict[str, Any] = json.loads("\n".join(line for line in lines if not line.startswith("//")))
    return found


def signer(keystore: Keystore) -> Issuer:
    """Return the authority that signs the router's file."""
    path = keystore.ws / "public/permissions_ca.cert.pem"
    return keystore.with_key(x509.load_pem_x509_certificate(path.read_bytes()))


def write_router(keystore: Keystore, content: bytes, issuer: Issuer | None = None) -> None:
    put(keystore.ws / ROUTER, content)
    by = issuer or signer(keystore)
    put(keystore.ws / f"{ROUTER}.p7s", cms.sign(content, by.certificate, by.key))  # type: ignore[arg-type]


def _router(edit: Edit, *, signed: bool = True) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        document = read((keystore.ws / ROUTER).read_bytes())
        before = json.dumps(document)
        edit(document)
        assert json.dumps(document) != before
        content = json.dumps(document, indent=1).encode()
        if signed:
            write_router(keystore, content)
        else:
            put(keystore.ws / ROUTER, content)

    return apply


def _rules_of(document: dict[str, Any], subject: str) -> list[dict[str, Any]]:
    return [each for each in document["access_control"]["rules"] if each["id"].rpartition(" ")[0] == subject]


def _policy_of(document: dict[str, Any], subject: str) -> list[str]:
    (found,) = (each["rules"] for each in document["access_control"]["policies"] if each["subjects"] == [subject])
    assert isinstance(found, list)
    return found


def _entry_of(document: dict[str, Any], subject: str) -> dict[str, Any]:
    (found,) = (each for each in document["access_control"]["subjects"] if each["id"] == subject)
    assert isinstance(found, dict)
    return found


def _more(subject: str, messages: list[str], flows: list[str], key: str, permission: str = "allow") -> Edit:
    def edit(document: dict[str, Any]) -> None:
        rule = {"id": f"{subject} more", "permission": permission, "flows": flows, "messages": messages,
                "key_exprs": [key]}  # fmt: skip
        document["access_control"]["rules"].append(rule)
        _policy_of(document, subject).append(rule["id"])

    return edit


def _expression(subject: str, change: Callable[[str], str], *, beside: bool = False) -> Edit:
    def edit(document: dict[str, Any]) -> None:
        for rule in _rules_of(document, subject):
            keys = rule["key_exprs"]
            if rule["permission"] == "allow" and not keys[0].startswith("@"):
                changed = [change(each) for each in keys]
                rule["key_exprs"] = list(dict.fromkeys(keys + changed if beside else changed))

    return edit


def _first_rule(subject: str, **members: Any) -> Edit:
    return lambda document: _rules_of(document, subject)[0].update(members)


def _names(subject: str, *names: str) -> Edit:
    return lambda document: _entry_of(document, subject).update(cert_common_names=list(names))


def _nameless(subject: str) -> Edit:
    return lambda document: _entry_of(document, subject).pop("cert_common_names")


def _thief(subject: str) -> Edit:
    def edit(document: dict[str, Any]) -> None:
        document["access_control"]["subjects"].append({"id": "thief", "cert_common_names": ["/thief"]})
        document["access_control"]["policies"].append({"subjects": ["thief"], "rules": _policy_of(document, subject)})

    return edit


def _without_rule(subject: str) -> Edit:
    return lambda document: _policy_of(document, subject).pop(0)


def _without_deny(document: dict[str, Any]) -> None:
    for rule in document["access_control"]["rules"]:
        if rule["permission"] == "deny":
            _policy_of(document, rule["id"].rpartition(" ")[0]).remove(rule["id"])


def _set(*path: str, to: Any) -> Edit:
    def edit(document: dict[str, Any]) -> None:
        for name in path[:-1]:
            document = document[name]
        document[path[-1]] = to

    return edit


TLS = ("transport", "link", "tls")
SETTINGS: dict[str, Edit] = {
    "default": _set("access_control", "default_permission", to="allow"),
    "no access control": _set("access_control", "enabled", to=False),
    "plain TCP beside TLS": _set("listen", "endpoints", to=["tls/localhost:7447", "tcp/localhost:7448"]),
    "any certificate": _set(*TLS, "enable_mtls", to=False),
    "gossip": _set("scouting", "gossip", "enabled", to=True),
    "multicast": _set("scouting", "multicast", "enabled", to=True),
    "mode": _set("mode", to="peer"),
    "links outlive certificates": _set(*TLS, "close_link_on_expiration", to=False),
    "another authority": _set(*TLS, "root_ca_certificate", to="/tmp/other.pem"),
    "a far router": _set("connect", "endpoints", to=["tls/far:7447"]),
    "no deny": _without_deny,
}


def _reordered(document: dict[str, Any]) -> None:
    for name in ("rules", "subjects", "policies"):
        document["access_control"][name].reverse()


def _unused(document: dict[str, Any]) -> None:
    document["access_control"]["rules"].append(
        {"id": "unused", "permission": "allow", "flows": FLOWS, "messages": MESSAGES, "key_exprs": ["0/**"]}
    )


def _longer(key: str) -> str:
    return key.replace("image$*", "imag$*") if "$*" in key else key.replace("/*/*", "$*/*/*", 1)


_NOBODY = "nobody has such a certificate; 'prove' may refuse rights for a stranger before one exists"


def _rights() -> Iterator[Fault]:
    for subject in SUBJECTS:
        edits: dict[str, Edit] = {
            "puts everything": _more(subject, ["put"], ["ingress"], "0/**"),
            "puts one more": _more(subject, ["put"], ["ingress"], "0/zz/*/*"),
            "reads one more": _more(subject, ["put"], ["egress"], "0/zz/*/*"),
            "replies to more": _more(subject, ["reply"], ["ingress"], "0/zz/*/*"),
            "may do all": _more(subject, MESSAGES, FLOWS, "**"),
            "in another domain": _more(subject, ["put", "declare_subscriber"], FLOWS, "1/**"),
            "denied what it may": _more(subject, MESSAGES, FLOWS, "0/**", "deny"),
            "longer names": _expression(subject, _longer, beside=True),
            "other names": _expression(subject, lambda key: key.replace("0/", "0/other/", 1)),
            "forges graphs": _more(subject, ["liveliness_token"], ["ingress"], "@ros2_lv/0/**"),
            "lacks its first rule": _without_rule(subject),
            "denied by its first rule": _first_rule(subject, permission="deny"),
            "is any link": _nameless(subject),
            "has another name": _names(subject, "/nobody"),
        }
        for label, edit in edits.items():
            yield Fault(22, f"{subject} {label}", "zenoh", _router(edit), vendors="zenoh")
        for label, edit in (
            ("has a second name", _names(subject, subject, "/thief")),
            ("has a thief beside it", _thief(subject)),
        ):
            name = f"{subject} {label}"
            yield Fault(22, name, "zenoh", _router(edit), decides=False, check=True, why=_NOBODY)
    for one, two in each_pair((TALKER, LISTENER, PLANNER)):
        yield Fault(22, f"{one} has the name of {two}", "zenoh", _router(_names(one, two)), vendors="zenoh")
        both = _router(_names(one, one, two))
        yield Fault(22, f"{one} has the name of {two} beside its own", "zenoh", both, vendors="zenoh")


def _routers() -> Iterator[Fault]:
    for label, edit in SETTINGS.items():
        yield Fault(22, f"setting: {label}", "zenoh", _router(edit), vendors="zenoh")
        unsigned = _router(edit, signed=False)
        yield Fault(22, f"setting, unsigned: {label}", "zenoh", unsigned, vendors="zenoh")
    yield Fault(22, "lists in another order", "zenoh", _router(_reordered), decides=False)
    yield Fault(22, "a rule that no policy names", "zenoh", _router(_unused), decides=False)
    by = {"the identity authority": "identity_ca", "a namesake": ""}
    for label, role in by.items():

        def signed_by(keystore: Keystore, role: str = role) -> None:
            issuer = keystore.issuer(role, TALKER) if role else stranger("permissions_ca")
            write_router(keystore, (keystore.ws / ROUTER).read_bytes(), issuer)

        yield Fault(22, f"signed by {label}", "zenoh", signed_by, decides=False, check=True, prove=True)
    yield Fault(22, "no signature", "zenoh", lambda ks: (ks.ws / f"{ROUTER}.p7s").unlink(), decides=False, check=True,
                prove=True)  # fmt: skip
    for number in (0, 1):

        def older(keystore: Keystore, number: int = number) -> None:
            earlier = keystore.ws.parent / "stages" / str(number) / "zenoh"
            for name in ("router.json5", "router.json5.p7s"):
                put(keystore.ws / "install/zenoh" / name, (earlier / name).read_bytes())

        yield Fault(22, f"the file of day {number}", "zenoh revoked", older, vendors="zenoh")
    for subject in SUBJECTS:
        if subject != CAMERA:
            back = _router_with(lambda ks, s=subject: (s, ks.stage(0, CAMERA)))
            yield Fault(
                22, f"{subject} has the name of the thief beside its own", "zenoh revoked", back, vendors="zenoh"
            )
    yield Fault(22, "no file", "zenoh", lambda ks: (ks.ws / ROUTER).unlink(), vendors="zenoh")


def _router_with(found: Callable[[Keystore], tuple[str, Path]]) -> Callable[[Keystore], None]:
    """Let the entry of a subject also name whoever has the certificate of a folder."""

    def apply(keystore: Keystore) -> None:
        subject, folder = found(keystore)
        certificate = x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes())
        name = certificate.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)[0].value
        own = _entry_of(read((keystore.ws / ROUTER).read_bytes()), subject)["cert_common_names"]
        _router(_names(subject, *own, str(name)))(keystore)

    return apply


def _session(subject: str, edit: Edit) -> Callable[[Keystore], None]:
    def apply(keystore: Keystore) -> None:
        path = keystore.enclave(subject) / "session.json5"
        document = read(path.read_bytes())
        before = json.dumps(document)
        edit(document)
        assert json.dumps(document) != before
        put(path, json.dumps(document, indent=1).encode())

    return apply


def _rule(**members: Any) -> Edit:
    return lambda document: document["access_control"]["rules"][0].update(members)


def _unpinned(document: dict[str, Any]) -> None:
    document["access_control"]["subjects"][0].pop("cert_common_names")


SESSION: dict[str, Edit] = {
    "peer": _set("mode", to="peer"),
    "router": _set("mode", to="router"),
    "another router": _set("connect", "endpoints", to=["tls/elsewhere:7447"]),
    "one more router": _set("connect", "endpoints", to=["tls/localhost:7447", "tls/elsewhere:7447"]),
    "no name check by its endpoint": _set(
        "connect", "endpoints", to=["tls/localhost:7447#verify_name_on_connect=false"]
    ),
    "plain TCP": _set("connect", "endpoints", to=["tcp/localhost:7447"]),
    "listens": _set("listen", "endpoints", to=["tcp/[::]:0"]),
    "gossip": _set("scouting", "gossip", "enabled", to=True),
    "multicast": _set("scouting", "multicast", "enabled", to=True),
    "no client certificate": _set(*TLS, "enable_mtls", to=False),
    "no name check": _set(*TLS, "verify_name_on_connect", to=False),
    "links outlive certificates": _set(*TLS, "close_link_on_expiration", to=False),
    "another authority": _set(*TLS, "root_ca_certificate", to="/tmp/other.pem"),
    "the key of another": _set(*TLS, "connect_private_key", to="/tmp/other.key.pem"),
    "the certificate of another": _set(*TLS, "connect_certificate", to="/tmp/other.pem"),
    "no pin": _unpinned,
    "pinned to another": lambda document: document["access_control"]["subjects"][0].update(
        cert_common_names=["/robot1/listener"]
    ),
    "default": _set("access_control", "default_permission", to="allow"),
    "no access control": _set("access_control", "enabled", to=False),
    "puts nothing": _rule(messages=MESSAGES[1:]),
    "reads nothing": _rule(flows=["egress"]),
    "denied everything": _rule(permission="deny"),
    "another name space": _set("namespace", to="robot2"),
}
"""Settings with which a session trusts others than the router, lets others in, or does less than the policy says."""


def _sessions() -> Iterator[Fault]:
    for label, edit in SESSION.items():
        for subject in SUBJECTS:
            yield Fault(23, f"{subject} {label}", "zenoh", _session(subject, edit), vendors="zenoh")
    for subject in (TALKER, ROBOT):
        yield Fault(23, f"{subject} no file", "zenoh", lambda ks, s=subject: (ks.enclave(s) / "session.json5").unlink(),
                    vendors="zenoh")  # fmt: skip


FAULTS = (*_rights(), *_routers(), *_sessions())
