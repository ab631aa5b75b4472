"""Holds what transports decide against what the policy says, edge by edge: ``keymint verify`` and ``keymint why``.

After White et al., "Procedurally Provisioned Access Control for Robotic Systems" (IROS 2018): the completed semantic
graph is labelled by the policy and by a transport that was given the compiled artifacts, and the labels are compared.
"""
