"""Plans: what each stage would do to the workspace, computed without touching it."""
