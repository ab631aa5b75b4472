# SPDX-License-Identifier: Apache-2.0
"""Private keys in PKCS #11 tokens, and their PINs. Start at :mod:`~keymint.pki.tokens.token_sessions`."""
