"""The skeleton and the clothes of the study ``dancing_character``."""
