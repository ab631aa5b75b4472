# SPDX-License-Identifier: Apache-2.0
"""Prove an installed enclave: what the router's file permits it, and that its sessions know the router alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

from comarmor.errors import Diagnostic, Reason
from keymint.api import Claim, Counterexample, DomainRange, Endpoint, PolicyDecision, Proof, ProofTask, Verdict
from keymint.errors import KeymintError
from keymint.pki.identity_check import enclave_file
from keymint_ros2_zenoh import configuration_requirements
from keymint_ros2_zenoh.decision.admission import first_common_name
from keymint_ros2_zenoh.decision.message_access import AccessModel
from keymint_ros2_zenoh.documents.configuration import Configuration
from keymint_ros2_zenoh.documents.configuration_reader import read
from keymint_ros2_zenoh.emission import common_name, router_of
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, ROUTER, SESSION
from keymint_ros2_zenoh.proving.anchor_check import differences
from keymint_ros2_zenoh.proving.claims import MODEL, prove_rights
from keymint_ros2_zenoh.settings import is_router

CONNECT = "connect"
_EXPECTED = "a session must exchange messages with the router alone"
_SESSIONS = "the sessions of the enclave that its configuration describes"
ASSUMPTIONS: Mapping[str, tuple[str, ...]] = {
    MODEL: (
        "configurations are read and decided as Zenoh 1.10 was measured to do it",
        "the router runs with the installed file, reads it at its start, and is not compromised",
        "names are mapped to keys as rmw_zenoh does it; nodes of one process are one subject",
        "names consist of the characters of ROS names; keys with wildcards are the subject of a claim of their own",
        "every enclave may announce its own nodes and read the graph",
    )
}


def prove(task: ProofTask) -> tuple[Claim, ...]:
    """Return the claims about an enclave; none about the router, which is no subject of the policy.

    Raises:
        KeymintError: a file is missing, cannot be read, or does not rest on the workspace's authorities; or Zenoh
            cannot express a rule of the policy.
    """
    if is_router(task.package):
        return ()
    if found := differences(task.files, task.folder, task.anchors, task.shared, task.shared_folder):
        raise KeymintError.of(found)
    router = common_name(router_of(task.package))
    session = read(enclave_file(task.files, task.folder, SESSION), f"{task.folder}/{SESSION}")
    model = router_access(task.shared[ROUTER], f"{task.shared_folder}/{ROUTER}")
    at_router = model.of_certificate(first_common_name(task.files[CERTIFICATE]))
    at_session = AccessModel(session.access_control).of_certificate(router)
    return (*prove_rights(task, at_router, at_session), _connects(task, session, router))


# All enclaves rest on the same file.
@lru_cache(maxsize=4)
def router_access(content: bytes, file: str) -> AccessModel:
    """Return the model of a router's access control.

    Raises:
        KeymintError: it cannot be read.
    """
    return AccessModel(read(content, file).access_control)


def _connects(task: ProofTask, session: Configuration, router: str) -> Claim:
    """Return the claim that sessions exchange messages with the router alone."""
    package, file = task.package, f"{task.folder}/{SESSION}"
    found = (
        *configuration_requirements.by_itself(session, package, file),
        *configuration_requirements.open_default(session, file),
        *configuration_requirements.pin_findings(session, router, file),
    )
    unmodelled, domains = configuration_requirements.unmodelled_setting(session, router=False), package.grant.domains
    return configuration_claim(CONNECT, package.subject, _SESSIONS, found, _EXPECTED, unmodelled, domains)


def configuration_claim(
    action: str,
    subject: str,
    universe: str,
    found: Sequence[Diagnostic],
    expected: str,
    unmodelled: str = "",
    domains: tuple[DomainRange, ...] = (),
) -> Claim:
    """Return a claim about a configuration, which the first finding on it refutes.

    Args:
        action: the action of the claim.
        subject: whom it is about; empty for all.
        universe: what it covers, in words.
        found: what refutes it.
        expected: what should be, in words.
        unmodelled: why it is unknown; empty if it is not.
        domains: the domains that it covers.
    """
    if not found:
        return Claim(MODEL, action, domains, universe, Proof.UNKNOWN if unmodelled else Proof.PROVEN, unmodelled)
    first, more = found[0], len(found) - 1
    message = first.message + (f" (and {more} more)" if more else "")
    policy = PolicyDecision(allowed=False, where=None, reason=Reason((expected,)))
    verdict = Verdict(allowed=True, reason=message, where=first.where)
    help_ = "'keymint build' and 'keymint install' write the file of the sources"
    endpoint = Endpoint(subject, action, "", domain=domains[0].first if domains else 0)
    example = Counterexample(endpoint, None, policy, verdict, help_, first.where, expected)
    return Claim(MODEL, action, domains, universe, Proof.COUNTEREXAMPLE, "", example)


def assumptions() -> Mapping[str, Sequence[str]]:
    """Return the assumptions of all claims by model."""
    return ASSUMPTIONS
