# SPDX-License-Identifier: Apache-2.0
"""Proofs that the router's file permits each enclave exactly what the policy allows, for all literal keys.

Start at ``enclave_proof``; ``shared_proof`` proves what holds across subjects.
"""
