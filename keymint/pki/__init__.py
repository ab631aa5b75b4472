# SPDX-License-Identifier: Apache-2.0
"""Public key infrastructure: names, keys, certificates, S/MIME and verification. Bytes in, bytes out.

Nothing here reads a file, the clock or the environment: times and passwords are arguments.

Modules: :mod:`~keymint.pki.distinguished_names` (distinguished names), :mod:`~keymint.pki.keys`,
:mod:`~keymint.pki.certificates` (issuing), :mod:`~keymint.pki.extensions` (X.509 v3 extensions from text),
:mod:`~keymint.pki.smime` (signed documents) and :mod:`~keymint.pki.examine` (identities and certification paths).
"""
