# SPDX-License-Identifier: Apache-2.0
"""Compare the decisions of transports with the policy, edge by edge: ``keymint verify`` and ``keymint why``.

After White et al., "Procedurally Provisioned Access Control for Robotic Systems" (IROS 2018): the completed semantic
graph is labelled by the policy and by a transport that uses the compiled artifacts, and the labels are compared.

Start at :mod:`~keymint.verify.verification`, or at :mod:`~keymint.verify.why` for one decision.
"""
