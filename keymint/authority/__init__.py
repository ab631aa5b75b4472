# SPDX-License-Identifier: Apache-2.0
"""The key and certificate of an authority: made, renewed, imported, encrypted, replaced.

Start at :func:`keymint.authority.authorities.plan_authorities`.
"""
