# SPDX-License-Identifier: Apache-2.0
"""Keymake, the compiler: from the lowered rules of a subject to the rules of the grant in its permissions document.

Open ``grant_compiler`` first, which runs the passes: ``arrangement`` and ``partitions`` make decision lists,
``rule_order`` puts these into an order that every vendor reads in the same way, ``rewriting`` makes equivalent forms,
with names that ``gathering`` puts together.
:mod:`keymint_ros2_dds.emit.emission` proves the result and chooses among its forms.
"""
