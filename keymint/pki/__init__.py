# SPDX-License-Identifier: Apache-2.0
"""Public key infrastructure: names, keys, certificates, S/MIME and verification. Bytes in, bytes out.

Nothing here reads a file, the clock or the environment: times and passwords are arguments.

Start at :mod:`~keymint.pki.keys`, :mod:`~keymint.pki.certificates` (issuing) or :mod:`~keymint.pki.smime` (signed
documents). :mod:`~keymint.pki.examine` judges identities and certification paths; keys in PKCS #11 tokens are in
:mod:`keymint.pki.tokens`.
"""
