# SPDX-License-Identifier: Apache-2.0
"""The vocabulary of rules: each permission has one kind, and composite permissions have parts."""

from __future__ import annotations

from comarmor.rules import KIND_OF, PARTS, PERMISSIONS, parts


def test_every_permission_has_one_kind_and_parts_that_are_not_composite():
    assert set(KIND_OF) == {permission for permissions in PERMISSIONS.values() for permission in permissions}
    for kind, permissions in PERMISSIONS.items():
        for permission in permissions:
            assert KIND_OF[permission] == kind
            for part_kind, part_permission, suffix in parts(kind, permission):
                assert part_permission in PERMISSIONS[part_kind]
                assert parts(part_kind, part_permission) == ((part_kind, part_permission, ""),)
                assert bool(suffix) is ((kind, permission) in PARTS)
