"""The compiler: passes over the intermediate representation that no transport is needed for."""
