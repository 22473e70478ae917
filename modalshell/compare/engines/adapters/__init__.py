"""Adapters of other engines: each reads a case from standard input in a process of its own, and prints its answer."""
