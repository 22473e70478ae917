"""Checks of STL and glTF files for faults that trimesh ignores or does not locate."""

from __future__ import annotations

import json
import re
import warnings
from typing import Any

from modalshell.core.errors import MeshError, ModalShellWarning

_LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")
"""glTF extensions that change how a surface looks, not its shape."""
_MANY_INSTANCES, _MOST_INSTANCES = 4000, 20_000
"""Nodes with a mesh that take longer than a few seconds to put together, and those that are put together at most."""


def check_stl(data: bytes) -> None:
    """Compare a binary STL's length with its triangle count, and an ASCII one's ends with its starts."""
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        return
    lower = data.lower()
    if lower.lstrip().startswith(b"solid") and b"facet" in lower:
        opened, closed = len(re.findall(rb"facet\s+normal", lower)), lower.count(b"endfacet")
        if opened != closed or b"endsolid" not in lower:
            raise MeshError(
                f"the ASCII STL is cut short (truncated): {opened} facets begin and {closed} end, 'endsolid' "
                f"{'follows' if b'endsolid' in lower else 'is missing'}; write or download it again"
            )
        return
    if count < 0:
        raise MeshError(f"the STL is cut short: {len(data)} bytes, fewer than the 84 of its header")
    raise MeshError(
        f"the binary STL is cut short (truncated) or not an STL: {count} triangles take {84 + 50 * count} bytes, the "
        f"file has {len(data)}; write or download it again"
    )


def check_gltf(data: bytes) -> None:
    """Refuse what trimesh would leave out of a surface: required extensions and sparse accessors.

    A file whose JSON cannot be read is left to trimesh to report.
    """
    if data.startswith(b"glTF"):
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    instances = 0
    try:
        document: Any = json.loads(data)
        required = [name for name in document.get("extensionsRequired", ()) if not name.startswith(_LOOKS)]
        accessors = document.get("accessors", [])
        primitives = [part for mesh in document.get("meshes", ()) for part in mesh["primitives"]]
        used = [part["attributes"].get("POSITION") for part in primitives] + [
            part.get("indices") for part in primitives
        ]
        instances = sum("mesh" in node for node in document.get("nodes", ()))
        sparse = [index for index in used if index is not None and "sparse" in accessors[index]]
    except (ValueError, TypeError, AttributeError, LookupError, RecursionError):
        return
    if instances > _MOST_INSTANCES:
        raise MeshError(
            f"the glTF places {instances} meshes, more than the {_MOST_INSTANCES} that are read; join them into one "
            "mesh, or export fewer"
        )
    if instances > _MANY_INSTANCES:
        warnings.warn(
            f"the glTF places {instances} meshes, which takes about {1e-3 * instances:.0f} s to read; join them into "
            "one mesh to be faster",
            ModalShellWarning,
            stacklevel=4,
        )
    if required:
        raise MeshError(f"the glTF requires {', '.join(map(str, required))}, which is not read; export it without")
    if sparse:
        raise MeshError(
            f"the glTF stores accessor {sparse[0]} (counted from 0) as sparse, which is not read; export it without "
            "sparse accessors"
        )
