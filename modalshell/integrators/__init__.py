"""Rules that step a motion: one file a rule, found by its key."""
