# SPDX-License-Identifier: Apache-2.0
"""Drivers of real DDS implementations: the only package of this plugin that starts processes and inspects the machine.

Only loopback is ever used. How a vendor reads documents is in :mod:`keymint_ros2_dds.decision.semantics`, where a new
vendor begins; ``advisories`` has the known vulnerabilities.
"""
