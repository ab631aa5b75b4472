"""Writes the permissions and governance documents of DDS Security 1.1, in the form that every vendor accepts."""
