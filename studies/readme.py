"""Write ``studies/README.md``: a picture and the finding of each study, from its module and its committed page.

Run ``python -m studies.readme`` in a checkout, after a study's page or picture has changed.
"""

from __future__ import annotations

from pathlib import Path

from modalshell.atomic_io import write_text
from studies.pages import read_tables
from studies.reproduce import studies

FOLDER = Path(__file__).resolve().parent
HEAD = """# Studies

Each study answers one question; its module says how, its page has every number, and its figure module draws the result.

```sh
modalshell reproduce --only NAME      # --quick for a coarse version; --all runs every study
```

writes `results/NAME.json`, `NAME.npz` and `NAME.md`, and the pictures into `results/figures`. The page committed here
as `studies/NAME.md` is of a full run; its times hold for the machine that ran it. A new study is one module with
`main`, `table`, `finding` and `FIGURES`, and one module of `paper_figures` with `draw`. `python -m studies.readme`
writes this page.

| study | picture | finding |
|---|---|---|
"""
TUTORIALS = """
## Tutorials

Scripts in cells (`# %%`): open one in a notebook or an editor that knows cells, or run it, `python -m
studies.tutorials.first_film`; it writes into the working folder.

| tutorial | question |
|---|---|
"""
SCENES = """
## Scenes

`modalshell run studies/scenes/NAME.toml` runs one; `modalshell reproduce --pages` writes the web pages anew. Download a
page and open it: it moves without a server or a network, in any browser with WebGL2.

| scene | page | what it is |
|---|---|---|
"""


def row(name: str) -> str:
    """The line of one study."""
    study = studies()[name]
    title = (study.__doc__ or name).strip().splitlines()[0].rstrip(".")
    pictures = [f"../paper_figures/{figure}.png" for figure in study.FIGURES]
    picture = next((path for path in pictures if (FOLDER / path).is_file()), None)
    shown = "" if picture is None else f'[<img src="{picture}" width="320" alt="{name}">]({picture})'
    finding = study.finding(read_tables((FOLDER / f"{name}.md").read_text(encoding="utf-8")))
    return f"| [**{name}**]({name}.md)<br>{title} | {shown} | {finding} |\n"


def scenes() -> str:
    """The scenes, with the web page of each."""
    lines = []
    for file in sorted((FOLDER / "scenes").glob("*.toml")):
        about = file.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        moving = f"[moving](scenes/{file.stem}.html)" if file.with_suffix(".html").is_file() else ""
        lines.append(f"| [{file.stem}](scenes/{file.name}) | {moving} | {about} |\n")
    return SCENES + "".join(lines)


def tutorials() -> str:
    """The tutorials, with the question of each."""
    lines = []
    for file in sorted((FOLDER / "tutorials").glob("[!_]*.py")):
        about = file.read_text(encoding="utf-8").splitlines()[0].strip('"')
        lines.append(f"| [{file.stem}](tutorials/{file.name}) | {about} |\n")
    return TUTORIALS + "".join(lines)


def page() -> str:
    """The whole page."""
    return HEAD + "".join(map(row, studies())) + tutorials() + scenes()


if __name__ == "__main__":
    print(write_text(FOLDER / "README.md", page()))
