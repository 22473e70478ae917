"""Time integrators, one file each, registered by key."""
