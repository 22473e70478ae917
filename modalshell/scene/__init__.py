"""Scene files: what to simulate, in TOML; unknown keys and invalid values are refused with the key's path.

:mod:`modalshell.scene.tables` lists every table and key with its unit. ``[mesh]``, ``[material]`` and ``[model]`` are
required; ``[supports]``, ``[loads]``, ``[[constraints]]``, ``[[contacts]]``, ``[motion]``, ``[path]``, ``[energies]``,
``[units]`` and ``[output]`` are optional. Without ``[motion]`` a scene asks for the equilibrium.
"""

from modalshell.scene.load import load_scene, parse_scene
from modalshell.scene.scene import BuiltScene, Scene, ShellScene

__all__ = ["BuiltScene", "Scene", "ShellScene", "load_scene", "parse_scene"]
