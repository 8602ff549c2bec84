"""Takes what a program of the gallery drew into its page: files that it wrote beside itself."""

from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst

#: Where films go that are pages of their own; Sphinx copies them to the static files.
FILMS = Path(__file__).parent / "made" / "films"
_FILM = """
.. raw:: html

   <iframe src="../../_static/{name}" style="width: 100%; height: 32rem; border: 0"></iframe>
"""


def written(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move PNG, GIF and HTML files to the page, in the order in which they were written."""
    folder, shown = Path(block_vars["src_file"]).parent, []
    files = [file for suffix in (".png", ".gif", ".html") for file in folder.glob(f"*{suffix}")]
    for file in sorted(files, key=lambda file: file.stat().st_mtime_ns):
        if file.suffix == ".html":
            shown.append(_FILM.format(name=file.replace(FILMS / file.name).name))
            continue
        target = Path(next(block_vars["image_path_iterator"])).with_suffix(file.suffix)
        shown.append(figure_rst([str(file.replace(target))], gallery_conf["src_dir"]))
        file.with_suffix(".svg").unlink(missing_ok=True)  # `save` writes both.
    return "\n".join(shown)


def _get_sg_image_scraper() -> Any:
    """What sphinx-gallery calls to find the function."""
    return written
