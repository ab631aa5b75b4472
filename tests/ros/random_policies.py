# SPDX-License-Identifier: Apache-2.0
"""Random policies of five enclaves, and operations to try with each: topics, services, actions, parameters, denials."""

from __future__ import annotations

from random import Random

from .ros_system import GRAPH, policy, rule

PERMISSIONS = {
    "ros_topic": ("ros_publish", "ros_subscribe"),
    "ros_service": ("ros_call", "ros_execute"),
    "ros_action": ("ros_request", "ros_operate"),
    "ros_parameter": ("ros_read", "ros_write"),
}
SUBJECTS = ("/arm", "/base", "/r1/camera", "/r1/cell/driver", "/r2/planner")
NAMES = (
    "/scan", "/odom", "/cmd_vel", "/r1/scan", "/r1/odom", "/r2/scan", "/r2/cmd_vel", "/r1/cell/odom", "/r1/cell/scan",
    "/r10/scan", "/scanner", "/Scan", "/arm", "/r1/camera", "/r2/planner", "/r1/camera/image",
)  # fmt: skip
PATTERNS = ("/r1/*", "/r2/*", "/r*/scan", "*/odom", "/scan*", "/r?/cmd_vel", "/r[12]/scan", "/*/cell/*", "{namespace}*")
OPERATIONS = 30
"""Of each enclave."""


def random_policy(seed: int) -> str:
    """Return a policy, the same for the same seed."""
    rng = Random(seed)
    profiles = {}
    for subject in SUBJECTS:
        rules = [GRAPH]
        for _ in range(rng.randint(3, 7)):
            kind = rng.choice(list(PERMISSIONS))
            name = rng.choice(NAMES) if rng.random() < 0.6 else rng.choice(PATTERNS)
            rules.append(rule(kind, name, *rng.sample(PERMISSIONS[kind], rng.randint(1, 2))))
        for _ in range(rng.randint(0, 2)):
            kind = rng.choice(list(PERMISSIONS))
            denied = rng.choice(NAMES)
            rules.append(rule(kind, denied, *PERMISSIONS[kind], qualifier="DENY"))
        profiles[subject] = "".join(rules)
    return policy(profiles)


def operations(seed: int, subject: str) -> list[tuple[str, str]]:
    """Return what an enclave tries: permissions and names."""
    rng = Random(f"{seed} {subject}")
    every = [(permission, name) for each in PERMISSIONS.values() for permission in each for name in NAMES]
    return rng.sample(every, OPERATIONS)
