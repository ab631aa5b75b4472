# SPDX-License-Identifier: Apache-2.0
"""Judge the files of enclaves: all rules about installed files that know DDS Security.

Start at :mod:`~keymint_ros2_dds.examine.enclave_rules`, which has the rules about one enclave, each in one place. The
views ask some of them and say what an answer weighs: :mod:`~keymint_ros2_dds.examine.check` for ``keymint check``, and
:mod:`~keymint_ros2_dds.examine.adopted_keystore` for ``keymint adopt``.
"""
