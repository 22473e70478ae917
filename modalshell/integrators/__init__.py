"""Rules that step a motion: one file a rule, found by the name that users and scenes give it."""
