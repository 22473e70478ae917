"""Commands on results."""

from __future__ import annotations

import tempfile
import warnings
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter

import modalshell as ms
from modalshell.commands.terminal import progress, say
from modalshell.contact import Contact
from modalshell.export import check_formats, compress, save_modal_body, save_modes_gltf
from modalshell.export.near_origin import centred
from modalshell.export.usd import save_usd
from modalshell.files.archive import marks_of
from modalshell.files.atomic_io import read_record
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.page import Page, farthest, recorded, shell_page
from modalshell.page.shell_page import about
from modalshell.render.bodies import seen_contacts
from modalshell.run.report_numbers import checked_run

_SUFFIXES = {"usd": (".usdc", ".usda"), "gltf": (".glb",), "page": (".html", ".htm"), "body": (".npz",)}
"""Of formats whose files do not end in their names; the first one if none is asked for."""
_SHOWN = (".html", ".htm", ".png", ".mp4", ".md", ".csv", ".json")


def export(
    result: Annotated[Path, Parameter(help="Trajectory (.npz), clip (.clip), basis (.npz), or the folder of a run.")],
    *,
    to: Annotated[
        Literal["usd", "gltf", "pc2", "mdd", "clip", "page", "vtkhdf", "pvd", "csv", "body"],
        Parameter(help="Format to write; 'body' is a basis as arrays for other engines, with a JSON file."),
    ],
    out: Annotated[Path | None, Parameter(help="File to write; if omitted, next to RESULT. A .usda is text.")] = None,
    up: Annotated[Literal["y", "z"], Parameter(help="Axis that points up in a USD file.")] = "z",
) -> None:
    """Convert a saved motion or basis to a format of other programs.

    Example: modalshell export results/leaf.npz --to usd
    """
    if up != "z" and to != "usd":
        raise ms.OptionError(f"--up goes with --to usd; {to} files have their own axis")
    result = result_of(result)
    if result.suffix == ".toml":
        raise ms.OptionError(f"{result} is a scene, whose results are exported: run it with 'modalshell run' first")
    suffixes = _SUFFIXES.get(to, (f".{to}",))
    target = out or (result.with_name(f"{result.stem}_body.npz") if to == "body" else result.with_suffix(suffixes[0]))
    checked_target("--out", target, suffixes, result)
    rest = target.with_name(f"{target.stem}_rest.obj")
    if to in ("pc2", "mdd"):
        refuse_foreign(rest)
    if to == "csv" and out is None:
        refuse_foreign(target)
    if to == "body":
        refuse_foreign(target.with_suffix(".json"), *([target] if out is None else []))
        say(*save_modal_body(ms.Basis.load(result), target), sep="\n")
        return
    check_formats([target.suffix[1:]])
    if (basis := _saved_basis(result)) is not None:
        if to == "page":
            say(basis.page(title=result.stem).save(target))
        elif to == "gltf":
            say(save_modes_gltf(basis, target))
        else:
            raise ms.OptionError(f"{result} is a basis, which is written as gltf, page or body (got {to})")
        return
    run = ms.load_clip(result) if result.suffix == ".clip" else ms.load_trajectory(result, verify=True)
    if to == "page":
        say(_played(run, result).save(target))
        return
    with progress(f"{result.stem} frames") as on_frame:
        if up == "y":
            say(save_usd(run, target, on_frame, up))
        else:
            say(ms.save_trajectory(run, target, on_frame=on_frame))
    if target.suffix in (".pc2", ".mdd"):
        ms.save_mesh(ms.TriangleMesh(run.rest_positions, run.faces), rest)
        say(rest)
    if to == "csv":
        triangles = target.with_name(f"{target.stem}_triangles.csv")
        say(triangles if run.fields else "no table of the triangles: the run keeps no fields ('fields' in [output])")


def _played(run: ms.Trajectory, result: Path) -> Page:
    """A page that plays a motion, with what it touched where the record of ``result`` still names the scene."""
    shown, centre = centred(run)
    motion = compress(shown)
    shapes = motion.displacements()
    contacts, notes = _touched(run, result)
    seen = seen_contacts(run.positions, run.faces, run.times, contacts)
    bodies = [contact.body(corners, motion.times, inset) for contact, corners, inset in seen]
    return shell_page(
        np.asarray(motion.rest_positions, float), motion.faces, title=result.stem,
        tip=farthest(shapes, motion.amplitudes),
        record=recorded(motion.times, shapes, motion.amplitudes, label="Recorded motion"),
        units=motion.units, bodies=[about(body, centre) for body in bodies], notes=notes,
    )  # fmt: skip


def _touched(run: ms.Trajectory, result: Path) -> tuple[Sequence[Contact], list[str]]:
    """The contacts of a run, which its scene alone knows, and a note where they are unknown."""
    touches = run.contact_forces.size > 0
    if not touches and result.suffix != ".clip":  # a clip does not say whether anything was touched
        return (), []
    try:
        with warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):  # the run has given them
            scene = ms.load_scene(scene_of(result)).require_shell()
            checked_run(scene, scene.build_shell(), result.with_suffix(".json"))
            return scene.build_contacts(), []
    except ms.ModalShellError:
        missing = "Colliders are not shown: the run's scene, which alone knows them, is not where its record names it."
        return (), [missing] if touches else []


def open_result(
    result: Annotated[
        Path,
        Parameter(help="Trajectory or basis (.npz), clip, page, picture, film, report, table, or the folder of a run."),
    ],
) -> None:
    """Show whatever a result is in the web browser; motions and bases as a page in a temporary folder.

    Example: modalshell open results/leaf.npz
    """
    shown = result_of(result)
    if not shown.is_file():
        raise ms.OptionError(f"{shown} is no file: name a result, as 'results/leaf.npz', or the folder of a run")
    if shown.suffix in (".npz", ".clip"):
        if (basis := _saved_basis(shown)) is not None:
            page = basis.page(title=shown.stem)
        else:
            run = ms.load_clip(shown) if shown.suffix == ".clip" else ms.load_trajectory(shown, verify=True)
            page = _played(run, shown)
        shown = page.save(Path(tempfile.mkdtemp(prefix="modalshell_")) / f"{shown.stem}.html")  # kept for the browser
    elif shown.suffix not in _SHOWN:
        raise ms.OptionError(
            f"{shown} is no result that a browser shows (got {shown.suffix or 'no suffix'}): name one of .npz, .clip, "
            f"{', '.join(_SHOWN)}; a scene is shown by 'modalshell view' or 'modalshell page'"
        )
    say(shown)
    if not webbrowser.open(shown.resolve().as_uri()):
        say("no browser was found: open the file in one yourself")


def result_of(path: Path) -> Path:
    """The saved motion in the folder of a run, or ``path`` itself if it is no folder."""
    if not path.is_dir():
        return path
    saved = sorted(path.glob("*.npz"))
    if len(saved) != 1:
        names = ", ".join(file.name for file in saved[:5]) or "none"
        raise ms.OptionError(f"{path} must hold one .npz file (got {names}): name the file instead")
    return saved[0]


def _saved_basis(path: Path) -> ms.Basis | None:
    """The basis of a file; None if it holds none, FileFormatError if one that is damaged."""
    return ms.Basis.load(path) if "modalshell_basis" in marks_of(path) else None


def scene_of(archive: Path) -> Path:
    """The scene's file of a run, from the record next to its trajectory; OptionError where that names none."""
    named = (read_record(archive.with_suffix(".json")) or {}).get("file")
    if isinstance(named, str) and (file := archive.parent / named).is_file():
        return file
    found = f"{named}, which is not there" if isinstance(named, str) else "none"
    raise ms.OptionError(f"name a scene file, or a run with --scene FILE (got {archive}, whose record names {found})")
