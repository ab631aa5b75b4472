# SPDX-License-Identifier: Apache-2.0
"""From when, until when, issued by whom, revoked or not: certificates, revocation lists and their register.

Start at :mod:`~keymint.life.renewal_schedule`; :mod:`~keymint.life.terms` computes when a certificate ends.
"""
