"""Drivers of real DDS implementations: the one room of this plugin that starts processes and looks at the machine.

Only loopback is ever used.
"""
