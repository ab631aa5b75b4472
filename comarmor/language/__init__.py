"""The ComArmor policy language: parse policies, decide requests, render policies, read policy tests."""
