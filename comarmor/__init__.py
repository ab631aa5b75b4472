"""ComArmor: mandatory access control for communication graphs, as AppArmor is for Linux processes.

Profiles attach to subjects (a ROS 2 node or enclave), and their rules allow or deny permissions on objects (topics,
services, actions, parameters).

    >>> import comarmor
    >>> policy = comarmor.load("comarmor.d")  # doctest: +SKIP
    >>> policy.decide("/talker", "ros_topic", "ros_publish", "/chatter").allowed  # doctest: +SKIP
    True
"""

from comarmor.errors import ComArmorError, Diagnostic, Location, Severity
from comarmor.loading import load, load_all
from comarmor.model import PARTS, PERMISSIONS, Decision, Effect, Expression, Profile, Rule
from comarmor.policy import Policy
from comarmor.render import render

__all__ = [
    "PARTS",
    "PERMISSIONS",
    "ComArmorError",
    "Decision",
    "Diagnostic",
    "Effect",
    "Expression",
    "Location",
    "Policy",
    "Profile",
    "Rule",
    "Severity",
    "load",
    "load_all",
    "render",
]
