# SPDX-License-Identifier: Apache-2.0
"""Requests of robots that make their own key, and the bundles that answer them. Frozen data, and bytes.

Modules: :mod:`~keymint.bundles.request` (PKCS #10, with a nonce), :mod:`~keymint.bundles.manifest` (what a bundle is
for), :mod:`~keymint.bundles.container` (the file), :mod:`~keymint.bundles.bundle` (signed, and verified),
:mod:`~keymint.bundles.acceptance` (may a robot take it, given what it has), :mod:`~keymint.bundles.in_force` (would
nodes start with it now) and :mod:`~keymint.bundles.keystore` (what a robot has).
"""
