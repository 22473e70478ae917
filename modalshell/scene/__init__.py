"""Scene files: what to simulate, written down in TOML and refused with the key's path where it is not allowed."""

from modalshell.scene.flock_scene import FlockScene
from modalshell.scene.load import load_scene, parse_scene
from modalshell.scene.scene import BuiltScene, Scene, ShellScene

__all__ = ["BuiltScene", "FlockScene", "Scene", "ShellScene", "load_scene", "parse_scene"]
