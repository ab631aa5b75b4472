"""The ComArmor policy language: from XML to profiles and rules, and what they decide."""
