"""Theory manual: one chapter for each part of the theory, and a script that makes the numbers it states."""
