"""The model that switches itself."""
