# SPDX-License-Identifier: Apache-2.0
"""Judge the bytes of a keystore: each rule once, each code raised in one place.

``rights`` compares what every certificate in force may present with the policy; ``lists`` judges revocation lists;
``issued`` compares installed certificates with the register; ``keys`` judges private keys; ``not_examined`` tells what
the user may not read; ``keystore`` asks all of them, also about a second
keystore that lies beside the one in force.
The views are ``keymint check``, ``prove`` and ``status``; docs/verification.md says which of them reads what.
"""
