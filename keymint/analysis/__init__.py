"""Policies as people ask about them: what is in vain, what changed, who may do what, what is expected.

Pure functions over rules and the proof engine: an answer holds for every name there is, not for a list of samples.
"""
