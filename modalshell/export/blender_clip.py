"""Blender add-on that plays modalshell clips; install this one file by Preferences > Add-ons > Install from Disk.

File > Import > modalshell clip makes a mesh object; its vertices follow the clip as the scene's frame changes. Point
caches (.pc2, .mdd) need no add-on: the Mesh Cache modifier reads them on the mesh NAME_rest.obj.
"""

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import StringProperty
from bpy_extras.io_utils import ImportHelper

bl_info = {
    "name": "modalshell clips",
    "author": "The modalshell authors",
    "version": (1, 0, 0),
    "blender": (4, 2, 0),
    "location": "File > Import > modalshell clip (.clip)",
    "description": "Plays motions of thin shells that modalshell wrote",
    "category": "Import-Export",
}

_FORMAT = 1
_KEY = "modalshell_clip"
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_clips = {}


def _clip(path):
    """Arrays of a clip, read once, in the metres and seconds that Blender counts in."""
    if path not in _clips:
        with np.load(path, allow_pickle=False) as data:
            if _KEY not in data or int(data[_KEY]) != _FORMAT:
                raise ValueError(f"{path} is no clip of format {_FORMAT}")
            names = ("times", "rest", "faces", "shapes", "scales", "amplitudes")
            clip = {name: data[name] for name in names}
            length, _, time = map(str, data["unit_system"])
        if length not in _METRES or time not in _SECONDS:
            raise ValueError(f"{path} is in {length} and {time}, which this add-on does not know")
        for name in ("rest", "scales"):
            clip[name] = np.float32(_METRES[length]) * clip[name]
        clip["times"] = _SECONDS[time] * clip["times"]
        _clips[path] = clip
    return _clips[path]


def positions(clip, time):
    """Vertex positions (n, 3) [m] at a time [s], between the two nearest frames; held before and after."""
    amplitudes = [np.interp(time, clip["times"], column) for column in clip["amplitudes"].T]
    return clip["rest"] + np.tensordot(np.array(amplitudes) * clip["scales"], clip["shapes"].astype(np.float32), 1)


def import_clip(context, path):
    """Make an object that plays the clip of a file from the scene's first frame on."""
    clip = _clip(path)
    mesh = bpy.data.meshes.new("Shell")
    mesh.from_pydata(clip["rest"].tolist(), [], clip["faces"].tolist())
    shell = bpy.data.objects.new("Shell", mesh)
    shell[_KEY] = path
    context.collection.objects.link(shell)
    frames = (clip["times"][-1] - clip["times"][0]) * context.scene.render.fps / context.scene.render.fps_base
    context.scene.frame_end = max(context.scene.frame_end, context.scene.frame_start + int(np.ceil(frames)))
    follow(context.scene)
    return shell


@persistent
def follow(scene, *_):
    """Put the vertices of every clip in the scene where they are at its present frame."""
    time = (scene.frame_current_final - scene.frame_start) * scene.render.fps_base / scene.render.fps
    for shell in scene.objects:
        if _KEY in shell:
            clip = _clip(shell[_KEY])
            moved = positions(clip, clip["times"][0] + time)
            shell.data.vertices.foreach_set("co", np.ascontiguousarray(moved, np.float32).ravel())
            shell.data.update()


class ImportModalshellClip(bpy.types.Operator, ImportHelper):
    """Import a motion that modalshell wrote."""

    bl_idname = "import_scene.modalshell_clip"
    bl_label = "Import modalshell clip"
    filename_ext = ".clip"
    filter_glob: StringProperty(default="*.clip", options={"HIDDEN"})

    def execute(self, context):
        """Read the file that was chosen."""
        try:
            import_clip(context, self.filepath)
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


def _menu(self, _context):
    self.layout.operator(ImportModalshellClip.bl_idname, text="modalshell clip (.clip)")


def register():
    """Add the importer and the frame handler."""
    bpy.utils.register_class(ImportModalshellClip)
    bpy.types.TOPBAR_MT_file_import.append(_menu)
    bpy.app.handlers.frame_change_pre.append(follow)


def unregister():
    """Take them away again."""
    bpy.app.handlers.frame_change_pre.remove(follow)
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    bpy.utils.unregister_class(ImportModalshellClip)
