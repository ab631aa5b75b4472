# SPDX-License-Identifier: Apache-2.0
"""From when, until when, issued by whom, revoked or not: certificates, revocation lists and their register.

Start at :mod:`~keymint.life.renewal_schedule`; :mod:`~keymint.life.terms` says what is over or ends soon. The end of a
certificate is computed in :func:`keymint.pki.certificate_forms.validity_within`, from what the sources ask for.
"""
