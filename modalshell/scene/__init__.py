"""Scene files: what to simulate, written down in TOML and refused with the key's path where it is not allowed."""

from modalshell.scene.scene import BuiltScene, Scene, load_scene, parse_scene

__all__ = ["BuiltScene", "Scene", "load_scene", "parse_scene"]
