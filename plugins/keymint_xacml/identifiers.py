# SPDX-License-Identifier: Apache-2.0
"""Identifiers of XACML 3.0 (section 10.2 and appendices A to C), and those of the attributes that are added to them."""

from __future__ import annotations

from comarmor.values import dataclass

NAMESPACE = "urn:oasis:names:tc:xacml:3.0:core:schema:wd-17"
STRING = "http://www.w3.org/2001/XMLSchema#string"
INTEGER = "http://www.w3.org/2001/XMLSchema#integer"

DENY_UNLESS_PERMIT = "urn:oasis:names:tc:xacml:3.0:policy-combining-algorithm:deny-unless-permit"
POLICIES_DENY_OVERRIDES = "urn:oasis:names:tc:xacml:3.0:policy-combining-algorithm:deny-overrides"
RULES_DENY_OVERRIDES = "urn:oasis:names:tc:xacml:3.0:rule-combining-algorithm:deny-overrides"

_FUNCTION = "urn:oasis:names:tc:xacml:1.0:function:"
STRING_EQUAL = f"{_FUNCTION}string-equal"
REGULAR_MATCH = f"{_FUNCTION}string-regexp-match"
NOT, AND = f"{_FUNCTION}not", f"{_FUNCTION}and"
INTEGER_EQUAL, BAG_SIZE = f"{_FUNCTION}integer-equal", f"{_FUNCTION}string-bag-size"

OWN = "urn:keymint:xacml:1.0:"
"""Begins the identifiers that are not of the standard."""
AUDIT, ORIGIN = f"{OWN}advice:audit", f"{OWN}advice:origin"
_RESOURCE = "urn:oasis:names:tc:xacml:3.0:attribute-category:resource"


@dataclass(frozen=True, slots=True)
class Attribute:
    """An attribute of a request, a string."""

    category: str
    id: str


SUBJECT = Attribute(
    "urn:oasis:names:tc:xacml:1.0:subject-category:access-subject", "urn:oasis:names:tc:xacml:1.0:subject:subject-id"
)
NAME = Attribute(_RESOURCE, "urn:oasis:names:tc:xacml:1.0:resource:resource-id")
ACTION = Attribute(
    "urn:oasis:names:tc:xacml:3.0:attribute-category:action", "urn:oasis:names:tc:xacml:1.0:action:action-id"
)
KIND = Attribute(_RESOURCE, f"{OWN}resource:kind")
PARTITION = Attribute(_RESOURCE, f"{OWN}resource:partition")
ATTRIBUTES = (SUBJECT, NAME, KIND, PARTITION, ACTION)
"""What a request has, each with one value; the partition is empty for the default one."""
