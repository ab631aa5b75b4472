# SPDX-License-Identifier: Apache-2.0
"""Requests of robots that make their own key, and the bundles that answer them. Bytes in, bytes out.

Modules: :mod:`~keymint.bundles.request` (PKCS #10, with a nonce), :mod:`~keymint.bundles.manifest` (what a bundle is
for), :mod:`~keymint.bundles.container` (the file), :mod:`~keymint.bundles.bundle` (signed, and verified) and
:mod:`~keymint.bundles.acceptance` (may a robot take it, given what it has).
"""
