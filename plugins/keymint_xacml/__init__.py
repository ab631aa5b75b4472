# SPDX-License-Identifier: Apache-2.0
"""Policy format ``xacml``: writes rules as a policy set of XACML 3.0 (OASIS Standard, 2013)."""

from __future__ import annotations

from keymint.api import API_VERSION, PolicyFormat, lazy

__all__ = ["XacmlPolicyFormat", "policy_format"]


class XacmlPolicyFormat(PolicyFormat):
    """Writes XACML 3.0."""

    API = API_VERSION

    exported = lazy("keymint_xacml.policy_set:written_policy")


policy_format = XacmlPolicyFormat()
