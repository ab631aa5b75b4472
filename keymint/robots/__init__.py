# SPDX-License-Identifier: Apache-2.0
"""Requests of robots that make their own key, and the bundles that answer them. Frozen data, and bytes.

Modules: :mod:`~keymint.robots.certification_request` (PKCS #10, with a nonce), :mod:`~keymint.robots.bundle_manifest` (what a bundle is
for), :mod:`~keymint.robots.bundle_container` (the file), :mod:`~keymint.robots.bundle` (signed, and verified),
:mod:`~keymint.robots.bundle_acceptance` (may a robot take it, given what it has), :mod:`~keymint.robots.in_force` (would
nodes start with it now) and :mod:`~keymint.robots.robot_keystore` (what a robot has).
"""
