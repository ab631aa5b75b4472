# SPDX-License-Identifier: Apache-2.0
"""Drivers of real Zenoh: the only package of this plugin that starts processes and inspects the machine.

Only loopback is ever used.
"""
