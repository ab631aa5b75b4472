# SPDX-License-Identifier: Apache-2.0
"""Read what a router's configuration grants to an enclave as rules on ROS names: the other direction of the compiler.

Of a permission the message counts that only its holder sends, the first of its slots. Key expressions become
expressions of a policy, of which the compiler makes the same again: what it would not is refused, so that nothing is
guessed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from comarmor.patterns import glob
from comarmor.rules import Effect
from comarmor.text import lazy_regex
from keymint.api import DomainRange, EnclaveFiles, InstalledRights
from keymint.errors import KeymintError, Origin, require_none
from keymint.ir import Rule
from keymint.pki import distinguished_names
from keymint_ros2_zenoh.decision import LinkAccess, first_common_name
from keymint_ros2_zenoh.documents.configuration import Flow, Message
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, ROUTER
from keymint_ros2_zenoh.examine.enclaves import router_differences
from keymint_ros2_zenoh.keyexpr import KeyExpr, TooManyAlternativesError, canonical, includes, key_exprs
from keymint_ros2_zenoh.lowering.permissions import ADVANCED, SLOTS
from keymint_ros2_zenoh.proving.enclave_proof import router_access
from keymint_ros2_zenoh.proving.policy_evaluator import KIND
from keymint_ros2_zenoh.settings import ACCESS

_KEY = lazy_regex(r"([0-9]+)/(.+?)/\*/\*(/\*\*)?")
"""The keys of names in a domain, with any type and hash, which stand before a ``**`` at the end of the name."""
_CHUNKS = lazy_regex(r"(?<![^/])((?:\*/)*\*)/\*\*(?![^/])")
"""A star for one chunk or more, or several with slashes between them, and a ``**``."""
_STAR = lazy_regex(r"\$\*/\*\*/\$\*|\$\*/\*\*|\*\*/\$\*|\$\*")
"""What the compiler writes for a star beside characters of a segment."""


def rights(enclave: EnclaveFiles, subject: str, built: Mapping[str, bytes] | None = None) -> InstalledRights | None:
    """Return what the router grants to an enclave; see :meth:`keymint.api.Prover.rights`.

    Raises:
        KeymintError: the router's file is not vouched for or cannot be read, or no policy can say what it grants.
    """
    del subject
    shared, folder = enclave.shared if built is None else built, enclave.shared_folder
    if ROUTER not in shared:
        return None
    if built is None:
        require_none(router_differences(shared, folder, enclave.anchors.authorities[ACCESS]))
        name = first_common_name(enclave.files.get(CERTIFICATE, b""))
    else:
        attributes = distinguished_names.attributes(distinguished_names.parse(enclave.anchors.subject_name))
        name = next(value for kind, value in attributes if kind == "CN")
    where = Origin(f"{folder}/{ROUTER}")
    by_domain = _names(router_access(shared[ROUTER], where.file).of_certificate(name), where)
    names, *others = by_domain.values() or ({},)
    if any(each != names for each in others):
        raise _unsayable("its rights are not the same in all domains", where)
    rules = (
        Rule(effect, KIND[permission], (permission,), (each,), (), False, where)
        for (effect, permission), own in names.items()
        for each in _expressions(own, where)
    )
    return InstalledRights(tuple(rules), tuple(DomainRange(each, each) for each in sorted(by_domain)))


def _names(access: LinkAccess, where: Origin) -> dict[int, dict[tuple[Effect, str], set[KeyExpr]]]:
    """Return the names of topics and services that each permission is allowed on, or denied, by domain."""
    if access.open or access.unmodelled or len(access.keys(Message.PUT, Flow.INGRESS)) > 1:
        raise _unsayable(access.unmodelled or "not one subject decides alone what is allowed", where)
    by_domain: dict[int, dict[tuple[Effect, str], set[KeyExpr]]] = {}
    for permission, (sent, *_) in SLOTS.items():
        for effect, keys in zip((Effect.ALLOW, Effect.DENY), access.keys(sent.message, sent.flow)[0], strict=True):
            for key in (each for each in keys if ADVANCED not in each.chunks):
                if not (match := _KEY.fullmatch(key.text)):
                    raise _unsayable(f"{key.text!r} is no key of a ROS name with any type", where)
                own = by_domain.setdefault(int(match[1]), {}).setdefault((effect, permission), set())
                own.add(canonical(match[2] + (match[3] or "")))
    return by_domain


def _expressions(names: Collection[KeyExpr], where: Origin) -> Collection[str]:
    """Return the expressions of a policy that stand for some key expressions of names together.

    Raises:
        KeymintError: there are none.
    """
    texts = sorted({"/" + _STAR.sub("*", _CHUNKS.sub(r"\1", name.text)) for name in names})
    try:
        made = {key for text in texts for key in key_exprs(glob.parse(text))}
    except TooManyAlternativesError:
        made = set()
    for inner, outer in ((made, names), (names, made)):
        if any(key not in outer and not any(includes(each, key) for each in outer) for key in inner):
            raise _unsayable(f"no expressions of a policy match what {', '.join(map(str, names))} do", where)
    return texts


def _unsayable(message: str, where: Origin) -> KeymintError:
    return KeymintError(message, where=where, help="'keymint check' compares it with the sources", code="rights-unread")
