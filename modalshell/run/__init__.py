"""Running scenes: every stored frame is on disk at once, so that a killed run resumes after its last frame.

A resumed run ends with the same arrays as an uninterrupted one, to the last bit. Other processes can follow a run by
its stored frames without affecting it (:class:`RunFollower`, ``modalshell view --attach RUN``).
"""

from modalshell.run.follow import RunFollower
from modalshell.run.results import Look, write_result
from modalshell.run.run_scene import run_scene
from modalshell.run.run_shell import SceneResult

__all__ = ["Look", "RunFollower", "SceneResult", "run_scene", "write_result"]
